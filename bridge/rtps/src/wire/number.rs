//! Sequence numbers and sets of numbers (sections 9.3.2, 9.4.2.6 and 9.4.2.8).

use std::fmt;

use super::Malformed;
use super::bytes::{Cursor, Encoder};

/// Number of a sample of one writer, from 1.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SequenceNumber(pub i64);

impl SequenceNumber {
    /// "No number": stands in related identities only, never in front of data.
    pub const UNKNOWN: Self = Self(-1 << 32);
    /// No sample has it; Fast DDS acknowledges with it before it has heard anything.
    pub const ZERO: Self = Self(0);
    /// The first sample of every writer.
    pub const FIRST: Self = Self(1);
    /// The highest number accepted from others: so far from the end of `i64` that no sum of two numbers overflows. At a
    /// million samples per second a writer gets there in 146 000 years.
    pub const MAX: Self = Self(1 << 62);

    /// The number after this one.
    #[must_use]
    pub const fn next(self) -> Self {
        Self(self.0.saturating_add(1))
    }

    /// The number before this one.
    #[must_use]
    pub const fn previous(self) -> Self {
        Self(self.0.saturating_sub(1))
    }

    /// `None` beyond [`SequenceNumber::MAX`].
    pub fn checked_add(self, count: u64) -> Option<Self> {
        let sum = self.0.checked_add_unsigned(count).map(Self)?;
        (sum <= Self::MAX).then_some(sum)
    }

    /// Reads any number, of a sample or not.
    pub(super) fn read_any(cursor: &mut Cursor<'_>) -> Result<Self, Malformed> {
        let (high, low) = (cursor.i32()?, cursor.u32()?);
        Ok(Self(i64::from(high) << 32 | i64::from(low)))
    }

    /// Reads a number from `lowest` to [`SequenceNumber::MAX`].
    pub(super) fn read(cursor: &mut Cursor<'_>, lowest: Self) -> Result<Self, Malformed> {
        let number = Self::read_any(cursor)?;
        (lowest..=Self::MAX).contains(&number).then_some(number).ok_or(Malformed::SequenceNumber)
    }

    pub(super) fn write(self, out: &mut Encoder<'_>) {
        out.i32((self.0 >> 32) as i32);
        out.u32(self.0 as u32);
    }
}

impl fmt::Display for SequenceNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

impl fmt::Debug for SequenceNumber {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Samples that an [`AckNack`](super::AckNack) asks for or a [`Gap`](super::Gap) excuses.
pub type SequenceNumberSet = NumberSet<SequenceNumber>;

/// Fragments of one sample, from 1, that a [`NackFragment`](super::NackFragment) asks for.
pub type FragmentSet = NumberSet<u32>;

/// What a [`NumberSet`] may hold.
pub trait Number: Copy {
    /// `self + offset`; the caller knows that it is in range.
    fn plus(self, offset: u32) -> Self;
    /// How far `self` is above `base`; `None` if below, or further than `u32` goes.
    fn offset_from(self, base: Self) -> Option<u32>;
}

impl Number for SequenceNumber {
    fn plus(self, offset: u32) -> Self {
        Self(self.0.saturating_add(offset.into()))
    }

    fn offset_from(self, base: Self) -> Option<u32> {
        self.0.checked_sub(base.0)?.try_into().ok()
    }
}

impl Number for u32 {
    fn plus(self, offset: u32) -> Self {
        self.saturating_add(offset)
    }

    fn offset_from(self, base: Self) -> Option<u32> {
        self.checked_sub(base)
    }
}

/// A base and up to 256 numbers from it on.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct NumberSet<N> {
    base: N,
    /// How many bits are on the wire.
    size: u32,
    /// Bit 0 is the highest bit of the first word; bits from `size` on are 0.
    words: [u32; 8],
}

impl<N: Number> NumberSet<N> {
    /// Numbers that fit in a set.
    pub const CAPACITY: u32 = 256;

    /// An empty set.
    pub fn new(base: N) -> Self {
        Self { base, size: 0, words: [0; 8] }
    }

    /// The number of the first bit; in an acknowledgement all below are received.
    pub fn base(&self) -> N {
        self.base
    }

    /// Whether no number is in the set.
    pub fn is_empty(&self) -> bool {
        self.words == [0; 8]
    }

    /// Adds a number; `false` if it is below the base or too far above it.
    pub fn insert(&mut self, number: N) -> bool {
        let Some(offset) = number.offset_from(self.base).filter(|offset| *offset < Self::CAPACITY) else {
            return false;
        };
        self.words[offset as usize / 32] |= 1 << (31 - offset % 32);
        self.size = self.size.max(offset + 1);
        true
    }

    /// Whether `number` is in the set.
    pub fn contains(&self, number: N) -> bool {
        number.offset_from(self.base).is_some_and(|offset| offset < Self::CAPACITY && self.bit(offset))
    }

    /// The numbers in the set, rising.
    pub fn iter(&self) -> impl Iterator<Item = N> {
        (0..self.size).filter(|offset| self.bit(*offset)).map(|offset| self.base.plus(offset))
    }

    fn bit(&self, offset: u32) -> bool {
        self.words[offset as usize / 32] & 1 << (31 - offset % 32) != 0
    }

    /// Reads what follows the base.
    pub(super) fn read_bits(cursor: &mut Cursor<'_>, base: N) -> Result<Self, Malformed> {
        let mut set = Self { size: cursor.u32()?, ..Self::new(base) };
        if set.size > Self::CAPACITY {
            return Err(Malformed::NumberSet);
        }
        let words = set.size.div_ceil(32) as usize;
        for word in &mut set.words[..words] {
            *word = cursor.u32()?;
        }
        if !set.size.is_multiple_of(32) {
            set.words[words - 1] &= u32::MAX << (32 - set.size % 32);
        }
        Ok(set)
    }

    pub(super) fn write_bits(&self, out: &mut Encoder<'_>) {
        out.u32(self.size);
        self.words[..self.size.div_ceil(32) as usize].iter().for_each(|word| out.u32(*word));
    }
}

impl<N: Number + fmt::Debug> fmt::Debug for NumberSet<N> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}: ", self.base)?;
        f.debug_set().entries(self.iter()).finish()
    }
}
