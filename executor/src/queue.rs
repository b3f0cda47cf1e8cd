//! Queues between threads: what waits for the core, and what happens when too much does.
//!
//! Modules need none of them, since what they ask of each other waits in places of their own. A queue stands where
//! something comes from outside the cycle: behind an [`Inlet`](crate::Inlet). A bounded [`Locked`] is the default there;
//! [`Core::inlet_with`](crate::Core::inlet_with) takes any other, a user's own too.
//!
//! | queue | bounded | allocates | of |
//! | --- | --- | --- | --- |
//! | [`Locked`] | as asked | until it has grown | a lock around a `VecDeque` |
//! | [`LockFree`] | no | a block for each 31 items | crossbeam's `SegQueue` |
//! | [`Ring`] | yes | once | crossbeam's `ArrayQueue` |

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard};

use crossbeam::queue::{ArrayQueue, SegQueue};

use crate::threads::unpoisoned;

/// A queue between threads: many push, one pops.
///
/// Items of one thread come out in the order in which it pushed them. No method waits for another thread longer than
/// that takes to push or pop one item.
///
/// ```
/// use std::collections::BTreeMap;
/// use std::sync::Mutex;
/// use downbeat_executor::queue::{Pushed, Queue};
///
/// /// Keeps the latest item only: for what is worth nothing when it is old.
/// struct Latest<T>(Mutex<(Option<T>, u64)>);
///
/// impl<T: Send> Queue<T> for Latest<T> {
///     fn push(&self, item: T) -> Pushed<T> {
///         let mut latest = self.0.lock().unwrap();
///         match latest.0.replace(item) {
///             None => Pushed::Taken,
///             Some(_older) => {
///                 latest.1 += 1;
///                 Pushed::Dropped
///             }
///         }
///     }
///     fn pop(&self) -> Option<T> {
///         self.0.lock().unwrap().0.take()
///     }
///     fn len(&self) -> usize {
///         usize::from(self.0.lock().unwrap().0.is_some())
///     }
///     fn dropped(&self) -> u64 {
///         self.0.lock().unwrap().1
///     }
/// }
///
/// let mut core = downbeat_executor::Core::new();
/// let inlet = core.inlet_with::<u32>("speed", Latest(Mutex::new((None, 0))))?;
/// for speed in [1, 2, 3] {
///     inlet.publish(speed)?;
/// }
/// assert_eq!(inlet.dropped(), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub trait Queue<T: Send>: Send + Sync {
    /// Adds an item, or does what the queue does when it is full. Never waits for room.
    fn push(&self, item: T) -> Pushed<T>;

    /// Takes the item that waits longest.
    fn pop(&self) -> Option<T>;

    /// How many items wait.
    fn len(&self) -> usize;

    /// True if none waits.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// How many items were dropped so far because the queue was full. Refused ones are not counted: who pushed them
    /// has them.
    fn dropped(&self) -> u64;
}

/// What became of an item that was pushed.
#[derive(Debug, PartialEq, Eq)]
pub enum Pushed<T> {
    /// It waits.
    Taken,
    /// The queue was full, and this item or the oldest was dropped.
    Dropped,
    /// The queue was full; here it is again.
    Refused(T),
}

/// What a bounded queue does when it is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// Drops the item that waits longest: for measurements, of which the latest counts.
    DropOldest,
    /// Drops the item that comes: for what was promised to those that wait.
    DropNewest,
    /// Gives back the item that comes, so that who pushed it knows.
    Refuse,
}

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
