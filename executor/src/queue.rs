//! Queues between threads, bounded and unbounded, and their behaviour when full.
//!
//! Modules need no such queues, since requests between modules wait inside the modules until the sync phase.
//! Queues accept input from outside the cycle, behind an [`Inlet`](crate::Inlet). The default there is a
//! bounded [`Locked`]; [`Core::inlet_with`](crate::Core::inlet_with) accepts any other, including a
//! user-defined one.
//!
//! | queue | bounded | allocates | implementation |
//! | --- | --- | --- | --- |
//! | [`Locked`] | optionally | until it has grown | a lock around a `VecDeque` |
//! | [`LockFree`] | no | a block for each 31 items | crossbeam's `SegQueue` |
//! | [`Ring`] | yes | once | crossbeam's `ArrayQueue` |

use std::collections::VecDeque;
use std::num::NonZeroUsize;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, MutexGuard};

use crossbeam::queue::{ArrayQueue, SegQueue};

use crate::threads::unpoisoned;

/// A queue with many producers and one consumer.
///
/// Items of one thread come out in the order in which that thread pushed them. No method waits for another
/// thread longer than that thread takes to push or pop one item.
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
    /// Adds an item, or applies the queue's policy if the queue is full. Never waits for space.
    fn push(&self, item: T) -> Pushed<T>;

    /// Removes and returns the oldest item.
    fn pop(&self) -> Option<T>;

    /// The number of queued items.
    fn len(&self) -> usize;

    /// True if the queue is empty.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The number of items dropped so far because the queue was full. Refused items are not counted, since
    /// the caller still has them.
    fn dropped(&self) -> u64;
}

/// The outcome of a push.
#[derive(Debug, PartialEq, Eq)]
pub enum Pushed<T> {
    /// The item was queued.
    Taken,
    /// The queue was full, and this item or the oldest was dropped.
    Dropped,
    /// The queue was full; this returns the item.
    Refused(T),
}

/// The policy of a bounded queue that is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// Drops the oldest item; suits measurements, where only the latest counts.
    DropOldest,
    /// Drops the new item; suits data whose queued items must be delivered.
    DropNewest,
    /// Returns the new item to the caller.
    Refuse,
}

/// A queue behind a lock: simple, and fair with few producers. A thread that is preempted while it holds the
/// lock delays the others for that time.
pub struct Locked<T> {
    limit: Option<(NonZeroUsize, Overflow)>,
    state: Mutex<State<T>>,
}

struct State<T> {
    items: VecDeque<T>,
    dropped: u64,
}

impl<T> Locked<T> {
    /// A queue that is limited only by memory.
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
        // Drops the item after the lock is released, because its destructor is the user's code and may panic.
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

/// crossbeam's `SegQueue`: a thread that is preempted in the middle of a push delays no other thread's push.
/// It is limited only by memory and never drops an item.
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

/// crossbeam's `ArrayQueue`: space for a fixed number of items, allocated once. If several threads push at
/// once, the policy [`DropOldest`](Overflow::DropOldest) still drops only as many items as needed.
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
