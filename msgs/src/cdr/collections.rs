//! CDR of sequences and arrays.

use super::{Cdr, EncodeError, Reader, Result, Writer};

impl<T: Cdr> Cdr for Vec<T> {
    const LEAST_SIZE: usize = 4;

    #[inline]
    fn end(&self, position: usize) -> usize {
        T::end_of_slice(self, position.next_multiple_of(4) + 4)
    }

    #[inline]
    fn encode(&self, writer: &mut Writer<'_>) {
        writer.length(self.len());
        T::encode_slice(self, writer);
    }

    #[inline]
    fn decode(reader: &mut Reader<'_>) -> Result<Self> {
        reader.elements(T::IS_PRIMITIVE, |reader| {
            let count = reader.length(T::LEAST_SIZE)?;
            T::decode_vec(count, reader)
        })
    }

    fn check_bounds(&self) -> std::result::Result<(), EncodeError> {
        check_elements(self)
    }
}

impl<T: Cdr + Default, const N: usize> Cdr for [T; N] {
    const LEAST_SIZE: usize = if N == 0 { 1 } else { T::LEAST_SIZE * N };

    #[inline]
    fn end(&self, position: usize) -> usize {
        T::end_of_slice(self, position)
    }

    #[inline]
    fn encode(&self, writer: &mut Writer<'_>) {
        T::encode_slice(self, writer);
    }

    #[inline]
    fn decode(reader: &mut Reader<'_>) -> Result<Self> {
        reader.elements(T::IS_PRIMITIVE, |reader| {
            let mut values = std::array::from_fn(|_| T::default());
            T::decode_slice(&mut values, reader)?;
            Ok(values)
        })
    }

    fn check_bounds(&self) -> std::result::Result<(), EncodeError> {
        check_elements(self)
    }
}

fn check_elements<T: Cdr>(values: &[T]) -> std::result::Result<(), EncodeError> {
    for (index, value) in values.iter().enumerate() {
        value.check_bounds().map_err(|error| error.at_index(index))?;
    }
    Ok(())
}
