//! The messages and the callback of all contestants.

use std::hint::black_box;
use std::num::NonZeroU64;
use std::ops::Range;

/// A sensor message of 32 bytes, as of an inertial measurement unit.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reading {
    /// The time of the measurement.
    pub time_ns: u64,
    /// The angular velocity in rad/s.
    pub angular_velocity: [f32; 3],
    /// The linear acceleration in m/s².
    pub linear_acceleration: [f32; 3],
}

impl Reading {
    /// A reading with its number as its time.
    #[must_use]
    pub fn new(number: u64) -> Self {
        Self { time_ns: number, angular_velocity: [0.25; 3], linear_acceleration: [0.0, 0.0, 9.81] }
    }
}

/// The state of a subscriber. Its callback adds a field of each message, and the compiler may neither remove
/// nor merge these additions.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sum(u64);

impl Sum {
    /// The body of every callback.
    #[inline]
    pub fn add(&mut self, reading: &Reading) {
        self.0 = black_box(self.0.wrapping_add(reading.time_ns));
    }

    /// The sum so far.
    #[must_use]
    pub fn value(self) -> u64 {
        self.0
    }
}

/// One publisher sends `messages` to each of `modules` subscribers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Load {
    /// The number of subscribing modules.
    pub modules: u64,
    /// The number of messages published in a trial.
    pub messages: u64,
    /// The largest number of messages published in one cycle. A larger trial takes several cycles, which
    /// bounds the memory of the designs that store one entry per delivery.
    pub batch: NonZeroU64,
}

impl Load {
    /// The number of callback calls in a trial.
    #[must_use]
    pub fn deliveries(self) -> u64 {
        self.modules * self.messages
    }

    /// The numbers of the messages of each cycle of a trial. They start at 1, so that the loss of any message
    /// is noticed.
    pub fn batches(self) -> impl Iterator<Item = Range<u64>> {
        let end_of = move |batch: u64| (batch * self.batch.get()).min(self.messages);
        (0..self.messages.div_ceil(self.batch.get()))
            .map(move |batch| end_of(batch) + 1..end_of(batch + 1) + 1)
    }

    /// The total of all subscribers' sums after a trial without losses.
    #[must_use]
    pub fn expected_sum(self) -> u64 {
        self.modules.wrapping_mul((1..=self.messages).sum())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_batches_of_a_trial_are_all_its_messages() {
        let load = Load { modules: 1, messages: 21, batch: NonZeroU64::new(10).unwrap() };
        assert_eq!(load.batches().collect::<Vec<_>>(), [1..11, 11..21, 21..22]);
    }
}
