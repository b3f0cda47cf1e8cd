//! The compared designs.

mod downbeat;
mod limit;
mod queues;

pub use downbeat::Downbeat;
pub use limit::{Limit, LimitOnTwoThreads};
pub use queues::{LockFree, Locked, Queue, Queues};

/// A design, prepared for one [`Load`](crate::Load).
pub trait Contestant {
    /// Runs a trial, from its first publish to its last delivery.
    fn trial(&mut self);

    /// Ends the contestant. Returns the sum over all subscribers and trials, which shows whether every
    /// message arrived.
    fn finish(self: Box<Self>) -> u64;
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::num::NonZeroU64;

    use super::*;
    use crate::Load;
    use crate::launchers::LAUNCHERS;

    #[test]
    fn every_contestant_delivers_every_message_to_every_subscriber() {
        for messages in [1, 9, 10, 27] {
            let load = Load { modules: 5, messages, batch: NonZeroU64::new(10).unwrap() };
            let mut contestants: Vec<(&str, Box<dyn Contestant>)> = vec![
                ("limit", Box::new(Limit::new(load))),
                ("limit, two threads", Box::new(LimitOnTwoThreads::new(load))),
                ("lock-free queues", Box::new(Queues::<LockFree>::new(load))),
                ("locked queues", Box::new(Queues::<Locked>::new(load))),
            ];
            for launcher in LAUNCHERS {
                contestants.push((launcher.name, Box::new(Downbeat::new(load, launcher).unwrap())));
            }
            for (name, mut contestant) in contestants {
                contestant.trial();
                contestant.trial();
                let expected = 2 * load.expected_sum();
                assert_eq!(contestant.finish(), expected, "{name} with {messages} messages");
            }
        }
    }
}
