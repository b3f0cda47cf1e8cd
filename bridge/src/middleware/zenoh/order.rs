//! The samples of writers that keep what they sent, in order and whole.

use crate::middleware::{Gid, Sample};
use std::collections::{BTreeMap, HashMap};

/// The most samples of a writer that wait for one before them, and the most bytes of these.
const MOST_HELD: usize = 1024;
const MOST_BYTES: usize = 16 << 20;

/// The most writers that a subscription follows.
pub(super) const MOST_WRITERS: usize = 1024;

/// What a subscription has of its writers.
#[derive(Default)]
pub(super) struct Order {
    writers: HashMap<Gid, OfWriter>,
}

struct OfWriter {
    last: i64,
    /// Those behind a gap, by their numbers.
    held: BTreeMap<i64, Sample>,
    bytes: usize,
}

/// What follows from a sample.
#[derive(Default)]
pub(super) struct Taken {
    /// To deliver, in this order.
    pub(super) ready: Vec<Sample>,
    /// How many samples before these are lost.
    pub(super) lost: u64,
    /// The sample is the first one behind a gap, which is this large.
    pub(super) gap: Option<u64>,
}

impl Order {
    /// Takes a sample as it comes, or one of a gap.
    pub(super) fn take(&mut self, sample: Sample) -> Taken {
        if self.writers.len() >= MOST_WRITERS && !self.writers.contains_key(&sample.writer) {
            self.writers.clear();
        }
        let (gid, number) = (sample.writer, sample.sequence_number);
        let Some(writer) = self.writers.get_mut(&gid) else {
            let writer = OfWriter { last: number, held: BTreeMap::new(), bytes: 0 };
            self.writers.insert(gid, writer);
            return Taken { ready: vec![sample], ..Taken::default() };
        };
        if number <= writer.last || writer.held.contains_key(&number) {
            return Taken::default();
        }
        let is_first = writer.held.is_empty();
        writer.bytes += sample.cdr.len();
        writer.held.insert(number, sample);
        let ready = writer.release();
        if writer.held.len() > MOST_HELD || writer.bytes > MOST_BYTES {
            return self.give_up(gid);
        }
        let is_gap = is_first && !writer.held.is_empty();
        let gap = is_gap.then(|| number.saturating_sub(writer.last).unsigned_abs() - 1);
        Taken { ready, lost: 0, gap }
    }

    /// Whether a sample of a writer waits for one before it.
    pub(super) fn has_gap(&self, writer: Gid) -> bool {
        self.writers.get(&writer).is_some_and(|writer| !writer.held.is_empty())
    }

    /// Goes on without what is missing.
    pub(super) fn give_up(&mut self, writer: Gid) -> Taken {
        let Some(writer) = self.writers.get_mut(&writer) else { return Taken::default() };
        let mut taken = Taken::default();
        while let Some(first) = writer.held.keys().next() {
            let missing = first.saturating_sub(writer.last).saturating_sub(1);
            taken.lost = taken.lost.saturating_add(missing.unsigned_abs());
            writer.last = first - 1;
            taken.ready.extend(writer.release());
        }
        taken
    }
}

impl OfWriter {
    /// Those that follow the last one without a gap.
    fn release(&mut self) -> Vec<Sample> {
        let mut ready = Vec::new();
        while let Some(next) = self.last.checked_add(1)
            && let Some(sample) = self.held.remove(&next)
        {
            self.bytes -= sample.cdr.len();
            self.last = next;
            ready.push(sample);
        }
        ready
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytes::Bytes;

    fn sample(number: i64) -> Sample {
        let cdr = Bytes::from_static(&[0, 1, 0, 0]);
        Sample { cdr, source_time_ns: None, writer: Gid([1; 16]), sequence_number: number, related: None }
    }

    fn numbers(taken: &Taken) -> Vec<i64> {
        taken.ready.iter().map(|sample| sample.sequence_number).collect()
    }

    #[test]
    fn samples_behind_a_gap_wait_until_it_is_filled() {
        let mut order = Order::default();
        assert_eq!(numbers(&order.take(sample(7))), [7], "what was before it came is not missed");
        assert_eq!(numbers(&order.take(sample(8))), [8]);
        let behind = order.take(sample(11));
        assert_eq!((numbers(&behind), behind.gap), (vec![], Some(2)));
        let next = order.take(sample(12));
        assert_eq!((numbers(&next), next.gap), (vec![], None), "one gap is asked for once");
        assert!(order.has_gap(Gid([1; 16])));
        assert_eq!(numbers(&order.take(sample(9))), [9]);
        assert_eq!(numbers(&order.take(sample(9))), [0; 0], "twice");
        assert_eq!(numbers(&order.take(sample(10))), [10, 11, 12]);
        assert!(!order.has_gap(Gid([1; 16])));
    }

    #[test]
    fn what_does_not_come_is_counted_as_lost() {
        let mut order = Order::default();
        for number in [1, 4, 5, 9] {
            order.take(sample(number));
        }
        let rest = order.give_up(Gid([1; 16]));
        assert_eq!((numbers(&rest), rest.lost), (vec![4, 5, 9], 5));
        assert_eq!(numbers(&order.take(sample(3))), [0; 0], "too late");
        assert_eq!(numbers(&order.take(sample(10))), [10]);
    }

    #[test]
    fn what_waits_is_bounded_and_numbers_of_strangers_do_no_harm() {
        let mut order = Order::default();
        order.take(sample(1));
        let all: Vec<_> = (3..=3 + MOST_HELD as i64).map(|number| order.take(sample(number))).collect();
        let (last, before) = all.split_last().unwrap_or_else(|| unreachable!());
        assert!(before.iter().all(|taken| taken.ready.is_empty()));
        assert_eq!((last.ready.len(), last.lost), (MOST_HELD + 1, 1));
        for number in [i64::MIN, i64::MAX, i64::MAX, 0] {
            order.take(sample(number));
        }
        order.give_up(Gid([1; 16]));
    }
}
