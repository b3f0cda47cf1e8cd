//! CDR of numbers and booleans.

use super::plain::{PlainReader, PlainWriter, plain_end};
use super::{Cdr, Endianness, Plain, Problem, Reader, Result, Writer};

macro_rules! numbers {
    ($($number:ident),*) => {$(
        impl Plain for $number {
            const ALIGNMENT: usize = size_of::<$number>();
            const SIZE: usize = size_of::<$number>();
            const IS_NUMBER: bool = true;

            #[inline]
            fn put(&self, run: &mut PlainWriter<'_>) {
                Self::put_slice(std::slice::from_ref(self), run);
            }

            #[inline]
            fn get(run: &mut PlainReader<'_>) -> Self {
                let [value] = Self::get_array(run);
                value
            }

            #[inline]
            fn put_slice(values: &[Self], run: &mut PlainWriter<'_>) {
                let places = run.take(size_of_val(values)).as_chunks_mut().0;
                places.iter_mut().zip(values).for_each(|(place, value)| *place = value.to_le_bytes());
            }

            #[inline]
            fn get_slice(values: &mut [Self], run: &mut PlainReader<'_>) {
                let endianness = run.endianness();
                let places = run.take(size_of_val(values)).as_chunks().0;
                match endianness {
                    Endianness::Little => {
                        values.iter_mut().zip(places).for_each(|(value, place)| *value = Self::from_le_bytes(*place));
                    }
                    Endianness::Big => {
                        values.iter_mut().zip(places).for_each(|(value, place)| *value = Self::from_be_bytes(*place));
                    }
                }
            }

            #[inline]
            fn get_array<const N: usize>(run: &mut PlainReader<'_>) -> [Self; N] {
                let mut values = [Self::default(); N];
                Self::get_slice(&mut values, run);
                values
            }

            numbers!(@bytes $number);
        }

        impl Cdr for $number {
            const LEAST_SIZE: usize = size_of::<$number>();
            const IS_PRIMITIVE: bool = true;

            #[inline]
            fn end(&self, position: usize) -> usize {
                plain_end::<Self>(1, position)
            }

            #[inline]
            fn encode(&self, writer: &mut Writer<'_>) {
                writer.number(self.to_le_bytes());
            }

            #[inline]
            fn decode(reader: &mut Reader<'_>) -> Result<Self> {
                let bytes = reader.number()?;
                Ok(match reader.endianness() {
                    Endianness::Little => Self::from_le_bytes(bytes),
                    Endianness::Big => Self::from_be_bytes(bytes),
                })
            }

            #[inline]
            fn end_of_slice(values: &[Self], position: usize) -> usize {
                plain_end::<Self>(values.len(), position)
            }

            #[inline]
            fn encode_slice(values: &[Self], writer: &mut Writer<'_>) {
                writer.plain_slice(values);
            }

            #[inline]
            fn decode_slice(values: &mut [Self], reader: &mut Reader<'_>) -> Result<()> {
                reader.plain_slice(values)
            }

            #[inline]
            fn decode_vec(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>> {
                reader.plain_vec(count)
            }
        }
    )*};
    (@bytes u8) => {
        #[inline]
        fn as_bytes(values: &[Self]) -> Option<&[u8]> {
            Some(values)
        }

        #[inline]
        fn collect(bytes: &[u8], _endianness: Endianness) -> Vec<Self> {
            bytes.to_vec()
        }
    };
    (@bytes $number:ident) => {
        #[inline]
        fn collect(bytes: &[u8], endianness: Endianness) -> Vec<Self> {
            let places = bytes.as_chunks().0;
            match endianness {
                Endianness::Little => places.iter().map(|place| Self::from_le_bytes(*place)).collect(),
                Endianness::Big => places.iter().map(|place| Self::from_be_bytes(*place)).collect(),
            }
        }
    };
}

numbers!(i8, u8, i16, u16, i32, u32, i64, u64, f32, f64);

impl Cdr for bool {
    const LEAST_SIZE: usize = 1;
    const IS_PRIMITIVE: bool = true;

    #[inline]
    fn end(&self, position: usize) -> usize {
        position + 1
    }

    #[inline]
    fn encode(&self, writer: &mut Writer<'_>) {
        writer.number([u8::from(*self)]);
    }

    #[inline]
    fn decode(reader: &mut Reader<'_>) -> Result<Self> {
        let place = reader.clone();
        let [byte] = reader.number()?;
        if byte > 1 {
            return Err(place.error(Problem::Bool(byte)));
        }
        Ok(byte == 1)
    }

    fn decode_vec(count: usize, reader: &mut Reader<'_>) -> Result<Vec<Self>> {
        let mut places = reader.clone();
        let bytes = reader.bytes(count)?;
        if let Some(index) = bytes.iter().position(|byte| *byte > 1) {
            places.bytes(index)?;
            return Err(places.error(Problem::Bool(bytes[index])).at_index(index));
        }
        Ok(bytes.iter().map(|byte| *byte == 1).collect())
    }
}
