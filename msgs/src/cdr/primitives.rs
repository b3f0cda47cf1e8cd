//! CDR of numbers and truth values. Runs of numbers are copied as a whole.

use super::{Cdr, Endianness, Problem, Reader, Result, Writer};

/// Bytes that are written at a time: a part of a first-level cache.
const BLOCK: usize = 8192;

macro_rules! numbers {
    ($($number:ty),*) => {$(
        impl Cdr for $number {
            const LEAST_SIZE: usize = size_of::<$number>();

            fn encode(&self, writer: &mut Writer<'_>) {
                writer.align(Self::LEAST_SIZE);
                writer.bytes(&self.to_le_bytes());
            }

            fn decode(reader: &mut Reader<'_>) -> Result<Self> {
                reader.align(Self::LEAST_SIZE)?;
                let bytes = reader.bytes(Self::LEAST_SIZE)?;
                let mut number = [0; size_of::<$number>()];
                number.copy_from_slice(bytes);
                Ok(match reader.endianness() {
                    Endianness::Little => Self::from_le_bytes(number),
                    Endianness::Big => Self::from_be_bytes(number),
                })
            }

            fn encode_slice(values: &[Self], writer: &mut Writer<'_>) {
                if values.is_empty() {
                    return; // No padding either.
                }
                writer.align(Self::LEAST_SIZE);
                writer.reserve(size_of_val(values));
                // Block by block, so that the zeros that are written over are still in the cache.
                for block in values.chunks(BLOCK / Self::LEAST_SIZE) {
                    let places = writer.zeros(size_of_val(block)).as_chunks_mut().0;
                    places.iter_mut().zip(block).for_each(|(place, value)| *place = value.to_le_bytes());
                }
            }

            fn decode_slice(values: &mut [Self], reader: &mut Reader<'_>) -> Result<()> {
                if values.is_empty() {
                    return Ok(());
                }
                reader.align(Self::LEAST_SIZE)?;
                let places = reader.bytes(size_of_val(values))?.as_chunks().0;
                match reader.endianness() {
                    Endianness::Little => {
                        values.iter_mut().zip(places).for_each(|(value, place)| *value = Self::from_le_bytes(*place));
                    }
                    Endianness::Big => {
                        values.iter_mut().zip(places).for_each(|(value, place)| *value = Self::from_be_bytes(*place));
                    }
                }
                Ok(())
            }

            fn decode_vec(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>> {
                if count == 0 {
                    return Ok(Vec::new());
                }
                reader.align(Self::LEAST_SIZE)?;
                let places = reader.bytes(count.saturating_mul(Self::LEAST_SIZE))?.as_chunks().0;
                Ok(match reader.endianness() {
                    Endianness::Little => places.iter().map(|place| Self::from_le_bytes(*place)).collect(),
                    Endianness::Big => places.iter().map(|place| Self::from_be_bytes(*place)).collect(),
                })
            }
        }
    )*};
}

numbers!(i8, u8, i16, u16, i32, u32, i64, u64, f32, f64);

impl Cdr for bool {
    const LEAST_SIZE: usize = 1;

    fn encode(&self, writer: &mut Writer<'_>) {
        writer.bytes(&[u8::from(*self)]);
    }

    fn decode(reader: &mut Reader<'_>) -> Result<Self> {
        match reader.clone().bytes(1)?[0] {
            byte @ (0 | 1) => {
                reader.bytes(1)?;
                Ok(byte == 1)
            }
            other => Err(reader.error(Problem::Bool(other))),
        }
    }
}
