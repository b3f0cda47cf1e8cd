//! Values with a fixed layout, which are copied as a whole.

use super::Endianness;

/// A type whose values all have the same layout, independent of their position, without padding between
/// consecutive values: numbers, and messages of such fields, for example `geometry_msgs/msg/Pose`.
///
/// The layout is the same in both versions of XCDR, except for the start of a value: see
/// [`Plain::ALIGNMENT`].
pub trait Plain: Copy {
    /// A value starts at a multiple of it; in XCDR version 2 at a multiple of 4 if it is 8.
    const ALIGNMENT: usize;

    /// The size of a value in bytes, a multiple of the alignment.
    const SIZE: usize;

    /// Whether it is a number rather than a message or array.
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

    /// Fills the slice with values.
    #[inline]
    fn get_slice(values: &mut [Self], run: &mut PlainReader<'_>) {
        let endianness = run.endianness;
        let places = run.take(values.len() * Self::SIZE);
        for (value, place) in values.iter_mut().zip(places.chunks_exact(Self::SIZE)) {
            *value = Self::get(&mut PlainReader { left: place, endianness });
        }
    }

    /// Reads an array of values.
    #[inline]
    fn get_array<const N: usize>(run: &mut PlainReader<'_>) -> [Self; N] {
        std::array::from_fn(|_| Self::get(run))
    }

    /// The values as bytes, if they are bytes.
    #[doc(hidden)]
    #[inline]
    fn as_bytes(_values: &[Self]) -> Option<&[u8]> {
        None
    }

    /// Reads all consecutive values in `bytes`.
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

/// The destination of a [`Plain`] value: exactly its bytes.
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

    /// Leaves bytes zero.
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

/// The source of a [`Plain`] value: exactly its bytes.
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

    /// Skips bytes.
    #[inline]
    pub fn skip(&mut self, count: usize) {
        self.take(count);
    }

    /// The byte order of the input.
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

/// The end of `count` values that start at or after `position`.
#[inline]
pub(super) const fn plain_end<T: Plain>(count: usize, position: usize) -> usize {
    if count == 0 {
        return position; // No padding either.
    }
    position.next_multiple_of(T::ALIGNMENT) + count * T::SIZE
}
