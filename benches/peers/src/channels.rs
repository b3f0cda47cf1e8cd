//! Channels: one per subscriber, or a shared one that every subscriber reads.

use std::sync::Arc;

use benches::contestants::Contestant;
use benches::{Load, Reading, Sum};
use crossbeam::channel::{Receiver, Sender, unbounded};
use tokio::sync::broadcast;

/// crossbeam: an unbounded channel per subscriber, with the message behind a shared pointer.
pub struct Crossbeam {
    load: Load,
    senders: Vec<Sender<Arc<Reading>>>,
    receivers: Vec<(Receiver<Arc<Reading>>, Sum)>,
}

impl Crossbeam {
    pub fn new(load: Load) -> Self {
        let (senders, receivers) = (0..load.modules).map(|_| unbounded()).unzip::<_, _, Vec<_>, Vec<_>>();
        Self {
            load,
            senders,
            receivers: receivers.into_iter().map(|receiver| (receiver, Sum::default())).collect(),
        }
    }
}

impl Contestant for Crossbeam {
    fn trial(&mut self) {
        for batch in self.load.batches() {
            for number in batch {
                let message = Arc::new(Reading::new(number));
                for sender in &self.senders {
                    // Fails only if the receiver was dropped; lost messages show in the sum.
                    let _ = sender.send(Arc::clone(&message));
                }
            }
            for (receiver, sum) in &mut self.receivers {
                while let Ok(message) = receiver.try_recv() {
                    sum.add(&message);
                }
            }
        }
    }

    fn finish(self: Box<Self>) -> u64 {
        self.receivers.iter().fold(0, |total, (_, sum)| total.wrapping_add(sum.value()))
    }
}

/// tokio: one broadcast channel, from which each subscriber takes a copy of the message.
pub struct Tokio {
    load: Load,
    sender: broadcast::Sender<Reading>,
    receivers: Vec<(broadcast::Receiver<Reading>, Sum)>,
}

impl Tokio {
    pub fn new(load: Load) -> Self {
        let capacity = usize::try_from(load.batch.get().min(load.messages)).unwrap_or(1);
        let (sender, _) = broadcast::channel(capacity);
        let receivers = (0..load.modules).map(|_| (sender.subscribe(), Sum::default())).collect();
        Self { load, sender, receivers }
    }
}

impl Contestant for Tokio {
    fn trial(&mut self) {
        for batch in self.load.batches() {
            for number in batch {
                let _ = self.sender.send(Reading::new(number));
            }
            for (receiver, sum) in &mut self.receivers {
                while let Ok(message) = receiver.try_recv() {
                    sum.add(&message);
                }
            }
        }
    }

    fn finish(self: Box<Self>) -> u64 {
        self.receivers.iter().fold(0, |total, (_, sum)| total.wrapping_add(sum.value()))
    }
}
