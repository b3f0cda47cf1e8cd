//! The lower limit: the minimal work, on one thread and on two.

use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, RwLock};
use std::thread::JoinHandle;

use super::Contestant;
use crate::{Load, Reading, Sum};

/// A plain loop over the subscribers with one indirect call each per batch. The batch is stored once.
pub struct Limit {
    load: Load,
    batch: Vec<Reading>,
    subscribers: Vec<Box<dyn Subscriber>>,
}

impl Limit {
    /// Makes the subscribers.
    #[must_use]
    pub fn new(load: Load) -> Self {
        Self { load, batch: Vec::new(), subscribers: subscribers(load.modules) }
    }
}

impl Contestant for Limit {
    fn trial(&mut self) {
        for batch in self.load.batches() {
            self.batch.clear();
            self.batch.extend(batch.map(Reading::new));
            self.subscribers.iter_mut().for_each(|subscriber| subscriber.receive(&self.batch));
        }
    }

    fn finish(self: Box<Self>) -> u64 {
        sum(&self.subscribers)
    }
}

/// The same loop with half of the subscribers on a second thread, which spins for a moment and then parks
/// while it waits for a batch, as the threads of a pool do.
pub struct LimitOnTwoThreads {
    load: Load,
    shared: Arc<Shared>,
    /// `None` after the end.
    helper: Option<JoinHandle<()>>,
}

struct Shared {
    batch: RwLock<Vec<Reading>>,
    halves: [Mutex<Vec<Box<dyn Subscriber>>>; 2],
    /// The number of the batch to be delivered; [`END`] after the last one.
    published: AtomicU64,
    /// The number of the last batch that the helper has delivered.
    delivered: AtomicU64,
}

const END: u64 = u64::MAX;
const SPINS: u32 = 10_000;

impl LimitOnTwoThreads {
    /// Makes the subscribers and the second thread.
    #[must_use]
    pub fn new(load: Load) -> Self {
        let half = load.modules / 2;
        let shared = Arc::new(Shared {
            batch: RwLock::default(),
            halves: [half, load.modules - half].map(|modules| Mutex::new(subscribers(modules))),
            published: AtomicU64::new(0),
            delivered: AtomicU64::new(0),
        });
        let helped = Arc::clone(&shared);
        Self { load, shared, helper: Some(std::thread::spawn(move || helped.help())) }
    }
}

impl Shared {
    fn deliver(&self, half: usize) {
        let batch = self.batch.read().unwrap_or_else(PoisonError::into_inner);
        let mut subscribers = self.halves[half].lock().unwrap_or_else(PoisonError::into_inner);
        subscribers.iter_mut().for_each(|subscriber| subscriber.receive(&batch));
    }

    fn help(&self) {
        let mut last = 0;
        loop {
            let mut spins = 0;
            while self.published.load(Ordering::Acquire) == last {
                spins += 1;
                if spins < SPINS { std::hint::spin_loop() } else { std::thread::park() }
            }
            last = self.published.load(Ordering::Acquire);
            if last == END {
                return;
            }
            self.deliver(1);
            self.delivered.store(last, Ordering::Release);
        }
    }

    fn publish(&self, number: u64, helper: Option<&JoinHandle<()>>) {
        self.published.store(number, Ordering::Release);
        if let Some(helper) = helper {
            helper.thread().unpark();
        }
    }
}

impl Contestant for LimitOnTwoThreads {
    fn trial(&mut self) {
        for batch in self.load.batches() {
            {
                let mut stored = self.shared.batch.write().unwrap_or_else(PoisonError::into_inner);
                stored.clear();
                stored.extend(batch.map(Reading::new));
            }
            let number = self.shared.published.load(Ordering::Relaxed) + 1;
            self.shared.publish(number, self.helper.as_ref());
            self.shared.deliver(0);
            while self.shared.delivered.load(Ordering::Acquire) != number {
                std::hint::spin_loop();
            }
        }
    }

    fn finish(self: Box<Self>) -> u64 {
        let of = |half: &Mutex<Vec<_>>| sum(&half.lock().unwrap_or_else(PoisonError::into_inner));
        self.shared.halves.iter().fold(0, |total, half| total.wrapping_add(of(half)))
    }
}

impl Drop for LimitOnTwoThreads {
    fn drop(&mut self) {
        self.shared.publish(END, self.helper.as_ref());
        if let Some(helper) = self.helper.take() {
            let _ = helper.join();
        }
    }
}

fn subscribers(number: u64) -> Vec<Box<dyn Subscriber>> {
    (0..number).map(|_| Box::new(Sum::default()) as Box<dyn Subscriber>).collect()
}

fn sum(subscribers: &[Box<dyn Subscriber>]) -> u64 {
    subscribers.iter().fold(0, |total, subscriber| total.wrapping_add(subscriber.sum()))
}

trait Subscriber: Send {
    fn receive(&mut self, batch: &[Reading]);
    fn sum(&self) -> u64;
}

impl Subscriber for Sum {
    fn receive(&mut self, batch: &[Reading]) {
        for reading in batch {
            self.add(reading);
        }
    }

    fn sum(&self) -> u64 {
        self.value()
    }
}
