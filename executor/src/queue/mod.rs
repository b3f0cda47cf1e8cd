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

mod lock_free;
mod locked;
mod ring;

pub use lock_free::LockFree;
pub use locked::Locked;
pub use ring::Ring;

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
