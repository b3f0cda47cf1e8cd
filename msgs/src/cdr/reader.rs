//! Reading CDR from bytes.

use super::plain::PlainReader;
use super::representation::{Encoding, Endianness, split};
use super::{Cdr, Count, Error, FromReader, HEADER_SIZE, Plain, Problem, Result, Sequence, Text};

/// Reads the parts of a serialised value one after another. Alignment counts from behind the header.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    /// Up to where may be read now: less than there is while within something delimited.
    body: &'a [u8],
    position: usize,
    encoding: Encoding,
    endianness: Endianness,
}

impl<'a> Reader<'a> {
    /// Reads the header.
    ///
    /// # Errors
    /// If there is none, or it names a representation that no ROS 2 type is sent in.
    pub fn new(bytes: &'a [u8]) -> Result<Self> {
        let (encoding, endianness, body) = split(bytes)?;
        Ok(Self { body, position: 0, encoding, endianness })
    }

    /// The byte order the header names.
    #[inline]
    #[must_use]
    pub fn endianness(&self) -> Endianness {
        self.endianness
    }

    /// The rules of layout the header names.
    #[inline]
    #[must_use]
    pub fn encoding(&self) -> Encoding {
        self.encoding
    }

    /// How many bytes have not been read.
    #[inline]
    #[must_use]
    pub fn left(&self) -> usize {
        self.body.len() - self.position
    }

    /// Reads a value; errors name the field.
    ///
    /// # Errors
    /// If the bytes are no such value.
    #[inline]
    pub fn field<T: FromReader<'a>>(&mut self, name: &'static str) -> Result<T> {
        T::from_reader(self).map_err(|error| error.in_field(name))
    }

    /// As [`Reader::field`], for a sequence of at most `bound` elements.
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn bounded_field<T: FromReader<'a> + Count>(
        &mut self,
        name: &'static str,
        bound: usize,
    ) -> Result<T> {
        self.bounded(bound, T::count).map_err(|error| error.in_field(name))
    }

    /// As [`Reader::field`], for strings of at most `bound` bytes (wide strings: UTF-16 code units), alone or several.
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn text_field<T: FromReader<'a> + Text>(&mut self, name: &'static str, bound: usize) -> Result<T> {
        self.bounded(bound, T::longest).map_err(|error| error.in_field(name))
    }

    /// As [`Reader::field`], for a sequence of at most `bound` strings, each of at most `text_bound` as in
    /// [`Reader::text_field`].
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn bounded_texts_field<T: FromReader<'a> + Count + Text>(
        &mut self,
        name: &'static str,
        bound: usize,
        text_bound: usize,
    ) -> Result<T> {
        let start = self.clone();
        self.bounded_field(name, bound).and_then(|texts| {
            start.check(texts, text_bound, T::longest).map_err(|error| error.in_field(name))
        })
    }

    /// As [`Reader::field`], for the view of an array.
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn array_field<V: FromReader<'a>>(
        &mut self,
        name: &'static str,
        count: usize,
    ) -> Result<Sequence<'a, V>> {
        Sequence::of_array(count, self).map_err(|error| error.in_field(name))
    }

    /// As [`Reader::array_field`], for strings as in [`Reader::text_field`].
    ///
    /// # Errors
    /// If the bytes are no such value.
    pub fn texts_array_field<V: FromReader<'a> + Text>(
        &mut self,
        name: &'static str,
        count: usize,
        text_bound: usize,
    ) -> Result<Sequence<'a, V>> {
        let start = self.clone();
        let texts = Sequence::of_array(count, self);
        texts
            .and_then(|texts| start.check(texts, text_bound, Text::longest))
            .map_err(|error| error.in_field(name))
    }

    /// Reads the fields of a message, which `fields` reads one after another.
    ///
    /// # Errors
    /// Those of `fields`, and if the message says that it is longer than the input.
    #[inline]
    pub fn message<T>(&mut self, fields: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        self.delimited(self.encoding == Encoding::Delimited2, fields)
    }

    /// Reads a sequence (its length included) or an array, which `read` does. Its elements are numbers or truth
    /// values, or they are not.
    ///
    /// # Errors
    /// Those of `read`, and if the collection says that it is longer than the input.
    #[inline]
    pub fn elements<T>(
        &mut self,
        are_primitive: bool,
        read: impl FnOnce(&mut Self) -> Result<T>,
    ) -> Result<T> {
        self.delimited(!are_primitive && self.encoding != Encoding::Plain1, read)
    }

    /// Reads as many values of fixed layout as the slice has places.
    ///
    /// # Errors
    /// If the bytes end before.
    pub fn plain_slice<T: Plain + Cdr>(&mut self, values: &mut [T]) -> Result<()> {
        if let Some(bytes) = self.plain_bytes::<T>(values.len()) {
            T::get_slice(values, &mut PlainReader::new(bytes, self.endianness));
            return Ok(());
        }
        for (index, value) in values.iter_mut().enumerate() {
            *value = T::decode(self).map_err(|error| error.at_index(index))?;
        }
        Ok(())
    }

    /// Reads so many values of fixed layout.
    ///
    /// # Errors
    /// If the bytes end before.
    pub fn plain_vec<T: Plain + Cdr>(&mut self, count: usize) -> Result<Vec<T>> {
        if let Some(bytes) = self.plain_bytes::<T>(count) {
            return Ok(T::collect(bytes, self.endianness));
        }
        (0..count).map(|index| T::decode(self).map_err(|error| error.at_index(index))).collect()
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
    #[inline]
    pub fn length(&mut self, least_size: usize) -> Result<usize> {
        let count = self.count()?;
        let left = self.left();
        if count > left / least_size.max(1) {
            return Err(self.error(Problem::Length { count, least_size, left }));
        }
        Ok(count)
    }

    /// Skips to the next multiple of `alignment`, a power of two; of 4 in XCDR version 2 if it is 8.
    ///
    /// # Errors
    /// If the input ends before.
    #[inline]
    pub fn align(&mut self, alignment: usize) -> Result<()> {
        self.bytes(self.aligned(alignment) - self.position).map(|_| ())
    }

    /// Reads bytes as they are.
    ///
    /// # Errors
    /// If there are fewer.
    #[inline]
    pub fn bytes(&mut self, count: usize) -> Result<&'a [u8]> {
        match self.body[self.position..].get(..count) {
            Some(bytes) => {
                self.position += count;
                Ok(bytes)
            }
            None => Err(self.too_short(count)),
        }
    }

    /// An error at the present position.
    #[must_use]
    #[cold]
    pub fn error(&self, problem: Problem) -> Error {
        Error { problem, offset: HEADER_SIZE + self.position, path: String::new() }
    }

    /// Reads the bytes of a number, which is aligned to its size.
    #[inline]
    pub(super) fn number<const N: usize>(&mut self) -> Result<[u8; N]> {
        let start = self.aligned(N);
        match self.body.get(start..).and_then(|rest| rest.first_chunk()) {
            Some(bytes) => {
                self.position = start + N;
                Ok(*bytes)
            }
            None => Err(self.number_cut_off(N)),
        }
    }

    /// Reads the bytes of so many numbers.
    #[inline]
    pub(super) fn numbers<T: Plain + Cdr>(&mut self, count: usize) -> Result<&'a [u8]> {
        match self.plain_bytes::<T>(count) {
            Some(bytes) => Ok(bytes),
            None => self.plain_vec::<T>(count).map(|_| [].as_slice()),
        }
    }

    /// Reads a value of fixed layout, if its bytes are side by side and all there.
    #[inline]
    pub(super) fn plain<T: Plain>(&mut self) -> Option<T> {
        let bytes = self.plain_bytes::<T>(1)?;
        Some(match self.endianness {
            Endianness::Little => T::get(&mut PlainReader::new(bytes, Endianness::Little)),
            Endianness::Big => big(bytes),
        })
    }

    /// The bytes of so many values side by side, if they are that and are all there.
    #[inline]
    fn plain_bytes<T: Plain>(&mut self, count: usize) -> Option<&'a [u8]> {
        if count == 0 {
            return Some(&[]); // No padding either.
        }
        if self.encoding == Encoding::Delimited2 && !T::IS_NUMBER {
            return None;
        }
        let start = self.aligned(T::ALIGNMENT);
        let bytes = self.body.get(start..)?.get(..count.checked_mul(T::SIZE)?)?;
        self.position = start + bytes.len();
        Some(bytes)
    }

    /// The next multiple of an alignment.
    #[inline]
    fn aligned(&self, alignment: usize) -> usize {
        self.position.next_multiple_of(alignment.min(self.encoding.greatest_alignment()))
    }

    #[inline]
    fn count(&mut self) -> Result<usize> {
        let bytes = self.number()?;
        Ok(match self.endianness {
            Endianness::Little => u32::from_le_bytes(bytes),
            Endianness::Big => u32::from_be_bytes(bytes),
        } as usize)
    }

    #[inline]
    fn delimited<T>(&mut self, has_size: bool, read: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        let outer = if has_size { Some(self.begin_delimited()?) } else { None };
        let value = read(self)?;
        if let Some(outer) = outer {
            // What the sender has more than we know is passed over.
            self.position = self.body.len();
            self.body = outer;
        }
        Ok(value)
    }

    /// Reads a size, and ends the body behind so many bytes. Returns the body there was.
    #[cold]
    fn begin_delimited(&mut self) -> Result<&'a [u8]> {
        let size = self.length(1)?;
        let outer = self.body;
        self.body = &outer[..self.position + size];
        Ok(outer)
    }

    fn bounded<T: FromReader<'a>>(&mut self, bound: usize, measure: fn(&T) -> usize) -> Result<T> {
        let start = self.clone();
        let value = T::from_reader(self)?;
        start.check(value, bound, measure)
    }

    fn check<T>(&self, value: T, bound: usize, measure: fn(&T) -> usize) -> Result<T> {
        match measure(&value) {
            found if found > bound => Err(self.error(Problem::Bound { found, bound })),
            _ => Ok(value),
        }
    }

    #[cold]
    fn number_cut_off(&mut self, size: usize) -> Error {
        match self.align(size) {
            Ok(()) => self.too_short(size),
            Err(error) => error,
        }
    }

    #[cold]
    fn too_short(&self, needed: usize) -> Error {
        self.error(Problem::TooShort { needed, left: self.left() })
    }
}

/// Apart from the reading of what everyone sends, so that this stays small.
#[cold]
#[inline(never)]
fn big<T: Plain>(bytes: &[u8]) -> T {
    T::get(&mut PlainReader::new(bytes, Endianness::Big))
}
