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
//! A serialised value begins with a header of four bytes that names the representation; alignment counts from behind
//! it. We write little-endian, as Fast DDS does on every machine ROS 2 supports, and read both byte orders.
//!
//! Reading trusts nothing: whatever the bytes, the result is a value or an [`Error`] that says which field, at which
//! byte, and never more memory than a small multiple of the input. Bytes behind the value are ignored, since DDS pads.
//! Writing does not check the bounds of bounded strings and sequences: a receiver will refuse what exceeds them.
//!
//! What we write ends with the value, as it does on the wire. The buffer that rclpy's `serialize_message` returns holds
//! the same bytes and then, for some types, others without meaning: it is as long as a size estimated beforehand.
//!
//! # References
//! - OMG DDS-XTypes 1.3, 7.4.1 (XCDR version 1) and 7.6.3.1.2 (representation identifiers).
//! - What `rclpy.serialization` does with rmw_fastrtps_cpp 8.4.3, which the tests compare with byte by byte.

mod collections;
mod error;
mod primitives;
mod reader;
mod text;
mod writer;

pub use error::{Error, Problem, Result};
pub use reader::{Endianness, Reader};
pub use text::{Text, WString};
pub use writer::Writer;

/// Bytes of the header in front of a serialised value.
pub const HEADER_SIZE: usize = 4;

/// A type with a CDR form. Messages get it from the generator.
pub trait Cdr: Sized {
    /// The fewest bytes a value takes, padding not counted; at least 1. Bounds how many can be in what is left.
    const LEAST_SIZE: usize;

    /// Appends the value.
    fn encode(&self, writer: &mut Writer<'_>);

    /// Reads a value.
    ///
    /// # Errors
    /// If the bytes are no such value.
    fn decode(reader: &mut Reader<'_>) -> Result<Self>;

    /// Appends values one after another; types whose values lie side by side do it in one go.
    fn encode_slice(values: &[Self], writer: &mut Writer<'_>) {
        for value in values {
            value.encode(writer);
        }
    }

    /// Reads as many values as the slice has places.
    ///
    /// # Errors
    /// As [`Cdr::decode`].
    fn decode_slice(values: &mut [Self], reader: &mut Reader<'_>) -> Result<()> {
        for (index, value) in values.iter_mut().enumerate() {
            *value = Self::decode(reader).map_err(|error| error.at_index(index))?;
        }
        Ok(())
    }

    /// Reads so many values. The caller has checked that they can be in what is left.
    ///
    /// # Errors
    /// As [`Cdr::decode`].
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
/// If a string or sequence has more than 2^32 - 1 elements, which CDR cannot express.
#[must_use]
pub fn to_vec<T: Cdr>(value: &T) -> Vec<u8> {
    let mut buffer = Vec::new();
    to_buffer(value, &mut buffer);
    buffer
}

/// As [`to_vec`], into a buffer whose memory is used again. What it held is gone.
///
/// # Panics
/// As [`to_vec`].
pub fn to_buffer<T: Cdr>(value: &T, buffer: &mut Vec<u8>) {
    buffer.clear();
    buffer.extend_from_slice(&[0, 1, 0, 0]);
    value.encode(&mut Writer::new(buffer));
}

/// Reads a value from its serialised form, header included, in either byte order.
///
/// # Errors
/// If the representation is another one, or the bytes are no such value.
pub fn from_slice<T: Cdr>(bytes: &[u8]) -> Result<T> {
    T::decode(&mut Reader::new(bytes)?)
}

#[cfg(test)]
mod tests;
