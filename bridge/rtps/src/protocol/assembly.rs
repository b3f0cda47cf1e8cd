//! Samples that arrive in fragments.

use crate::wire::{DataFragment, FragmentSet, InlineQos, Timestamp};

use super::intervals::Intervals;

/// How far fragments may be ahead of the received bytes. Memory use follows the received bytes, not the
/// declared size.
const SLACK: usize = 256 * 1024;
/// The most holes in a sample. Fragments that would create more are dropped and requested again.
const MAX_RUNS: usize = 4096;

/// A partially received sample.
#[derive(Debug)]
pub(super) struct Assembly {
    pub inline_qos: InlineQos,
    pub timestamp: Option<Timestamp>,
    pub is_key: bool,
    /// The sample up to the end of the furthest fragment, with zeros in place of missing fragments.
    bytes: Vec<u8>,
    sample_size: u32,
    fragment_size: u16,
    /// Numbers of the received fragments.
    received: Intervals,
    received_count: u32,
}

impl Assembly {
    /// Creates an assembly for the sample of `fragment`, without adding it.
    pub fn new(fragment: &DataFragment<'_>, timestamp: Option<Timestamp>) -> Self {
        Self {
            inline_qos: fragment.inline_qos,
            timestamp,
            is_key: fragment.is_key,
            bytes: Vec::new(),
            sample_size: fragment.sample_size,
            fragment_size: fragment.fragment_size,
            received: Intervals::default(),
            received_count: 0,
        }
    }

    /// Returns whether `fragment` belongs to the same sample with the same fragment size.
    pub fn fits(&self, fragment: &DataFragment<'_>) -> bool {
        (self.sample_size, self.fragment_size) == (fragment.sample_size, fragment.fragment_size)
    }

    /// Bytes of memory that this assembly uses.
    pub fn size(&self) -> usize {
        self.bytes.capacity()
    }

    pub fn is_complete(&self) -> bool {
        self.received_count == self.fragment_count()
    }

    fn fragment_count(&self) -> u32 {
        self.sample_size.div_ceil(self.fragment_size.into())
    }

    /// Bytes of memory that this assembly would use with `fragment`.
    pub fn size_with(&self, fragment: &DataFragment<'_>) -> usize {
        let (end, reach) = (end(fragment), self.reach(fragment));
        if end <= self.bytes.capacity() || end > reach {
            return self.bytes.capacity();
        }
        // At most doubled, and never larger than the sample: a buffer of exactly its size needs no copy at
        // the end.
        (2 * end).min(self.sample_size as usize).min(reach)
    }

    /// Adds the new parts of `fragment`, which must [fit](Assembly::fits). Parts that are too far ahead are
    /// ignored.
    pub fn add(&mut self, fragment: &DataFragment<'_>) {
        let numbers = i64::from(fragment.first)..i64::from(fragment.first) + i64::from(fragment.count);
        let known = self.received.count_in(numbers.clone());
        let (start, end) = (fragment.offset() as usize, end(fragment));
        let is_too_far = end > self.reach(fragment) || self.received.runs() >= MAX_RUNS;
        if is_too_far || known == u64::from(fragment.count) {
            return;
        }
        if end > self.bytes.capacity() {
            self.bytes.reserve_exact(self.size_with(fragment) - self.bytes.len());
        }
        if start >= self.bytes.len() {
            self.bytes.resize(start, 0);
            self.bytes.extend_from_slice(fragment.payload);
        } else {
            self.bytes.resize(self.bytes.len().max(end), 0);
            self.bytes[start..end].copy_from_slice(fragment.payload);
        }
        self.received.insert(numbers);
        self.received_count += u32::from(fragment.count) - known as u32;
        if self.inline_qos == InlineQos::default() {
            self.inline_qos = fragment.inline_qos;
        }
    }

    /// How far fragments may reach if `fragment` is added.
    fn reach(&self, fragment: &DataFragment<'_>) -> usize {
        let received = self.received_count as usize * usize::from(self.fragment_size);
        SLACK + 8 * (received + fragment.payload.len())
    }

    /// Returns the missing fragments up to `last`, as far as they fit into a set whose base is the first of
    /// them. If none is missing, returns an empty set with a base above `last`.
    pub fn missing(&self, last: u32) -> FragmentSet {
        let end = i64::from(last.min(self.fragment_count())) + 1;
        let first = self.received.first_absent(1);
        let mut missing = FragmentSet::new(first as u32);
        self.received.absent(first..end).all(|fragment| missing.insert(fragment as u32));
        missing
    }

    /// Returns all missing fragments of the sample, in the form of [`Assembly::missing`].
    pub fn all_missing(&self) -> FragmentSet {
        self.missing(self.fragment_count())
    }

    /// The sample, if it is complete.
    pub fn into_bytes(self) -> Vec<u8> {
        self.bytes
    }
}

fn end(fragment: &DataFragment<'_>) -> usize {
    fragment.offset() as usize + fragment.payload.len()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wire::{EntityId, SequenceNumber};

    fn fragment(sample: &[u8], first: u32, count: u16, fragment_size: u16) -> DataFragment<'_> {
        let start = (first as usize - 1) * fragment_size as usize;
        let end = (start + count as usize * fragment_size as usize).min(sample.len());
        DataFragment {
            reader: EntityId::UNKNOWN,
            writer: EntityId::user_writer(1),
            number: SequenceNumber::FIRST,
            first,
            count,
            fragment_size,
            sample_size: sample.len() as u32,
            inline_qos: InlineQos::default(),
            payload: &sample[start..end],
            is_key: false,
        }
    }

    #[test]
    fn fragments_in_any_order_and_twice_make_the_sample() {
        let sample: Vec<u8> = (0..1003).map(|i| i as u8).collect();
        for step in [1, 3, 7, 10] {
            let mut assembly = Assembly::new(&fragment(&sample, 1, 1, 100), None);
            for i in 0..11 {
                assembly.add(&fragment(&sample, i * step % 11 + 1, 1, 100));
                assembly.add(&fragment(&sample, i * step % 11 + 1, 1, 100));
            }
            assert!(assembly.is_complete());
            assert_eq!(assembly.into_bytes(), sample);
        }
    }

    #[test]
    fn missing_fragments_are_reported_up_to_the_last_sent_fragment() {
        let sample = vec![1; 1000];
        let mut assembly = Assembly::new(&fragment(&sample, 1, 1, 100), None);
        assert_eq!(assembly.missing(3).iter().collect::<Vec<_>>(), [1, 2, 3]);
        assembly.add(&fragment(&sample, 1, 2, 100));
        assembly.add(&fragment(&sample, 5, 1, 100));
        let missing = assembly.missing(6);
        assert_eq!((missing.base(), missing.iter().collect::<Vec<_>>()), (3, vec![3, 4, 6]));
        let nothing = assembly.missing(2);
        assert_eq!((nothing.base(), nothing.is_empty()), (3, true));
        assembly.add(&fragment(&sample, 2, 4, 100));
        assert_eq!(assembly.received_count, 5);
    }

    #[test]
    fn memory_follows_the_received_bytes() {
        let declared = DataFragment {
            reader: EntityId::UNKNOWN,
            writer: EntityId::user_writer(1),
            number: SequenceNumber::FIRST,
            first: 4_000_000,
            count: 1,
            fragment_size: 1000,
            sample_size: u32::MAX,
            inline_qos: InlineQos::default(),
            payload: &[0; 1000],
            is_key: false,
        };
        let mut assembly = Assembly::new(&declared, None);
        assembly.add(&declared);
        assert_eq!((assembly.size(), assembly.received_count), (0, 0));
        assembly.add(&DataFragment { first: 200, ..declared });
        assert!(assembly.size() < 300_000 && assembly.received_count == 1);
    }
}
