//! The last messages, kept for a snapshot.

use std::collections::VecDeque;
use std::time::Duration;

use super::queue::Item;

/// The limits of a snapshot: the latest messages within both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SnapshotLimits {
    /// Memory for messages, in bytes.
    pub max_bytes: usize,
    /// From the oldest to the latest message, by receive time.
    pub max_duration: Option<Duration>,
}

/// Messages within the limits; the oldest are dropped first.
pub(super) struct Ring {
    limits: SnapshotLimits,
    items: VecDeque<Item>,
    bytes: usize,
    /// The latest receive time.
    latest: i64,
}

impl Ring {
    pub(super) fn new(limits: SnapshotLimits) -> Self {
        Self { limits, items: VecDeque::new(), bytes: 0, latest: i64::MIN }
    }

    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Whether a message can be kept at all.
    pub(super) fn fits(&self, item: &Item) -> bool {
        item.cost() <= self.limits.max_bytes
    }

    pub(super) fn push(&mut self, item: Item) {
        self.latest = self.latest.max(item.log_time().unwrap_or(i64::MIN));
        self.bytes += item.cost();
        self.items.push_back(item);
        while self.items.front().is_some_and(|oldest| self.is_over(oldest)) {
            if let Some(oldest) = self.items.pop_front() {
                self.bytes -= oldest.cost();
            }
        }
    }

    /// Removes all messages.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = Item> + '_ {
        self.bytes = 0;
        self.items.drain(..)
    }

    fn is_over(&self, oldest: &Item) -> bool {
        let age = oldest.log_time().map_or(0, |time| self.latest.saturating_sub(time));
        let is_old = |most: Duration| u128::try_from(age).is_ok_and(|age| age > most.as_nanos());
        self.bytes > self.limits.max_bytes || self.limits.max_duration.is_some_and(is_old)
    }
}
