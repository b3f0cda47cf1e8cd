//! Messages with a fixed layout, which are read and written as a whole.

use super::plain::plain_end;
use super::{Cdr, Plain, Reader, Result, Writer};

/// A message with a fixed layout.
pub trait PlainMessage: Plain {
    /// Reads a value field by field: if messages start with their sizes, and to find out which field is
    /// truncated.
    ///
    /// # Errors
    /// Returns an error if the input ends too early.
    fn decode_fields(reader: &mut Reader<'_>) -> Result<Self>;
}

impl<T: PlainMessage> Cdr for T {
    const LEAST_SIZE: usize = T::SIZE;

    #[inline]
    fn end(&self, position: usize) -> usize {
        plain_end::<T>(1, position)
    }

    #[inline]
    fn encode(&self, writer: &mut Writer<'_>) {
        writer.plain(self);
    }

    #[inline]
    fn decode(reader: &mut Reader<'_>) -> Result<T> {
        match reader.plain() {
            Some(value) => Ok(value),
            None => reader.message(T::decode_fields),
        }
    }

    #[inline]
    fn end_of_slice(values: &[T], position: usize) -> usize {
        plain_end::<T>(values.len(), position)
    }

    #[inline]
    fn encode_slice(values: &[T], writer: &mut Writer<'_>) {
        writer.plain_slice(values);
    }

    #[inline]
    fn decode_slice(values: &mut [T], reader: &mut Reader<'_>) -> Result<()> {
        reader.plain_slice(values)
    }

    #[inline]
    fn decode_vec(count: usize, reader: &mut Reader<'_>) -> Result<Vec<T>> {
        reader.plain_vec(count)
    }
}
