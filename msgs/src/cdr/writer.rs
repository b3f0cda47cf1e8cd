//! Appending CDR to a buffer.

use super::{Cdr, HEADER_SIZE, Plain, PlainWriter};

/// The number of bytes zeroed at a time, before they are overwritten: fits into a first-level cache.
const BLOCK: usize = 2048;

/// From this size, bytes are appended to the buffer instead of overwriting zeros, to avoid writing them
/// twice.
const MANY: usize = 512;

/// Appends little-endian CDR to a buffer. Alignment is relative to the start of the writer.
///
/// The buffer is returned to its owner when the writer is dropped.
// Numbers overwrite existing zeros, so that padding is free and the buffer rarely grows.
#[derive(Debug)]
pub struct Writer<'a> {
    target: &'a mut Vec<u8>,
    /// The previous contents of the target, the written bytes, and zeros to be overwritten.
    buffer: Vec<u8>,
    /// The end of the written bytes.
    end: usize,
    origin: usize,
}

impl<'a> Writer<'a> {
    /// Appends to the buffer.
    pub fn new(target: &'a mut Vec<u8>) -> Self {
        let buffer = std::mem::take(target);
        let end = buffer.len();
        Self { target, buffer, end, origin: end }
    }

    /// Replaces the contents of the buffer, starting with a header. `size` is the expected size including the
    /// header.
    #[inline]
    pub(super) fn with_header(target: &'a mut Vec<u8>, size: usize) -> Self {
        let mut buffer = std::mem::take(target);
        buffer.clear();
        buffer.reserve_exact(size);
        buffer.resize(size.clamp(HEADER_SIZE, BLOCK), 0);
        buffer[1] = 1;
        Self { target, buffer, end: HEADER_SIZE, origin: HEADER_SIZE }
    }

    /// Appends a value.
    #[inline]
    pub fn value<T: Cdr>(&mut self, value: &T) {
        value.encode(self);
    }

    /// Appends a value of fixed layout.
    #[inline]
    pub fn plain<T: Plain>(&mut self, value: &T) {
        let padding = self.padding(T::ALIGNMENT);
        value.put(&mut PlainWriter::new(self.places(padding, T::SIZE)));
    }

    /// Appends values of fixed layout.
    #[inline]
    pub fn plain_slice<T: Plain>(&mut self, values: &[T]) {
        if values.is_empty() {
            return; // No padding either.
        }
        self.align(T::ALIGNMENT);
        if let Some(bytes) = T::as_bytes(values) {
            self.bytes(bytes);
            return;
        }
        // Block by block, so that the overwritten zeros are still in the cache.
        for block in values.chunks((BLOCK / T::SIZE).max(1)) {
            T::put_slice(block, &mut PlainWriter::new(self.places(0, block.len() * T::SIZE)));
        }
    }

    /// Appends a message without fields: one zero byte.
    pub fn empty_message(&mut self) {
        self.places(0, 1);
    }

    /// Appends the length of a string or sequence.
    ///
    /// # Panics
    /// Panics if it exceeds 32 bits.
    #[inline]
    pub fn length(&mut self, length: usize) {
        match u32::try_from(length) {
            Ok(length) => self.number(length.to_le_bytes()),
            Err(_) => too_long(length),
        }
    }

    /// Appends zeros until the position is a multiple of `alignment`, a power of two.
    #[inline]
    pub fn align(&mut self, alignment: usize) {
        self.places(self.padding(alignment), 0);
    }

    /// Appends raw bytes.
    #[inline]
    pub fn bytes(&mut self, bytes: &[u8]) {
        if bytes.len() < MANY {
            copy(bytes, self.places(0, bytes.len()));
        } else {
            self.many_bytes(bytes);
        }
    }

    /// Appends a string and a terminating zero.
    #[inline]
    pub(super) fn text(&mut self, text: &str) {
        let text = text.as_bytes();
        if text.len() >= MANY {
            self.length(text.len() + 1);
            self.many_bytes(text);
            self.places(0, 1);
            return;
        }
        // In one step, since each store of the end would delay the next one.
        let (length, rest) = self.places(self.padding(4), 4 + text.len() + 1).split_at_mut(4);
        length.copy_from_slice(&(text.len() as u32 + 1).to_le_bytes());
        copy(text, &mut rest[..text.len()]);
    }

    /// Appends a number, aligned to its size.
    #[inline]
    pub(super) fn number<const N: usize>(&mut self, number: [u8; N]) {
        self.places(self.padding(N), N).copy_from_slice(&number);
    }

    /// The distance to the next multiple of an alignment, a power of two.
    #[inline]
    fn padding(&self, alignment: usize) -> usize {
        self.origin.wrapping_sub(self.end) & (alignment - 1)
    }

    /// Appends padding and `count` zero bytes, and returns the latter for writing.
    #[inline]
    fn places(&mut self, padding: usize, count: usize) -> &mut [u8] {
        let start = self.end + padding;
        self.end = start + count;
        if self.end > self.buffer.len() {
            self.grow();
        }
        &mut self.buffer[start..][..count]
    }

    /// Adds zeros up to the end, and beyond it if capacity permits.
    #[cold]
    #[inline(never)]
    fn grow(&mut self) {
        self.buffer.reserve(self.end - self.buffer.len());
        self.buffer.resize(self.buffer.capacity().min(self.end + BLOCK), 0);
    }

    #[inline(never)]
    fn many_bytes(&mut self, bytes: &[u8]) {
        self.buffer.truncate(self.end);
        self.buffer.extend_from_slice(bytes);
        self.end = self.buffer.len();
    }
}

impl Drop for Writer<'_> {
    fn drop(&mut self) {
        self.buffer.truncate(self.end);
        *self.target = std::mem::take(&mut self.buffer);
    }
}

/// Copies bytes; small copies are two overlapping words instead of a call.
#[inline]
fn copy(from: &[u8], to: &mut [u8]) {
    fn ends<const N: usize>(from: &[u8], to: &mut [u8]) -> Option<()> {
        *to.first_chunk_mut()? = *from.first_chunk::<N>()?;
        *to.last_chunk_mut()? = *from.last_chunk::<N>()?;
        Some(())
    }
    let copied = match from.len() {
        8..16 => ends::<8>(from, to),
        16..32 => ends::<16>(from, to),
        4..8 => ends::<4>(from, to),
        _ => None,
    };
    if copied.is_none() {
        to.copy_from_slice(from);
    }
}

#[cold]
fn too_long(length: usize) {
    panic!("cannot encode {length} elements: CDR lengths have 32 bits");
}
