//! The design of the published platform: a queue per module, with one entry per delivery.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use crossbeam::queue::SegQueue;

use super::Contestant;
use crate::{Load, Reading, Sum};

/// A queue that may be used from any thread, as required of a module's queue in this design.
pub trait Queue: Default {
    /// Appends an entry.
    fn push(&self, entry: Arc<Reading>);
    /// Removes and returns the first entry.
    fn pop(&self) -> Option<Arc<Reading>>;
}

/// crossbeam's unbounded lock-free queue.
#[derive(Default)]
pub struct LockFree(SegQueue<Arc<Reading>>);

impl Queue for LockFree {
    fn push(&self, entry: Arc<Reading>) {
        self.0.push(entry);
    }

    fn pop(&self) -> Option<Arc<Reading>> {
        self.0.pop()
    }
}

/// A ring that grows, behind a lock.
#[derive(Default)]
pub struct Locked(Mutex<VecDeque<Arc<Reading>>>);

impl Queue for Locked {
    fn push(&self, entry: Arc<Reading>) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push_back(entry);
    }

    fn pop(&self) -> Option<Arc<Reading>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).pop_front()
    }
}

/// Publishing puts a shared pointer into the queue of each subscriber. Then each subscriber empties its queue
/// and makes one indirect call of its callback per entry, all on one thread.
pub struct Queues<Q> {
    load: Load,
    modules: Vec<(Q, Box<dyn Subscriber>)>,
}

impl<Q: Queue> Queues<Q> {
    /// Makes the queues and the subscribers.
    #[must_use]
    pub fn new(load: Load) -> Self {
        let module = |_| (Q::default(), Box::new(Sum::default()) as Box<dyn Subscriber>);
        Self { load, modules: (0..load.modules).map(module).collect() }
    }
}

impl<Q: Queue> Contestant for Queues<Q> {
    fn trial(&mut self) {
        for batch in self.load.batches() {
            for number in batch {
                let message = Arc::new(Reading::new(number));
                for (queue, _) in &self.modules {
                    queue.push(Arc::clone(&message));
                }
            }
            for (queue, subscriber) in &mut self.modules {
                while let Some(message) = queue.pop() {
                    subscriber.receive(&message);
                }
            }
        }
    }

    fn finish(self: Box<Self>) -> u64 {
        self.modules.iter().fold(0, |total, (_, subscriber)| total.wrapping_add(subscriber.sum()))
    }
}

trait Subscriber {
    fn receive(&mut self, message: &Reading);
    fn sum(&self) -> u64;
}

impl Subscriber for Sum {
    fn receive(&mut self, message: &Reading) {
        self.add(message);
    }

    fn sum(&self) -> u64 {
        self.value()
    }
}
