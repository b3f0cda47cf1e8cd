//! The header of a serialised value, which names its encoding.

use super::{Error, HEADER_SIZE, Problem, Result};

/// The byte order of a serialised value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endianness {
    /// The most significant byte first (`CDR_BE`).
    Big,
    /// The least significant byte first (`CDR_LE`).
    Little,
}

/// The encoding rules of a value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Encoding {
    /// XCDR version 1, plain: what ROS 2 writes.
    Plain1,
    /// XCDR version 2, plain: the maximum alignment is four bytes, and sequences and arrays of non-primitive
    /// types start with their size.
    Plain2,
    /// XCDR version 2, delimited: like plain, but messages also start with their size, so that a sender can
    /// append fields that we do not know.
    Delimited2,
}

impl Encoding {
    /// The maximum alignment.
    pub(super) const fn greatest_alignment(self) -> usize {
        match self {
            Self::Plain1 => 8,
            Self::Plain2 | Self::Delimited2 => 4,
        }
    }
}

/// Splits a serialised value into its representation and its body.
pub(super) fn split(bytes: &[u8]) -> Result<(Encoding, Endianness, &[u8])> {
    let fail = |problem| Error { problem, offset: 0, path: String::new() };
    let Some((header, body)) = bytes.split_first_chunk::<HEADER_SIZE>() else {
        return Err(fail(Problem::TooShort { needed: HEADER_SIZE, left: bytes.len() }));
    };
    let identifier = u16::from_be_bytes([header[0], header[1]]);
    let encoding = match identifier {
        0x0000 | 0x0001 => Encoding::Plain1,
        0x0006 | 0x0007 => Encoding::Plain2,
        0x0008 | 0x0009 => Encoding::Delimited2,
        other => return Err(fail(Problem::Representation(other))),
    };
    let endianness = if identifier & 1 == 0 { Endianness::Big } else { Endianness::Little };
    Ok((encoding, endianness, body))
}

/// The meaning of identifiers that are not supported.
pub(super) fn refused_name(identifier: u16) -> &'static str {
    match identifier {
        0x0002 | 0x0003 => " (PL_CDR, a parameter list of XCDR version 1)",
        0x0004 => " (XML)",
        0x000a | 0x000b => " (PL_CDR2, a parameter list of XCDR version 2)",
        _ => "",
    }
}
