//! A lock around a `VecDeque`.

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::sync::{Mutex, MutexGuard};

use crate::threads::unpoisoned;

use crate::queue::{Overflow, Pushed, Queue};

/// A queue behind a lock: the simplest, and fair where few threads push. A thread that loses the processor while it
/// holds the lock holds up the others for that time.
pub struct Locked<T> {
    limit: Option<(NonZeroUsize, Overflow)>,
    state: Mutex<State<T>>,
}

struct State<T> {
    items: VecDeque<T>,
    dropped: u64,
}

impl<T> Locked<T> {
    /// A queue that takes as much as there is memory.
    #[must_use]
    pub fn unbounded() -> Self {
        Self { limit: None, state: Mutex::new(State { items: VecDeque::new(), dropped: 0 }) }
    }

    /// A queue for at most `capacity` items.
    #[must_use]
    pub fn bounded(capacity: NonZeroUsize, overflow: Overflow) -> Self {
        Self { limit: Some((capacity, overflow)), ..Self::unbounded() }
    }

    fn lock(&self) -> MutexGuard<'_, State<T>> {
        unpoisoned(self.state.lock())
    }
}

impl<T: Send> Queue<T> for Locked<T> {
    fn push(&self, item: T) -> Pushed<T> {
        let mut state = self.lock();
        let overflow = self.limit.filter(|(capacity, _)| state.items.len() >= capacity.get());
        let dropped = match overflow.map(|(_, overflow)| overflow) {
            None => {
                state.items.push_back(item);
                return Pushed::Taken;
            }
            Some(Overflow::Refuse) => return Pushed::Refused(item),
            Some(Overflow::DropNewest) => Some(item),
            Some(Overflow::DropOldest) => {
                let oldest = state.items.pop_front();
                state.items.push_back(item);
                oldest
            }
        };
        state.dropped += 1;
        drop(state);
        // After the lock: dropping it may run code of its own, and may panic.
        drop(dropped);
        Pushed::Dropped
    }

    fn pop(&self) -> Option<T> {
        self.lock().items.pop_front()
    }

    fn len(&self) -> usize {
        self.lock().items.len()
    }

    fn dropped(&self) -> u64 {
        self.lock().dropped
    }
}
