//! CDR of sequences and arrays.

use super::{Cdr, Reader, Result, Writer};

impl<T: Cdr> Cdr for Vec<T> {
    const LEAST_SIZE: usize = 4;

    fn encode(&self, writer: &mut Writer<'_>) {
        writer.length(self.len());
        T::encode_slice(self, writer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self> {
        let count = reader.length(T::LEAST_SIZE)?;
        T::decode_vec(count, reader)
    }
}

impl<T: Cdr + Default, const N: usize> Cdr for [T; N] {
    const LEAST_SIZE: usize = if N == 0 { 1 } else { T::LEAST_SIZE * N };

    fn encode(&self, writer: &mut Writer<'_>) {
        T::encode_slice(self, writer);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self> {
        let mut values = std::array::from_fn(|_| T::default());
        T::decode_slice(&mut values, reader)?;
        Ok(values)
    }
}
