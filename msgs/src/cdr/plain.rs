//! Values that all have one layout, which are copied as a whole.

use super::{Cdr, Endianness, Reader, Result, Writer};

/// A type whose values all have one layout: nothing in them depends on where they stand, and side by side they need no
/// padding. The numbers are plain, and messages whose fields are, as `geometry_msgs/msg/Pose`.
///
/// The layout is the same in both versions of XCDR, but for where a value begins: see [`Plain::ALIGNMENT`].
pub trait Plain: Copy {
    /// A value begins at a multiple of it; in XCDR version 2 at a multiple of 4 if it is 8.
    const ALIGNMENT: usize;

    /// Bytes of a value, a multiple of the alignment.
    const SIZE: usize;

    /// Whether it is a number itself, and not a message or array of such.
    #[doc(hidden)]
    const IS_NUMBER: bool = false;

    /// Writes the value.
    fn put(&self, run: &mut PlainWriter<'_>);

    /// Reads a value.
    fn get(run: &mut PlainReader<'_>) -> Self;

    /// Writes values one after another.
    #[inline]
    fn put_slice(values: &[Self], run: &mut PlainWriter<'_>) {
        let places = run.take(values.len() * Self::SIZE);
        for (value, place) in values.iter().zip(places.chunks_exact_mut(Self::SIZE)) {
            value.put(&mut PlainWriter { left: place });
        }
    }

    /// Reads as many values as the slice has places.
    #[inline]
    fn get_slice(values: &mut [Self], run: &mut PlainReader<'_>) {
        let endianness = run.endianness;
        let places = run.take(values.len() * Self::SIZE);
        for (value, place) in values.iter_mut().zip(places.chunks_exact(Self::SIZE)) {
            *value = Self::get(&mut PlainReader { left: place, endianness });
        }
    }

    /// Reads as many values as the array has places.
    #[inline]
    fn get_array<const N: usize>(run: &mut PlainReader<'_>) -> [Self; N] {
        std::array::from_fn(|_| Self::get(run))
    }

    /// The values as bytes, if that is what they are.
    #[doc(hidden)]
    #[inline]
    fn as_bytes(_values: &[Self]) -> Option<&[u8]> {
        None
    }

    /// Values that were written one after another, with nothing behind them.
    #[doc(hidden)]
    #[inline]
    fn collect(bytes: &[u8], endianness: Endianness) -> Vec<Self> {
        bytes
            .chunks_exact(Self::SIZE)
            .map(|place| Self::get(&mut PlainReader { left: place, endianness }))
            .collect()
    }
}

impl<T: Plain, const N: usize> Plain for [T; N] {
    const ALIGNMENT: usize = T::ALIGNMENT;
    const SIZE: usize = T::SIZE * N;

    #[inline]
    fn put(&self, run: &mut PlainWriter<'_>) {
        T::put_slice(self, run);
    }

    #[inline]
    fn get(run: &mut PlainReader<'_>) -> Self {
        T::get_array(run)
    }
}

/// Where a [`Plain`] value is written: exactly its bytes.
///
/// Writing more than these panics, which only a wrong [`Plain::SIZE`] can cause.
#[derive(Debug)]
pub struct PlainWriter<'a> {
    left: &'a mut [u8],
}

impl<'a> PlainWriter<'a> {
    #[inline]
    pub(super) fn new(place: &'a mut [u8]) -> Self {
        Self { left: place }
    }

    /// Writes a part.
    #[inline]
    pub fn put<T: Plain>(&mut self, part: &T) {
        part.put(self);
    }

    /// Leaves bytes as they are: zero.
    #[inline]
    pub fn skip(&mut self, count: usize) {
        self.take(count);
    }

    #[inline]
    pub(super) fn take(&mut self, count: usize) -> &'a mut [u8] {
        let (taken, left) = std::mem::take(&mut self.left).split_at_mut(count);
        self.left = left;
        taken
    }
}

/// Where a [`Plain`] value is read from: exactly its bytes.
///
/// Reading more than these panics, which only a wrong [`Plain::SIZE`] can cause.
#[derive(Debug)]
pub struct PlainReader<'a> {
    left: &'a [u8],
    endianness: Endianness,
}

impl<'a> PlainReader<'a> {
    #[inline]
    pub(super) fn new(place: &'a [u8], endianness: Endianness) -> Self {
        Self { left: place, endianness }
    }

    /// Reads a part.
    #[inline]
    pub fn get<T: Plain>(&mut self) -> T {
        T::get(self)
    }

    /// Leaves bytes out.
    #[inline]
    pub fn skip(&mut self, count: usize) {
        self.take(count);
    }

    /// The byte order of what is read.
    #[inline]
    #[must_use]
    pub fn endianness(&self) -> Endianness {
        self.endianness
    }

    #[inline]
    pub(super) fn take(&mut self, count: usize) -> &'a [u8] {
        let (taken, left) = self.left.split_at(count);
        self.left = left;
        taken
    }
}

/// Where the last of so many values ends, if they may begin at `position`.
#[inline]
pub(super) const fn plain_end<T: Plain>(count: usize, position: usize) -> usize {
    if count == 0 {
        return position; // No padding either.
    }
    position.next_multiple_of(T::ALIGNMENT) + count * T::SIZE
}

/// A message whose values all have one layout.
pub trait PlainMessage: Plain {
    /// Reads a value field by field: where messages begin with their sizes, and to find which field is cut off.
    ///
    /// # Errors
    /// If the bytes end too early.
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
