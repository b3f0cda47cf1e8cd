//! An unbounded queue without locks.

use crossbeam::queue::SegQueue;

use crate::queue::{Pushed, Queue};

/// crossbeam's `SegQueue`: a thread that loses the processor in the middle of a push holds up nobody else's. It takes
/// as much as there is memory, and never drops anything.
pub struct LockFree<T> {
    items: SegQueue<T>,
}

impl<T> LockFree<T> {
    /// An empty queue.
    #[must_use]
    pub fn new() -> Self {
        Self { items: SegQueue::new() }
    }
}

impl<T> Default for LockFree<T> {
    fn default() -> Self {
        Self::new()
    }
}

impl<T: Send> Queue<T> for LockFree<T> {
    fn push(&self, item: T) -> Pushed<T> {
        self.items.push(item);
        Pushed::Taken
    }

    fn pop(&self) -> Option<T> {
        self.items.pop()
    }

    fn len(&self) -> usize {
        self.items.len()
    }

    fn dropped(&self) -> u64 {
        0
    }
}
