//! Reading CDR from bytes.

use super::{Cdr, Error, HEADER_SIZE, Problem, Result, Text};

/// The byte order of a serialised value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Endianness {
    /// The most significant byte first (`CDR_BE`).
    Big,
    /// The least significant byte first (`CDR_LE`).
    Little,
}

/// Reads the parts of a serialised value one after another. Alignment counts from behind the header.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    body: &'a [u8],
    position: usize,
    endianness: Endianness,
}

impl<'a> Reader<'a> {
    /// Reads the header.
    ///
    /// # Errors
    /// If there is none, or it names a representation other than plain XCDR version 1.
    pub fn new(bytes: &'a [u8]) -> Result<Self> {
        let fail = |problem| Error { problem, offset: 0, path: String::new() };
        let Some((header, body)) = bytes.split_first_chunk::<HEADER_SIZE>() else {
            return Err(fail(Problem::TooShort { needed: HEADER_SIZE, left: bytes.len() }));
        };
        let endianness = match u16::from_be_bytes([header[0], header[1]]) {
            0x0000 => Endianness::Big,
            0x0001 => Endianness::Little,
            other => return Err(fail(Problem::Representation(other))),
        };
        Ok(Self { body, position: 0, endianness })
    }

    /// The byte order the header names.
    #[must_use]
    pub fn endianness(&self) -> Endianness {
        self.endianness
    }

    /// How many bytes have not been read.
    #[must_use]
    pub fn left(&self) -> usize {
        self.body.len() - self.position
    }

    /// Reads a value; errors name the field.
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn field<T: Cdr>(&mut self, name: &'static str) -> Result<T> {
        T::decode(self).map_err(|error| error.in_field(name))
    }

    /// As [`Reader::field`], for a sequence of at most `bound` elements.
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn bounded_field<T: Cdr>(&mut self, name: &'static str, bound: usize) -> Result<Vec<T>> {
        self.bounded_sequence(bound).map_err(|error| error.in_field(name))
    }

    /// As [`Reader::field`], for strings of at most `bound` bytes (wide strings: UTF-16 code units), alone or several.
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn text_field<T: Cdr + Text>(&mut self, name: &'static str, bound: usize) -> Result<T> {
        let value: T = self.field(name)?;
        self.check_text(value, bound).map_err(|error| error.in_field(name))
    }

    /// As [`Reader::field`], for a sequence of at most `bound` strings, each of at most `text_bound` as in
    /// [`Reader::text_field`].
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn bounded_texts_field<T: Cdr + Text>(
        &mut self,
        name: &'static str,
        bound: usize,
        text_bound: usize,
    ) -> Result<Vec<T>> {
        self.bounded_sequence(bound)
            .and_then(|values| self.check_text(values, text_bound))
            .map_err(|error| error.in_field(name))
    }

    /// Reads what stands for a message without fields: one byte of any value.
    ///
    /// # Errors
    /// If there is none.
    pub fn empty_message(&mut self) -> Result<()> {
        self.bytes(1).map(|_| ())
    }

    /// Reads a length, and checks that so many elements of at least `least_size` bytes can follow.
    ///
    /// # Errors
    /// If they cannot.
    pub fn length(&mut self, least_size: usize) -> Result<usize> {
        let count = u32::decode(self)? as usize;
        let left = self.left();
        if count > left / least_size.max(1) {
            return Err(self.error(Problem::Length { count, least_size, left }));
        }
        Ok(count)
    }

    /// Skips to the next multiple of `alignment`, a power of two.
    ///
    /// # Errors
    /// If the input ends before.
    pub fn align(&mut self, alignment: usize) -> Result<()> {
        self.bytes(self.position.next_multiple_of(alignment) - self.position).map(|_| ())
    }

    /// Reads bytes as they are.
    ///
    /// # Errors
    /// If there are fewer.
    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8]> {
        match self.body[self.position..].get(..count) {
            Some(bytes) => {
                self.position += count;
                Ok(bytes)
            }
            None => Err(self.error(Problem::TooShort { needed: count, left: self.left() })),
        }
    }

    /// An error at the present position.
    #[must_use]
    #[cold]
    pub fn error(&self, problem: Problem) -> Error {
        Error { problem, offset: HEADER_SIZE + self.position, path: String::new() }
    }

    fn bounded_sequence<T: Cdr>(&mut self, bound: usize) -> Result<Vec<T>> {
        let found = self.length(T::LEAST_SIZE)?;
        if found > bound {
            return Err(self.error(Problem::Bound { found, bound }));
        }
        T::decode_vec(found, self)
    }

    fn check_text<T: Text>(&self, value: T, bound: usize) -> Result<T> {
        match value.longest() {
            found if found > bound => Err(self.error(Problem::Bound { found, bound })),
            _ => Ok(value),
        }
    }
}
