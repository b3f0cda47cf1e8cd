//! The samples of writers that keep what they sent, in order and whole.

use crate::middleware::{Gid, Sample};
use std::collections::{BTreeMap, HashMap};

/// The most bytes that wait for samples before them, of all writers of a subscription.
const MOST_BYTES: usize = 16 << 20;

/// The most samples of a writer that wait, and the most that are asked for: further ahead or behind, its
/// numbers have begun anew.
const MOST_HELD: usize = 1024;

/// The most writers that a subscription follows.
pub(super) const MOST_WRITERS: usize = 1024;

/// What a subscription has of its writers.
pub(super) struct Order {
    writers: HashMap<Gid, OfWriter>,
    /// A writer keeps no more, so that nothing waits behind more.
    depth: usize,
    bytes: usize,
}

struct OfWriter {
    last: i64,
    /// Those behind a gap, by their numbers.
    held: BTreeMap<i64, Sample>,
    /// Whether somebody asks for what is missing.
    is_asked: bool,
}

/// What follows from a sample.
#[derive(Default)]
pub(super) struct Taken {
    /// To deliver, in this order.
    pub(super) ready: Vec<Sample>,
    /// How many samples before these are lost.
    pub(super) lost: u64,
    /// Samples are missing, and nobody asks for them yet.
    pub(super) is_gap: bool,
}

impl Order {
    /// Of a subscription that keeps the last `depth` samples.
    pub(super) fn new(depth: usize) -> Self {
        Self { writers: HashMap::new(), depth: depth.min(MOST_HELD), bytes: 0 }
    }

    /// Takes a sample as it comes, or one of a gap.
    pub(super) fn take(&mut self, sample: Sample) -> Taken {
        let (gid, number) = (sample.writer, sample.sequence_number);
        let mut taken = self.make_room(gid);
        let new = || OfWriter { last: number.saturating_sub(1), held: BTreeMap::new(), is_asked: false };
        let writer = self.writers.entry(gid).or_insert_with(new);
        let ahead = number.saturating_sub(writer.last);
        let is_near = ahead.unsigned_abs() <= MOST_HELD as u64;
        if is_near && (ahead <= 0 || writer.held.contains_key(&number)) {
            return taken;
        }
        if !is_near {
            taken.add(self.give_up(gid));
            let Some(writer) = self.writers.get_mut(&gid) else { return taken };
            taken.lost = taken.lost.saturating_add(ahead.saturating_sub(1).max(0).unsigned_abs());
            writer.last = number;
            taken.ready.push(sample);
            return taken;
        }
        self.bytes += sample.cdr.len();
        writer.held.insert(number, sample);
        taken.ready.extend(writer.release(&mut self.bytes));
        if writer.held.len() >= self.depth || self.bytes > MOST_BYTES {
            taken.add(self.give_up(gid));
        } else if !writer.held.is_empty() && !writer.is_asked {
            writer.is_asked = true;
            taken.is_gap = true;
        }
        taken
    }

    /// The last sample of a writer before a gap; `None` if there is none, and nobody need ask any more.
    pub(super) fn last_before_gap(&mut self, writer: Gid) -> Option<i64> {
        let writer = self.writers.get_mut(&writer)?;
        writer.is_asked = !writer.held.is_empty();
        writer.is_asked.then_some(writer.last)
    }

    /// Goes on without what is missing.
    pub(super) fn give_up(&mut self, writer: Gid) -> Taken {
        let mut taken = Taken::default();
        let Some(writer) = self.writers.get_mut(&writer) else { return taken };
        while let Some(first) = writer.held.keys().next() {
            let missing = first.saturating_sub(writer.last).saturating_sub(1);
            taken.lost = taken.lost.saturating_add(missing.unsigned_abs());
            writer.last = first.saturating_sub(1);
            taken.ready.extend(writer.release(&mut self.bytes));
        }
        taken
    }

    /// Forgets a writer if there are too many for a further one; what it has waiting is delivered.
    fn make_room(&mut self, for_writer: Gid) -> Taken {
        if self.writers.len() < MOST_WRITERS || self.writers.contains_key(&for_writer) {
            return Taken::default();
        }
        let idle = self.writers.iter().find(|(_, writer)| writer.held.is_empty()).map(|(gid, _)| *gid);
        let Some(gid) = idle.or_else(|| self.writers.keys().next().copied()) else {
            return Taken::default();
        };
        let taken = self.give_up(gid);
        self.writers.remove(&gid);
        taken
    }
}

impl Taken {
    fn add(&mut self, other: Self) {
        self.ready.extend(other.ready);
        self.lost = self.lost.saturating_add(other.lost);
    }
}

impl OfWriter {
    /// Those that follow the last one without a gap.
    fn release(&mut self, bytes: &mut usize) -> Vec<Sample> {
        let mut ready = Vec::new();
        while let Some(next) = self.last.checked_add(1)
            && let Some(sample) = self.held.remove(&next)
        {
            *bytes -= sample.cdr.len();
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

    const WRITER: Gid = Gid([1; 16]);

    fn sample_of(writer: Gid, number: i64) -> Sample {
        let cdr = Bytes::from_static(&[0, 1, 0, 0]);
        Sample { cdr, source_time_ns: None, writer, sequence_number: number, related: None }
    }

    fn sample(number: i64) -> Sample {
        sample_of(WRITER, number)
    }

    fn numbers(taken: &Taken) -> Vec<i64> {
        taken.ready.iter().map(|sample| sample.sequence_number).collect()
    }

    #[test]
    fn samples_behind_a_gap_wait_until_it_is_filled() {
        let mut order = Order::new(100);
        assert_eq!(numbers(&order.take(sample(7))), [7], "what was before it came is not missed");
        assert_eq!(numbers(&order.take(sample(8))), [8]);
        let behind = order.take(sample(11));
        assert_eq!((numbers(&behind), behind.is_gap), (vec![], true));
        let next = order.take(sample(13));
        assert_eq!((numbers(&next), next.is_gap), (vec![], false), "somebody asks already");
        assert_eq!(numbers(&order.take(sample(9))), [9]);
        assert_eq!(numbers(&order.take(sample(9))), [0; 0], "twice");
        assert_eq!(order.last_before_gap(WRITER), Some(9));
        assert_eq!(numbers(&order.take(sample(10))), [10, 11]);
        assert_eq!(order.last_before_gap(WRITER), Some(11), "a second gap is asked for by the same one");
        assert_eq!(numbers(&order.take(sample(12))), [12, 13]);
        assert_eq!(order.last_before_gap(WRITER), None);
        assert!(order.take(sample(15)).is_gap, "a new one");
        assert_eq!(order.bytes, 4);
    }

    #[test]
    fn what_does_not_come_is_counted_as_lost() {
        let mut order = Order::new(100);
        for number in [1, 4, 5, 9] {
            order.take(sample(number));
        }
        let rest = order.give_up(WRITER);
        assert_eq!((numbers(&rest), rest.lost, order.bytes), (vec![4, 5, 9], 5, 0));
        assert_eq!(numbers(&order.take(sample(3))), [0; 0], "too late");
        assert_eq!(numbers(&order.take(sample(10))), [10]);
    }

    #[test]
    fn nothing_waits_for_more_than_a_writer_keeps() {
        let mut newest = Order::new(1);
        newest.take(sample(1));
        let next = newest.take(sample(4));
        assert_eq!((numbers(&next), next.lost, next.is_gap), (vec![4], 2, false));
        let mut three = Order::new(3);
        let all: Vec<_> = [1, 4, 6, 7].map(|number| three.take(sample(number))).into();
        assert!(all[1].ready.is_empty() && all[2].ready.is_empty());
        assert_eq!((numbers(&all[3]), all[3].lost), (vec![4, 6, 7], 3));
    }

    #[test]
    fn numbers_of_strangers_silence_nobody_and_cost_little() {
        let mut order = Order::new(usize::MAX);
        order.take(sample(1));
        for number in [i64::MAX, 2, i64::MIN, i64::MAX, i64::MAX - 1, 3] {
            order.take(sample(number));
        }
        order.give_up(WRITER);
        assert_eq!(numbers(&order.take(sample(4))), [4]);
        order.take(sample(6));
        let writers = (0..2 * MOST_WRITERS).map(|writer| {
            let mut gid = [0; 16];
            gid[..8].copy_from_slice(&writer.to_le_bytes());
            Gid(gid)
        });
        let mut delivered = 0;
        for gid in writers {
            for number in [1, 3] {
                delivered += order.take(sample_of(gid, number)).ready.len();
            }
        }
        assert!(order.writers.len() <= MOST_WRITERS && delivered >= 3 * MOST_WRITERS, "{delivered}");
    }
}
