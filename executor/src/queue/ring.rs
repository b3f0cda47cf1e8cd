//! A bounded queue without locks.

use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicU64, Ordering};

use crossbeam::queue::ArrayQueue;

use crate::queue::{Overflow, Pushed, Queue};

/// crossbeam's `ArrayQueue`: room for a fixed number of items, taken once. Where it drops the oldest item it drops no
/// more than it needs, whoever else pushes.
pub struct Ring<T> {
    items: ArrayQueue<T>,
    overflow: Overflow,
    dropped: AtomicU64,
}

impl<T> Ring<T> {
    /// An empty queue for at most `capacity` items.
    #[must_use]
    pub fn new(capacity: NonZeroUsize, overflow: Overflow) -> Self {
        Self { items: ArrayQueue::new(capacity.get()), overflow, dropped: AtomicU64::new(0) }
    }
}

impl<T: Send> Queue<T> for Ring<T> {
    fn push(&self, item: T) -> Pushed<T> {
        let dropped = match self.overflow {
            Overflow::DropOldest => self.items.force_push(item),
            Overflow::DropNewest => self.items.push(item).err(),
            Overflow::Refuse => {
                return self.items.push(item).map_or_else(Pushed::Refused, |()| Pushed::Taken);
            }
        };
        match dropped {
            None => Pushed::Taken,
            Some(dropped) => {
                self.dropped.fetch_add(1, Ordering::Relaxed);
                drop(dropped);
                Pushed::Dropped
            }
        }
    }

    fn pop(&self) -> Option<T> {
        self.items.pop()
    }

    fn len(&self) -> usize {
        self.items.len()
    }

    fn dropped(&self) -> u64 {
        self.dropped.load(Ordering::Relaxed)
    }
}
