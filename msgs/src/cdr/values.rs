//! CDR of numbers, booleans, strings, sequences and arrays.

use std::fmt;
use std::ops::{Deref, DerefMut};

use serde::{Deserialize, Serialize};

use super::plain::{PlainReader, PlainWriter, plain_end};
use super::{
    Cdr, EncodeError, Endianness, FromReader, Plain, Problem, Reader, Representation, Result, Text, Writer,
};

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

impl Text for WString {
    fn longest(&self) -> usize {
        self.encode_utf16().count()
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
        let units: Vec<u16> = if reader.representation() == Representation::Plain1 {
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
