//! Appending CDR to a buffer.

use super::{Cdr, Plain, PlainWriter};

/// Bytes that are written at a time: a part of a first-level cache.
const BLOCK: usize = 8192;

/// Appends little-endian CDR to a buffer. Alignment counts from where the writer began.
#[derive(Debug)]
pub struct Writer<'a> {
    buffer: &'a mut Vec<u8>,
    origin: usize,
}

impl<'a> Writer<'a> {
    /// Begins behind what the buffer holds.
    pub fn new(buffer: &'a mut Vec<u8>) -> Self {
        let origin = buffer.len();
        Self { buffer, origin }
    }

    /// Appends a value.
    #[inline]
    pub fn value<T: Cdr>(&mut self, value: &T) {
        value.encode(self);
    }

    /// Appends a value of fixed layout.
    #[inline]
    pub fn plain<T: Plain>(&mut self, value: &T) {
        self.align(T::ALIGNMENT);
        value.put(&mut PlainWriter::new(self.zeros(T::SIZE)));
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
        self.buffer.reserve(values.len() * T::SIZE);
        // Block by block, so that the zeros that are written over are still in the cache.
        for block in values.chunks((BLOCK / T::SIZE).max(1)) {
            T::put_slice(block, &mut PlainWriter::new(self.zeros(block.len() * T::SIZE)));
        }
    }

    /// Appends what stands for a message without fields: one zero byte.
    pub fn empty_message(&mut self) {
        self.buffer.push(0);
    }

    /// Appends the length of a string or sequence.
    ///
    /// # Panics
    /// If it exceeds 32 bits.
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
        let padding = self.padding(alignment);
        self.append_first([0; 8], padding);
    }

    /// Appends bytes as they are.
    #[inline]
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// Appends a number, aligned to its size.
    #[inline]
    pub(super) fn number<const N: usize>(&mut self, number: [u8; N]) {
        // Padding and number are one word, shifted to where the number belongs: no branch depends on the padding.
        let padding = self.padding(N);
        if N <= 4 {
            let mut word = [0; 8];
            word[..N].copy_from_slice(&number);
            let word = u64::from_le_bytes(word) << (8 * padding);
            self.append_first(word.to_le_bytes(), padding + N);
        } else {
            let mut word = [0; 16];
            word[..N].copy_from_slice(&number);
            let word = u128::from_le_bytes(word) << (8 * padding);
            self.append_first(word.to_le_bytes(), padding + N);
        }
    }

    fn padding(&self, alignment: usize) -> usize {
        self.origin.wrapping_sub(self.buffer.len()) & (alignment - 1)
    }

    /// Appends the first `count` bytes of a word.
    #[inline]
    fn append_first<const N: usize>(&mut self, word: [u8; N], count: usize) {
        let written = self.buffer.len();
        if self.buffer.capacity() - written >= N {
            // All of it, which is one instruction, and back.
            self.buffer.extend_from_slice(&word);
            self.buffer.truncate(written + count);
        } else {
            self.buffer.extend_from_slice(&word[..count]);
        }
    }

    /// Appends so many zero bytes and lends them out to be filled.
    #[inline]
    fn zeros(&mut self, count: usize) -> &mut [u8] {
        let start = self.buffer.len();
        self.buffer.resize(start + count, 0);
        &mut self.buffer[start..]
    }
}

#[cold]
fn too_long(length: usize) {
    panic!("cannot encode {length} elements: CDR lengths have 32 bits");
}
