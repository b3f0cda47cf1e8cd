//! Sequence numbers and sets of numbers (sections 9.3.2, 9.4.2.6 and 9.4.2.8).

use std::fmt;

use super::Malformed;
use super::bytes::{Cursor, Encoder};

/// Number of a sample of one writer, from 1.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct SequenceNumber(pub i64);

impl SequenceNumber {
    /// No number. Occurs in related sample identities only.
    pub const UNKNOWN: Self = Self(-1 << 32);
    /// Before the first sample. Fast DDS acknowledges with it until it has received a heartbeat.
    pub const ZERO: Self = Self(0);
    /// The number of a writer's first sample.
    pub const FIRST: Self = Self(1);
    /// The highest number accepted from others. It is far enough from the end of `i64` that small offsets
    /// cannot overflow; at a million samples per second a writer reaches it in 146 000 years.
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

    /// Reads a number without checking its range.
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

/// Samples that an [`AckNack`](super::AckNack) requests or a [`Gap`](super::Gap) declares unavailable.
pub type SequenceNumberSet = NumberSet<SequenceNumber>;

/// Fragments of one sample, counted from 1, that a [`NackFragment`](super::NackFragment) requests.
pub type FragmentSet = NumberSet<u32>;

/// An element of a [`NumberSet`].
pub trait Number: Copy {
    /// Adds an offset, saturating at the end of the range.
    fn plus(self, offset: u32) -> Self;
    /// The difference to `base`; `None` if it is negative or exceeds `u32`.
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

/// A set of numbers among the 256 from a base on.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
pub struct NumberSet<N> {
    base: N,
    /// Number of bits on the wire.
    size: u32,
    /// Bit 0 is the highest bit of the first word; bits from `size` on are 0.
    words: [u32; 8],
}

impl<N: Number> NumberSet<N> {
    /// Number of bits of the largest set.
    pub const CAPACITY: u32 = 256;

    /// An empty set.
    pub fn new(base: N) -> Self {
        Self { base, size: 0, words: [0; 8] }
    }

    /// The number of the first bit. In an acknowledgement, all samples below are received.
    pub fn base(&self) -> N {
        self.base
    }

    /// Returns whether the set contains no number.
    pub fn is_empty(&self) -> bool {
        self.words == [0; 8]
    }

    /// Adds a number. Returns `false` if it is below the base or too far above it.
    pub fn insert(&mut self, number: N) -> bool {
        let Some(offset) = number.offset_from(self.base).filter(|offset| *offset < Self::CAPACITY) else {
            return false;
        };
        self.words[offset as usize / 32] |= 1 << (31 - offset % 32);
        self.size = self.size.max(offset + 1);
        true
    }

    /// Returns whether `number` is in the set.
    pub fn contains(&self, number: N) -> bool {
        number.offset_from(self.base).is_some_and(|offset| offset < Self::CAPACITY && self.bit(offset))
    }

    /// The numbers in the set, in ascending order.
    pub fn iter(&self) -> impl Iterator<Item = N> {
        (0..self.size).filter(|offset| self.bit(*offset)).map(|offset| self.base.plus(offset))
    }

    fn bit(&self, offset: u32) -> bool {
        self.words[offset as usize / 32] & 1 << (31 - offset % 32) != 0
    }

    /// Reads the size and the bits, which follow the base.
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

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::wire::ByteOrder;

    fn set(base: i64, numbers: &[i64]) -> SequenceNumberSet {
        let mut set = SequenceNumberSet::new(SequenceNumber(base));
        assert!(numbers.iter().all(|number| set.insert(SequenceNumber(*number))));
        set
    }

    fn read(bytes: &[u8]) -> Result<SequenceNumberSet, Malformed> {
        SequenceNumberSet::read_bits(&mut Cursor::new(bytes, ByteOrder::Big), SequenceNumber(100))
    }

    #[test]
    fn a_set_holds_256_numbers_from_its_base_on() {
        let mut set = SequenceNumberSet::new(SequenceNumber(100));
        assert!(set.is_empty());
        assert!(!set.insert(SequenceNumber(99)));
        assert!(!set.insert(SequenceNumber(356)));
        assert!(!set.insert(SequenceNumber(i64::MIN)));
        assert!(set.is_empty());
        assert!(set.insert(SequenceNumber(355)));
        assert!(set.insert(SequenceNumber(100)));
        assert!(!set.is_empty());
        assert!(set.contains(SequenceNumber(355)) && !set.contains(SequenceNumber(354)));
        assert_eq!(set.iter().map(|number| number.0).collect::<Vec<_>>(), [100, 355]);
    }

    #[test]
    fn the_first_number_is_the_highest_bit() {
        for order in [ByteOrder::Big, ByteOrder::Little] {
            let sent = set(100, &[100, 102, 131, 132]);
            let mut bytes = Vec::new();
            sent.write_bits(&mut Encoder::new(&mut bytes, order));
            if order == ByteOrder::Big {
                assert_eq!(bytes, [0, 0, 0, 33, 0xa0, 0, 0, 1, 0x80, 0, 0, 0]);
            }
            let mut cursor = Cursor::new(&bytes, order);
            assert_eq!(SequenceNumberSet::read_bits(&mut cursor, SequenceNumber(100)), Ok(sent));
            assert_eq!(cursor.remaining(), 0);
        }
    }

    #[test]
    fn bits_beyond_the_size_of_a_set_do_not_count() {
        let odd = read(&[0, 0, 0, 3, 0xff, 0xff, 0xff, 0xff]).unwrap();
        assert_eq!(odd, set(100, &[100, 101, 102]));
        assert!(read(&[0, 0, 0, 0]).unwrap().is_empty());
    }

    #[test]
    fn a_set_of_more_than_256_bits_or_fewer_words_than_bits_is_malformed() {
        let full = [&[0, 0, 1, 0][..], &[0xff; 32]].concat();
        assert_eq!(read(&full).unwrap().iter().count(), 256);
        assert_eq!(read(&full[..35]), Err(Malformed::Truncated));
        assert_eq!(read(&[&[0, 0, 1, 1][..], &[0xff; 64]].concat()), Err(Malformed::NumberSet));
        assert_eq!(read(&[0xff; 64]), Err(Malformed::NumberSet));
    }

    #[test]
    fn a_set_at_the_end_of_the_numbers_does_not_wrap() {
        let mut fragments = FragmentSet::new(u32::MAX);
        assert!(fragments.insert(u32::MAX));
        assert!(!fragments.insert(0));
        assert_eq!(fragments.iter().collect::<Vec<_>>(), [u32::MAX]);
        let bytes = [&[0, 0, 1, 0][..], &[0xff; 32]].concat();
        let all = FragmentSet::read_bits(&mut Cursor::new(&bytes, ByteOrder::Big), u32::MAX).unwrap();
        assert!(all.iter().all(|number| number == u32::MAX));
    }

    #[test]
    fn a_number_is_a_signed_high_and_an_unsigned_low_half() {
        let number = SequenceNumber(0x1_ffff_ffff);
        let mut bytes = Vec::new();
        number.write(&mut Encoder::new(&mut bytes, ByteOrder::Big));
        assert_eq!(bytes, [0, 0, 0, 1, 0xff, 0xff, 0xff, 0xff]);
        let read = |bytes: [u8; 8]| {
            SequenceNumber::read(&mut Cursor::new(&bytes, ByteOrder::Big), SequenceNumber::FIRST)
        };
        assert_eq!(read([0, 0, 0, 1, 0xff, 0xff, 0xff, 0xff]), Ok(number));
        assert_eq!(read(SequenceNumber::MAX.0.to_be_bytes()), Ok(SequenceNumber::MAX));
        for bad in [0, -1, i64::MIN, SequenceNumber::UNKNOWN.0, SequenceNumber::MAX.0 + 1, i64::MAX] {
            assert_eq!(read(bad.to_be_bytes()), Err(Malformed::SequenceNumber), "{bad}");
        }
    }

    #[test]
    fn numbers_end_without_a_wrap() {
        assert_eq!(SequenceNumber::MAX.checked_add(1), None);
        assert_eq!(SequenceNumber::FIRST.checked_add(u64::MAX), None);
        assert_eq!(SequenceNumber::FIRST.checked_add(2), Some(SequenceNumber(3)));
    }
}
