//! What must be done at least.

use super::Contestant;
use crate::{Load, Reading, Sum};

/// A plain loop over the subscribers, one indirect call each per batch. The batch is stored once.
pub struct Limit {
    load: Load,
    batch: Vec<Reading>,
    subscribers: Vec<Box<dyn Subscriber>>,
}

impl Limit {
    /// Makes the subscribers.
    #[must_use]
    pub fn new(load: Load) -> Self {
        let subscribers = (0..load.modules).map(|_| Box::new(Sum::default()) as Box<dyn Subscriber>);
        Self { load, batch: Vec::new(), subscribers: subscribers.collect() }
    }
}

impl Contestant for Limit {
    fn trial(&mut self) {
        for batch in self.load.batches() {
            self.batch.clear();
            for number in batch {
                self.batch.push(Reading::new(number));
            }
            for subscriber in &mut self.subscribers {
                subscriber.receive(&self.batch);
            }
        }
    }

    fn finish(self: Box<Self>) -> u64 {
        self.subscribers.iter().fold(0, |total, subscriber| total.wrapping_add(subscriber.sum()))
    }
}

trait Subscriber {
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
