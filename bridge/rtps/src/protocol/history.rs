//! The history of a writer.

use std::collections::VecDeque;
use std::time::Instant;

use bytes::Bytes;

use crate::wire::{Guid, InlineQos, Payload, SequenceNumber, Timestamp};

/// Overhead of a sample in a receive buffer: in the worst case a separate datagram with the kernel's
/// bookkeeping.
const SAMPLE_COST: u64 = 512;

/// A sample in the history of a writer.
#[derive(Debug)]
pub(super) struct Entry {
    pub number: SequenceNumber,
    /// Cost of all samples before this one, which is the position of this sample in the stream of the writer.
    pub position: u64,
    pub payload: Bytes,
    pub inline_qos: InlineQos,
    pub timestamp: Timestamp,
    /// The only reader that receives this sample.
    pub only_to: Option<Guid>,
    pub written: Instant,
}

impl Entry {
    pub fn payload(&self) -> Payload<'_> {
        if self.payload.is_empty() { Payload::None } else { Payload::Data(&self.payload) }
    }
}

/// The samples of a writer in ascending order of their numbers. Discarded samples are missing.
#[derive(Debug)]
pub(super) struct History {
    entries: VecDeque<Entry>,
    next: SequenceNumber,
    /// The position of the next sample in the stream.
    end: u64,
}

impl History {
    pub fn new() -> Self {
        Self { entries: VecDeque::new(), next: SequenceNumber::FIRST, end: 0 }
    }

    pub fn len(&self) -> usize {
        self.entries.len()
    }

    /// The bytes of all samples, including what each costs in a receive buffer.
    pub fn bytes(&self) -> u64 {
        self.entries.front().map_or(0, |entry| self.end - entry.position)
    }

    /// The number of the next sample.
    pub fn next(&self) -> SequenceNumber {
        self.next
    }

    /// The oldest number; [`History::next`] if there is none.
    pub fn first(&self) -> SequenceNumber {
        self.entries.front().map_or(self.next, |entry| entry.number)
    }

    pub fn oldest(&self) -> Option<&Entry> {
        self.entries.front()
    }

    /// The number of the first of the newest `depth` samples.
    pub fn newest(&self, depth: usize) -> SequenceNumber {
        let index = self.entries.len().saturating_sub(depth);
        self.entries.get(index).map_or(self.next, |entry| entry.number)
    }

    pub fn push(
        &mut self,
        payload: Bytes,
        inline_qos: InlineQos,
        only_to: Option<Guid>,
        timestamp: Timestamp,
        written: Instant,
    ) -> SequenceNumber {
        let (number, position) = (self.next, self.end);
        self.next = number.next();
        self.end += payload.len() as u64 + SAMPLE_COST;
        self.entries.push_back(Entry { number, position, payload, inline_qos, timestamp, only_to, written });
        number
    }

    pub fn remove_oldest(&mut self) {
        self.entries.pop_front();
    }

    pub fn remove(&mut self, number: SequenceNumber) {
        if let Ok(index) = self.index(number) {
            self.entries.remove(index);
        }
    }

    pub fn clear(&mut self) {
        self.entries.clear();
    }

    pub fn get(&self, number: SequenceNumber) -> Option<&Entry> {
        self.index(number).ok().map(|index| &self.entries[index])
    }

    /// The lowest available number that is at least `number`; [`History::next`] if there is none.
    pub fn at_or_after(&self, number: SequenceNumber) -> SequenceNumber {
        let (Ok(index) | Err(index)) = self.index(number);
        self.entries.get(index).map_or(self.next, |entry| entry.number)
    }

    /// The position in the stream of sample `number`, or of the first available one after it.
    pub fn position(&self, number: SequenceNumber) -> u64 {
        let (Ok(index) | Err(index)) = self.index(number);
        self.entries.get(index).map_or(self.end, |entry| entry.position)
    }

    /// The index of a number, or the index at which it would be. Constant time if nothing was discarded.
    fn index(&self, number: SequenceNumber) -> Result<usize, usize> {
        let Some(first) = self.entries.front() else { return Err(0) };
        if number < first.number {
            return Err(0);
        }
        if number >= self.next {
            return Err(self.entries.len());
        }
        let guess = number.0.abs_diff(first.number.0) as usize;
        if self.entries.get(guess).is_some_and(|entry| entry.number == number) {
            return Ok(guess);
        }
        self.entries.binary_search_by_key(&number, |entry| entry.number)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn number(number: i64) -> SequenceNumber {
        SequenceNumber(number)
    }

    #[test]
    fn numbers_are_found_with_and_without_holes() {
        let mut history = History::new();
        for _ in 0..6 {
            let stamp = Timestamp::from_nanos(0);
            history.push(Bytes::from_static(b"1234"), InlineQos::default(), None, stamp, Instant::now());
        }
        history.remove_oldest();
        history.remove(number(4));
        assert_eq!((history.first(), history.next(), history.newest(2)), (number(2), number(7), number(5)));
        assert!(history.get(number(4)).is_none() && history.get(number(7)).is_none());
        for kept in [2, 3, 5, 6] {
            assert_eq!(history.get(number(kept)).map(|entry| entry.number), Some(number(kept)));
        }
        assert_eq!(history.at_or_after(number(4)), number(5));
        assert_eq!(history.position(number(4)), 4 * (SAMPLE_COST + 4));
        assert_eq!(history.position(number(9)), 6 * (SAMPLE_COST + 4));
        history.clear();
        assert_eq!((history.first(), history.newest(9)), (number(7), number(7)));
    }
}
