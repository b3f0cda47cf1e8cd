//! Reads and writes numbers in either byte order and checks every length.

use super::Malformed;

/// Order of the bytes of a number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ByteOrder {
    Big,
    Little,
}

/// Reads bytes from front to back. Reading past the end fails with [`Malformed::Truncated`].
#[derive(Clone, Copy, Debug)]
pub(super) struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
    order: ByteOrder,
}

impl<'a> Cursor<'a> {
    pub(super) fn new(bytes: &'a [u8], order: ByteOrder) -> Self {
        Self { bytes, at: 0, order }
    }

    pub(super) fn order(&self) -> ByteOrder {
        self.order
    }

    /// Number of bytes read so far.
    pub(super) fn position(&self) -> usize {
        self.at
    }

    pub(super) fn remaining(&self) -> usize {
        self.bytes.len() - self.at
    }

    pub(super) fn take(&mut self, length: usize) -> Result<&'a [u8], Malformed> {
        let taken = self.bytes[self.at..].get(..length).ok_or(Malformed::Truncated)?;
        self.at += length;
        Ok(taken)
    }

    pub(super) fn rest(mut self) -> &'a [u8] {
        let rest = &self.bytes[self.at..];
        self.at = self.bytes.len();
        rest
    }

    pub(super) fn array<const N: usize>(&mut self) -> Result<[u8; N], Malformed> {
        let taken = self.bytes[self.at..].first_chunk().ok_or(Malformed::Truncated)?;
        self.at += N;
        Ok(*taken)
    }

    pub(super) fn u16(&mut self) -> Result<u16, Malformed> {
        let bytes = self.array()?;
        Ok(match self.order {
            ByteOrder::Big => u16::from_be_bytes(bytes),
            ByteOrder::Little => u16::from_le_bytes(bytes),
        })
    }

    pub(super) fn u32(&mut self) -> Result<u32, Malformed> {
        let bytes = self.array()?;
        Ok(match self.order {
            ByteOrder::Big => u32::from_be_bytes(bytes),
            ByteOrder::Little => u32::from_le_bytes(bytes),
        })
    }

    pub(super) fn i32(&mut self) -> Result<i32, Malformed> {
        self.u32().map(u32::cast_signed)
    }

    /// Skips to the next multiple of four, counted from the beginning.
    pub(super) fn align(&mut self) -> Result<(), Malformed> {
        let padding = self.at.wrapping_neg() % 4;
        self.take(padding).map(drop)
    }
}

/// Appends to a buffer.
pub(super) struct Encoder<'a> {
    out: &'a mut Vec<u8>,
    order: ByteOrder,
}

impl<'a> Encoder<'a> {
    pub(super) fn new(out: &'a mut Vec<u8>, order: ByteOrder) -> Self {
        Self { out, order }
    }

    pub(super) fn len(&self) -> usize {
        self.out.len()
    }

    pub(super) fn bytes(&mut self, bytes: &[u8]) {
        self.out.extend_from_slice(bytes);
    }

    fn encode<const N: usize>(&self, big_endian: [u8; N]) -> [u8; N] {
        let mut bytes = big_endian;
        if self.order == ByteOrder::Little {
            bytes.reverse();
        }
        bytes
    }

    pub(super) fn u16(&mut self, value: u16) {
        self.bytes(&self.encode(value.to_be_bytes()));
    }

    pub(super) fn u32(&mut self, value: u32) {
        self.bytes(&self.encode(value.to_be_bytes()));
    }

    pub(super) fn i32(&mut self, value: i32) {
        self.u32(value.cast_unsigned());
    }

    /// Appends zeros until the bytes since `start` are a multiple of four.
    pub(super) fn align(&mut self, start: usize) {
        let padding = (self.out.len() - start).wrapping_neg() % 4;
        self.bytes(&[0; 3][..padding]);
    }

    /// Overwrites the number at `at`.
    pub(super) fn set_u16(&mut self, at: usize, value: u16) {
        let bytes = self.encode(value.to_be_bytes());
        self.out[at..at + 2].copy_from_slice(&bytes);
    }
}
