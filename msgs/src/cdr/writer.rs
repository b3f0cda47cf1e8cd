//! Appending CDR to a buffer.

use super::Cdr;

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
    pub fn value<T: Cdr>(&mut self, value: &T) {
        value.encode(self);
    }

    /// Appends what stands for a message without fields: one zero byte.
    pub fn empty_message(&mut self) {
        self.buffer.push(0);
    }

    /// Appends the length of a string or sequence.
    ///
    /// # Panics
    /// If it exceeds 32 bits.
    pub fn length(&mut self, length: usize) {
        let Ok(length) = u32::try_from(length) else {
            panic!("cannot encode {length} elements: CDR lengths have 32 bits");
        };
        self.value(&length);
    }

    /// Appends zeros until the position is a multiple of `alignment`, a power of two.
    pub fn align(&mut self, alignment: usize) {
        let written = self.buffer.len() - self.origin;
        let padded = written.next_multiple_of(alignment);
        if padded != written {
            self.buffer.resize(self.origin + padded, 0);
        }
    }

    /// Appends bytes as they are.
    pub fn bytes(&mut self, bytes: &[u8]) {
        self.buffer.extend_from_slice(bytes);
    }

    /// Makes room for so many bytes, so that appending them does not move what is there.
    pub(super) fn reserve(&mut self, count: usize) {
        self.buffer.reserve(count);
    }

    /// Appends so many zero bytes and lends them out to be filled.
    pub(super) fn zeros(&mut self, count: usize) -> &mut [u8] {
        let start = self.buffer.len();
        self.buffer.resize(start + count, 0);
        &mut self.buffer[start..]
    }
}
