//! CDR of strings.

use std::fmt;
use std::ops::{Deref, DerefMut};

use serde::{Deserialize, Serialize};

use super::representation::Encoding;
use super::{Cdr, FromReader, Problem, Reader, Result, Writer};

/// The text of a `wstring`.
#[derive(Clone, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct WString(pub String);

impl Deref for WString {
    type Target = String;

    fn deref(&self) -> &String {
        &self.0
    }
}

impl DerefMut for WString {
    fn deref_mut(&mut self) -> &mut String {
        &mut self.0
    }
}

impl From<&str> for WString {
    fn from(text: &str) -> Self {
        Self(text.into())
    }
}

impl fmt::Display for WString {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

/// A string or a collection of strings, to which a string bound applies.
pub trait Text {
    /// The length of the longest string, in the unit of its bound: bytes, or UTF-16 code units of a
    /// [`WString`].
    fn longest(&self) -> usize;
}

impl Text for &str {
    fn longest(&self) -> usize {
        self.len()
    }
}

impl Text for String {
    fn longest(&self) -> usize {
        self.len()
    }
}

impl Text for WString {
    fn longest(&self) -> usize {
        self.encode_utf16().count()
    }
}

impl<T: Text> Text for Vec<T> {
    fn longest(&self) -> usize {
        self.iter().map(T::longest).max().unwrap_or(0)
    }
}

impl<T: Text, const N: usize> Text for [T; N] {
    fn longest(&self) -> usize {
        self.iter().map(T::longest).max().unwrap_or(0)
    }
}

/// Length with its terminating zero, bytes, zero.
impl Cdr for String {
    const LEAST_SIZE: usize = 4;

    #[inline]
    fn end(&self, position: usize) -> usize {
        position.next_multiple_of(4) + 4 + self.len() + 1
    }

    #[inline]
    fn encode(&self, writer: &mut Writer<'_>) {
        writer.text(self);
    }

    #[inline]
    fn decode(reader: &mut Reader<'_>) -> Result<Self> {
        <&str>::from_reader(reader).map(ToOwned::to_owned)
    }
}

/// Borrowed from the input.
impl<'a> FromReader<'a> for &'a str {
    const FEWEST_BYTES: usize = 4;

    fn from_reader(reader: &mut Reader<'a>) -> Result<Self> {
        let length = reader.length(1)?;
        let start = reader.clone();
        // Some implementations write an empty string without its zero.
        let Some((terminator, text)) = reader.bytes(length)?.split_last() else {
            return Ok("");
        };
        if *terminator != 0 {
            return Err(start.error(Problem::Terminator(*terminator)));
        }
        std::str::from_utf8(text).map_err(|error| start.error(Problem::Utf8 { valid: error.valid_up_to() }))
    }
}

/// Length, then each UTF-16 code unit in 32 bits, no terminator, like Fast DDS on Linux. In XCDR version 2,
/// which ROS 2 does not write, as in the standard: the length in bytes, then each code unit in 16 bits.
impl Cdr for WString {
    const LEAST_SIZE: usize = 4;

    fn end(&self, position: usize) -> usize {
        position.next_multiple_of(4) + 4 + 4 * self.encode_utf16().count()
    }

    fn encode(&self, writer: &mut Writer<'_>) {
        writer.length(self.encode_utf16().count());
        for unit in self.encode_utf16() {
            writer.bytes(&u32::from(unit).to_le_bytes());
        }
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self> {
        let start = reader.clone();
        let units: Vec<u16> = if reader.encoding() == Encoding::Plain1 {
            let count = reader.length(4)?;
            let mut narrow = Vec::with_capacity(count);
            for _ in 0..count {
                let unit = u32::decode(reader)?;
                narrow.push(u16::try_from(unit).map_err(|_| start.error(Problem::Utf16(unit)))?);
            }
            narrow
        } else {
            let size = reader.length(1)?;
            if size % 2 != 0 {
                return Err(start.error(Problem::Utf16Size(size)));
            }
            u16::decode_vec(size / 2, reader)?
        };
        char::decode_utf16(units)
            .collect::<std::result::Result<String, _>>()
            .map(Self)
            .map_err(|error| start.error(Problem::Utf16(error.unpaired_surrogate().into())))
    }
}
