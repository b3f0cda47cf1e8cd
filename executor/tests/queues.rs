//! The contract of all queues between threads, and the policies of bounded ones.
#![allow(clippy::unwrap_used, missing_docs)]

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use downbeat_executor::queue::{LockFree, Locked, Overflow, Pushed, Queue, Ring};

const POLICIES: [Overflow; 3] = [Overflow::DropOldest, Overflow::DropNewest, Overflow::Refuse];
const PRODUCERS: u64 = 4;
const ITEMS: u64 = 20_000;

fn size(capacity: usize) -> NonZeroUsize {
    NonZeroUsize::new(capacity).unwrap()
}

/// Each bounded queue with its policy.
fn bounded<T: Send + 'static>(capacity: usize) -> Vec<(String, Overflow, Arc<dyn Queue<T>>)> {
    let mut queues = Vec::new();
    for policy in POLICIES {
        let locked: Arc<dyn Queue<T>> = Arc::new(Locked::bounded(size(capacity), policy));
        let ring: Arc<dyn Queue<T>> = Arc::new(Ring::new(size(capacity), policy));
        queues.push((format!("Locked, {policy:?}"), policy, locked));
        queues.push((format!("Ring, {policy:?}"), policy, ring));
    }
    queues
}

/// Every queue; bounded ones hold `capacity` items.
fn all<T: Send + 'static>(capacity: usize) -> Vec<(String, Arc<dyn Queue<T>>)> {
    let unbounded: [(String, Arc<dyn Queue<T>>); 2] =
        [("Locked".into(), Arc::new(Locked::unbounded())), ("LockFree".into(), Arc::new(LockFree::new()))];
    let bounded = bounded(capacity).into_iter().map(|(name, _, queue)| (name, queue));
    unbounded.into_iter().chain(bounded).collect()
}

fn rest<T: Send>(queue: &dyn Queue<T>) -> Vec<T> {
    std::iter::from_fn(|| queue.pop()).collect()
}

#[test]
fn items_come_out_in_the_order_in_which_they_went_in() {
    for (name, queue) in all(8) {
        assert!(queue.is_empty() && queue.pop().is_none(), "{name}");
        for item in 0..8 {
            assert_eq!(queue.push(item), Pushed::Taken, "{name}");
        }
        assert_eq!(queue.len(), 8, "{name}");
        assert_eq!(rest(&*queue), (0..8).collect::<Vec<_>>(), "{name}");
        assert_eq!((queue.len(), queue.dropped()), (0, 0), "{name}");
    }
}

#[test]
fn a_full_queue_does_what_its_policy_says_and_counts_what_it_dropped() {
    for (name, policy, queue) in bounded(3) {
        (0..3).for_each(|item| assert_eq!(queue.push(item), Pushed::Taken, "{name}"));
        let (pushed, left, dropped) = match policy {
            Overflow::DropOldest => (Pushed::Dropped, [2, 3, 4], 2),
            Overflow::DropNewest => (Pushed::Dropped, [0, 1, 2], 2),
            Overflow::Refuse => (Pushed::Refused(3), [0, 1, 2], 0),
        };
        assert_eq!(queue.push(3), pushed, "{name}");
        queue.push(4);
        assert_eq!((rest(&*queue), queue.dropped()), (left.to_vec(), dropped), "{name}");
        assert_eq!(queue.push(5), Pushed::Taken, "{name}: there is room again");
    }
}

#[test]
fn a_queue_for_one_item_works() {
    for (name, policy, queue) in bounded(1) {
        (1..=3).for_each(|item| _ = queue.push(item));
        let kept = if policy == Overflow::DropOldest { 3 } else { 1 };
        assert_eq!(rest(&*queue), [kept], "{name}");
    }
}

#[test]
fn what_is_left_in_a_queue_is_dropped_with_it_and_what_it_dropped_before() {
    for (name, queue) in all(2) {
        let item = Arc::new(());
        (0..5).for_each(|_| _ = queue.push(Arc::clone(&item)));
        let unbounded = !name.contains(',');
        assert_eq!(Arc::strong_count(&item), if unbounded { 6 } else { 3 }, "{name}");
        drop(queue);
        assert_eq!(Arc::strong_count(&item), 1, "{name}");
    }
}

/// Panics when dropped, if armed.
struct Bomb(bool);

impl Drop for Bomb {
    fn drop(&mut self) {
        assert!(!self.0 || std::thread::panicking(), "an item that panics, as this test wants it");
    }
}

#[test]
fn an_item_that_panics_while_it_is_dropped_leaves_the_queue_usable() {
    for policy in [Overflow::DropOldest, Overflow::DropNewest] {
        let queues: [(&str, Box<dyn Queue<Bomb>>); 2] = [
            ("Locked", Box::new(Locked::bounded(size(1), policy))),
            ("Ring", Box::new(Ring::new(size(1), policy))),
        ];
        for (name, queue) in queues {
            let oldest_goes = policy == Overflow::DropOldest;
            queue.push(Bomb(oldest_goes));
            let push = std::panic::AssertUnwindSafe(|| drop(queue.push(Bomb(!oldest_goes))));
            assert!(std::panic::catch_unwind(push).is_err(), "{name}, {policy:?}");
            assert_eq!((queue.len(), queue.dropped()), (1, 1), "{name}, {policy:?}");
            assert!(queue.pop().is_some_and(|bomb| !bomb.0), "{name}, {policy:?}");
        }
    }
}

/// An item with the number of its producer and its number in that producer's sequence.
type Item = (u64, u64);

/// Several threads push while one pops; returns the popped items and the number of refused ones.
fn under_load(queue: &Arc<dyn Queue<Item>>) -> (Vec<Item>, u64) {
    let is_over = AtomicBool::new(false);
    std::thread::scope(|scope| {
        let consumer = scope.spawn(|| {
            let mut popped = Vec::new();
            while !is_over.load(Ordering::Acquire) {
                match queue.pop() {
                    Some(item) => popped.push(item),
                    None => std::thread::yield_now(),
                }
            }
            popped.extend(rest(&**queue));
            popped
        });
        let producers: Vec<_> = (0..PRODUCERS)
            .map(|producer| {
                scope.spawn(move || {
                    let is_refused = |number: &u64| {
                        let pushed = queue.push((producer, *number));
                        // Lets threads meet in the queue even on a machine with few processors.
                        if number.is_multiple_of(64) {
                            std::thread::yield_now();
                        }
                        matches!(pushed, Pushed::Refused(_))
                    };
                    (0..ITEMS).filter(is_refused).count() as u64
                })
            })
            .collect();
        let refused = producers.into_iter().map(|producer| producer.join().unwrap()).sum();
        is_over.store(true, Ordering::Release);
        (consumer.join().unwrap(), refused)
    })
}

#[test]
fn under_load_nothing_is_lost_or_doubled_and_each_producers_order_is_kept() {
    for (name, queue) in all(16) {
        let (popped, refused) = under_load(&queue);
        for producer in 0..PRODUCERS {
            let numbers = popped.iter().filter(|item| item.0 == producer).map(|item| item.1);
            // Strictly ascending, which also excludes duplicates.
            assert!(numbers.is_sorted_by(|one, next| one < next), "{name}: producer {producer}");
        }
        let accounted = popped.len() as u64 + queue.dropped() + refused;
        assert_eq!(accounted, PRODUCERS * ITEMS, "{name}: {} popped, {refused} refused", popped.len());
        assert!(queue.is_empty(), "{name}");
    }
}

#[test]
fn several_threads_may_pop() {
    for (name, queue) in all(1024) {
        (0..1000_u64).for_each(|item| _ = queue.push(item));
        let mut popped: Vec<u64> = std::thread::scope(|scope| {
            let consumers: Vec<_> = (0..4).map(|_| scope.spawn(|| rest(&*queue))).collect();
            consumers.into_iter().flat_map(|consumer| consumer.join().unwrap()).collect()
        });
        popped.sort_unstable();
        assert_eq!(popped, (0..1000).collect::<Vec<_>>(), "{name}");
    }
}
