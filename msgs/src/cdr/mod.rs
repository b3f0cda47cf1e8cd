//! CDR, the serialisation of DDS, in the form ROS 2 uses: XCDR version 1, plain.
//!
//! ```
//! use downbeat_msgs::{cdr, std_msgs::msg::Bool};
//!
//! assert_eq!(cdr::to_vec(&Bool { data: true }), [0, 1, 0, 0, 1]);
//! assert_eq!(cdr::from_slice::<Bool>(&[0, 0, 0, 0, 1])?, Bool { data: true });
//! # Ok::<(), cdr::Error>(())
//! ```
//!
//! A serialised value starts with a header of four bytes that names the representation; alignment is relative
//! to the end of the header. We write little-endian, as Fast DDS does on every machine ROS 2 supports, and
//! read both byte orders.
//!
//! [`to_vec`] allocates once, since [`encoded_size`] computes the size first. Large messages can be read
//! without copying their strings and sequences: see [`FromReader`].
//!
//! # Invalid input
//! Reading is safe for any input: the result is a value or an [`Error`] with the field and the byte offset,
//! and memory is bounded by a small multiple of the input. Bytes after the value are ignored, since DDS pads.
//!
//! # Bounds
//! [`to_vec`] does not check the bounds of bounded strings and sequences: it cannot fail, and receivers
//! reject values that exceed them. [`try_to_vec`] checks them, at no cost for the many messages without
//! bounds.
//!
//! # XCDR version 2
//! ROS 2 does not write it, but other DDS applications may, for ROS 2 types. Both plain (`CDR2`, all types
//! final) and delimited (`D_CDR2`, all types appendable) encodings are read; additional fields of a sender
//! are skipped, missing ones are an error. Parameter lists (`PL_CDR`, `PL_CDR2`), which only mutable types
//! use, are rejected.
//!
//! # Length
//! The output ends with the value, as on the wire. The buffer returned by rclpy's `serialize_message`
//! contains the same bytes but, for some types, is followed by meaningless bytes, since its length is
//! estimated in advance.
//!
//! # References
//! - OMG DDS-XTypes 1.3, 7.4.1 and 7.4.2 (XCDR version 1), 7.4.3 (version 2) and 7.6.3.1.2 (representation
//!   identifiers).
//! - What `rclpy.serialization` does with rmw_fastrtps_cpp 8.4.3, which the tests compare with byte by byte.
//! - Wide strings in version 2: `src/core/cdr/src/dds_cdrstream.c` of `eclipse-cyclonedds/cyclonedds`.

mod bounds;
mod error;
mod fields;
mod plain;
mod plain_message;
mod reader;
mod values;
mod view;
mod writer;

pub use bounds::{Count, Text};
#[doc(hidden)]
pub use bounds::{check_count, check_field, check_text};
pub use error::{EncodeError, Error, Problem, Result};
pub use plain::{Plain, PlainReader, PlainWriter};
pub use plain_message::PlainMessage;
pub use reader::Reader;
pub use values::WString;
pub use view::{FromReader, Numbers, Sequence, Viewed};
pub use writer::Writer;

/// Size of the header of a serialised value in bytes.
pub const HEADER_SIZE: usize = 4;

/// A type that can be serialised as CDR. The generator implements it for messages.
pub trait Cdr: Sized {
    /// The minimum size of a value without padding; at least 1. Limits how many elements the rest of the
    /// input can hold.
    const LEAST_SIZE: usize;

    /// Whether it is a number or a boolean: in XCDR version 2 sequences of other types start with their size.
    const IS_PRIMITIVE: bool = false;

    /// The end of the value if it starts at or after `position`, both relative to the end of the header.
    fn end(&self, position: usize) -> usize;

    /// Appends the value.
    fn encode(&self, writer: &mut Writer<'_>);

    /// Reads a value.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a valid value.
    fn decode(reader: &mut Reader<'_>) -> Result<Self>;

    /// Checks the bounds of bounded strings and sequences. Does nothing for types without bounds.
    ///
    /// # Errors
    /// Returns an error if a limit is exceeded.
    fn check_bounds(&self) -> std::result::Result<(), EncodeError> {
        Ok(())
    }

    /// Like [`Cdr::end`], for values one after another.
    fn end_of_slice(values: &[Self], position: usize) -> usize {
        values.iter().fold(position, |position, value| value.end(position))
    }

    /// Appends values one after another; types with contiguous values append them at once.
    fn encode_slice(values: &[Self], writer: &mut Writer<'_>) {
        for value in values {
            value.encode(writer);
        }
    }

    /// Fills the slice with values.
    ///
    /// # Errors
    /// See [`Cdr::decode`].
    fn decode_slice(values: &mut [Self], reader: &mut Reader<'_>) -> Result<()> {
        for (index, value) in values.iter_mut().enumerate() {
            *value = Self::decode(reader).map_err(|error| error.at_index(index))?;
        }
        Ok(())
    }

    /// Reads `count` values. The caller has checked that the rest of the input can hold them.
    ///
    /// # Errors
    /// See [`Cdr::decode`].
    fn decode_vec(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>> {
        let mut values = Vec::with_capacity(count);
        for index in 0..count {
            values.push(Self::decode(reader).map_err(|error| error.at_index(index))?);
        }
        Ok(values)
    }
}

/// The serialised form of a value: header and body, little-endian.
///
/// # Panics
/// Panics if a string or sequence has more than 2^32 - 1 elements, which CDR cannot express.
#[must_use]
pub fn to_vec<T: Cdr>(value: &T) -> Vec<u8> {
    let mut buffer = Vec::new();
    to_buffer(value, &mut buffer);
    buffer
}

/// Like [`to_vec`], into a buffer whose memory is reused. Its previous contents are discarded.
///
/// # Panics
/// See [`to_vec`].
pub fn to_buffer<T: Cdr>(value: &T, buffer: &mut Vec<u8>) {
    value.encode(&mut Writer::with_header(buffer, encoded_size(value)));
}

/// Like [`to_vec`], after checking the bounds that receivers enforce.
///
/// ```
/// use downbeat_msgs::{cdr, rmw_dds_common::msg::NodeEntitiesInfo};
///
/// let node = NodeEntitiesInfo { node_name: "n".repeat(300), ..Default::default() };
/// let error = cdr::try_to_vec(&node).unwrap_err();
/// assert_eq!(error.to_string(), "cannot encode field `node_name`: has the length 300, the type allows 256");
/// ```
///
/// # Errors
/// Returns an error if a bounded string or sequence exceeds its bound, or the value is too large for CDR.
pub fn try_to_vec<T: Cdr>(value: &T) -> std::result::Result<Vec<u8>, EncodeError> {
    value.check_bounds()?;
    match encoded_size(value) {
        size if u32::try_from(size).is_err() => Err(EncodeError::TooLarge { size }),
        _ => Ok(to_vec(value)),
    }
}

/// The exact number of bytes that [`to_vec`] returns.
///
/// ```
/// use downbeat_msgs::{cdr, std_msgs::msg::Header};
///
/// let header = Header { frame_id: "map".into(), ..Default::default() };
/// assert_eq!(cdr::encoded_size(&header), cdr::to_vec(&header).len());
/// ```
#[must_use]
pub fn encoded_size<T: Cdr>(value: &T) -> usize {
    HEADER_SIZE + value.end(0)
}

/// Reads a value from its serialised form, header included, in either byte order: a message, or a view of it
/// that borrows from the bytes.
///
/// # Errors
/// Returns an error if ROS 2 does not use the representation, or the bytes are not a valid value.
pub fn from_slice<'a, T: FromReader<'a>>(bytes: &'a [u8]) -> Result<T> {
    T::from_reader(&mut Reader::new(bytes)?)
}

/// The byte order of a serialised value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endianness {
    /// The most significant byte first (`CDR_BE`).
    Big,
    /// The least significant byte first (`CDR_LE`).
    Little,
}

/// The data representation of a value: its encoding rules.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Representation {
    /// XCDR version 1, plain: what ROS 2 writes.
    Plain1,
    /// XCDR version 2, plain: the maximum alignment is four bytes, and sequences and arrays of non-primitive
    /// types start with their size.
    Plain2,
    /// XCDR version 2, delimited: like plain, but messages also start with their size, so that a sender can
    /// append fields that we do not know.
    Delimited2,
}

impl Representation {
    /// The maximum alignment.
    const fn greatest_alignment(self) -> usize {
        match self {
            Self::Plain1 => 8,
            Self::Plain2 | Self::Delimited2 => 4,
        }
    }
}

/// Splits a serialised value into its representation and its body.
fn split(bytes: &[u8]) -> Result<(Representation, Endianness, &[u8])> {
    let fail = |problem| Error { problem, offset: 0, path: String::new() };
    let Some((header, body)) = bytes.split_first_chunk::<HEADER_SIZE>() else {
        return Err(fail(Problem::TooShort { needed: HEADER_SIZE, left: bytes.len() }));
    };
    let identifier = u16::from_be_bytes([header[0], header[1]]);
    let representation = match identifier {
        0x0000 | 0x0001 => Representation::Plain1,
        0x0006 | 0x0007 => Representation::Plain2,
        0x0008 | 0x0009 => Representation::Delimited2,
        other => return Err(fail(Problem::Representation(other))),
    };
    let endianness = if identifier & 1 == 0 { Endianness::Big } else { Endianness::Little };
    Ok((representation, endianness, body))
}

/// The meaning of identifiers that are not supported.
fn refused_name(identifier: u16) -> &'static str {
    match identifier {
        0x0002 | 0x0003 => " (PL_CDR, a parameter list of XCDR version 1)",
        0x0004 => " (XML)",
        0x000a | 0x000b => " (PL_CDR2, a parameter list of XCDR version 2)",
        _ => "",
    }
}

#[cfg(test)]
mod tests;
