//! Reading CDR from bytes.

use super::plain::PlainReader;
use super::{Cdr, Endianness, Error, HEADER_SIZE, Plain, Problem, Representation, Result, split};
use downbeat_msgs_definitions::Shape;

/// Reads the parts of a serialised value one after another. Alignment is relative to the end of the header.
#[derive(Clone, Debug)]
pub struct Reader<'a> {
    /// The readable part: shorter than the input while reading a delimited value.
    body: &'a [u8],
    position: usize,
    representation: Representation,
    endianness: Endianness,
}

impl<'a> Reader<'a> {
    /// Reads the header.
    ///
    /// # Errors
    /// Returns an error if there is no header, or it names a representation that ROS 2 does not use.
    pub fn new(bytes: &'a [u8]) -> Result<Self> {
        let (representation, endianness, body) = split(bytes)?;
        Ok(Self { body, position: 0, representation, endianness })
    }

    /// The byte order in the header.
    #[inline]
    #[must_use]
    pub fn endianness(&self) -> Endianness {
        self.endianness
    }

    /// The encoding rules in the header.
    #[inline]
    #[must_use]
    pub fn representation(&self) -> Representation {
        self.representation
    }

    /// The number of unread bytes.
    #[inline]
    #[must_use]
    pub fn left(&self) -> usize {
        self.body.len() - self.position
    }

    /// Reads the fields of a message, which `fields` reads one after another.
    ///
    /// # Errors
    /// Those of `fields`, and if the declared size exceeds the input.
    #[inline]
    pub fn message<T>(&mut self, fields: impl FnOnce(&mut Self) -> Result<T>) -> Result<T> {
        self.delimited(self.representation == Representation::Delimited2, fields)
    }

    /// Reads a sequence (including its length) or an array with `read`. Its elements are numbers or truth
    /// values, or they are not.
    ///
    /// # Errors
    /// Those of `read`, and if the declared size exceeds the input.
    #[inline]
    pub fn elements<T>(
        &mut self,
        are_primitive: bool,
        read: impl FnOnce(&mut Self) -> Result<T>,
    ) -> Result<T> {
        self.delimited(!are_primitive && self.representation != Representation::Plain1, read)
    }

    /// Fills the slice with values of fixed layout.
    ///
    /// # Errors
    /// Returns an error if the input ends before.
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

    /// Reads `count` values of fixed layout.
    ///
    /// # Errors
    /// Returns an error if the input ends before.
    pub fn plain_vec<T: Plain + Cdr>(&mut self, count: usize) -> Result<Vec<T>> {
        if let Some(bytes) = self.plain_bytes::<T>(count) {
            return Ok(T::collect(bytes, self.endianness));
        }
        (0..count).map(|index| T::decode(self).map_err(|error| error.at_index(index))).collect()
    }

    /// Reads a message without fields: one byte of any value.
    ///
    /// # Errors
    /// Returns an error if the input is at its end.
    pub fn empty_message(&mut self) -> Result<()> {
        self.bytes(1).map(|_| ())
    }

    /// Reads a length, and checks that the input can hold that many elements of at least `least_size` bytes.
    ///
    /// # Errors
    /// Returns an error if the input is too short for that many elements.
    #[inline]
    pub fn length(&mut self, least_size: usize) -> Result<usize> {
        let count = self.count()?;
        let left = self.left();
        if count > left / least_size.max(1) {
            return Err(self.error(Problem::Length { count, least_size, left }));
        }
        Ok(count)
    }

    /// Reads the number of elements of a field of a shape, and checks it against the shape and the rest of
    /// the input.
    ///
    /// # Errors
    /// Returns an error if the bound is exceeded, or the input is too short for that many elements.
    pub(crate) fn length_of(&mut self, shape: Shape, least_size: usize) -> Result<usize> {
        let size = |count: u64| usize::try_from(count).unwrap_or(usize::MAX);
        match shape {
            Shape::Single => Ok(1),
            Shape::Array(count) => {
                let (count, left) = (size(count), self.left());
                if count > left / least_size.max(1) {
                    let needed = count.saturating_mul(least_size);
                    return Err(self.error(Problem::TooShort { needed, left }));
                }
                Ok(count)
            }
            Shape::Sequence => self.length(least_size),
            Shape::Bounded(bound) => {
                let (found, bound) = (self.length(least_size)?, size(bound));
                if found > bound { Err(self.error(Problem::Bound { found, bound })) } else { Ok(found) }
            }
        }
    }

    /// Skips to the next multiple of `alignment`, a power of two; of 4 in XCDR version 2 if it is 8.
    ///
    /// # Errors
    /// Returns an error if the input ends before.
    #[inline]
    pub fn align(&mut self, alignment: usize) -> Result<()> {
        self.bytes(self.aligned(alignment) - self.position).map(|_| ())
    }

    /// Reads raw bytes.
    ///
    /// # Errors
    /// Returns an error if there are fewer.
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

    /// Creates an error at the current position.
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

    /// Reads the bytes of `count` numbers.
    #[inline]
    pub(super) fn numbers<T: Plain + Cdr>(&mut self, count: usize) -> Result<&'a [u8]> {
        match self.plain_bytes::<T>(count) {
            Some(bytes) => Ok(bytes),
            None => self.plain_vec::<T>(count).map(|_| [].as_slice()),
        }
    }

    /// Reads a value of fixed layout, if its bytes are contiguous and complete.
    #[inline]
    pub(super) fn plain<T: Plain>(&mut self) -> Option<T> {
        let bytes = self.plain_bytes::<T>(1)?;
        Some(match self.endianness {
            Endianness::Little => T::get(&mut PlainReader::new(bytes, Endianness::Little)),
            Endianness::Big => big(bytes),
        })
    }

    /// The bytes of `count` values, if they are contiguous and complete.
    #[inline]
    fn plain_bytes<T: Plain>(&mut self, count: usize) -> Option<&'a [u8]> {
        if count == 0 {
            return Some(&[]); // No padding either.
        }
        if self.representation == Representation::Delimited2 && !T::IS_NUMBER {
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
        self.position.next_multiple_of(alignment.min(self.representation.greatest_alignment()))
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
            // Skips fields of the sender that we do not know.
            self.position = self.body.len();
            self.body = outer;
        }
        Ok(value)
    }

    /// Reads a size, and limits the body to that many bytes. Returns the previous body.
    #[cold]
    fn begin_delimited(&mut self) -> Result<&'a [u8]> {
        let size = self.length(1)?;
        let outer = self.body;
        self.body = &outer[..self.position + size];
        Ok(outer)
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

/// Separate from the common case, so that this stays small.
#[cold]
#[inline(never)]
fn big<T: Plain>(bytes: &[u8]) -> T {
    T::get(&mut PlainReader::new(bytes, Endianness::Big))
}
