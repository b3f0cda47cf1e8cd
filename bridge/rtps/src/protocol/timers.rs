//! Timers of the parts of a participant.

use std::{
    collections::{BTreeSet, HashMap},
    hash::Hash,
    time::Instant,
};

/// One deadline per key, ordered by time.
///
/// Of hundreds of endpoints, nearly all have no deadline: the cost of a datagram or a timeout does not depend
/// on the number of endpoints.
#[derive(Debug)]
pub(crate) struct Timers<K> {
    order: BTreeSet<(Instant, K)>,
    deadlines: HashMap<K, Instant>,
}

impl<K: Copy + Ord + Hash> Timers<K> {
    pub(crate) fn new() -> Self {
        Self { order: BTreeSet::new(), deadlines: HashMap::new() }
    }

    /// Replaces the deadline of `key`; `None` removes it.
    pub(crate) fn set(&mut self, key: K, deadline: Option<Instant>) {
        let previous = match deadline {
            Some(at) => self.deadlines.insert(key, at),
            None => self.deadlines.remove(&key),
        };
        if previous == deadline {
            return;
        }
        if let Some(at) = previous {
            self.order.remove(&(at, key));
        }
        if let Some(at) = deadline {
            self.order.insert((at, key));
        }
    }

    pub(crate) fn next(&self) -> Option<Instant> {
        self.order.first().map(|(at, _)| *at)
    }

    /// Removes and returns a key whose deadline is at or before `now`.
    pub(crate) fn pop(&mut self, now: Instant) -> Option<K> {
        let (at, key) = *self.order.first()?;
        if at > now {
            return None;
        }
        self.order.remove(&(at, key));
        self.deadlines.remove(&key);
        Some(key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    #[test]
    fn keys_come_in_the_order_of_their_latest_deadlines() {
        let start = Instant::now();
        let at = |ms| start + Duration::from_millis(ms);
        let mut timers = Timers::new();
        timers.set('a', Some(at(30)));
        timers.set('b', Some(at(20)));
        timers.set('c', Some(at(10)));
        timers.set('a', Some(at(15)));
        timers.set('c', None);
        assert_eq!(timers.next(), Some(at(15)));
        assert_eq!(timers.pop(at(14)), None);
        assert_eq!(timers.pop(at(40)), Some('a'));
        assert_eq!(timers.pop(at(40)), Some('b'));
        assert_eq!(timers.pop(at(40)), None);
        assert_eq!(timers.next(), None);
    }
}
