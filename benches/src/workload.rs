//! What every contestant carries, and what every callback does with it.

use std::hint::black_box;
use std::num::NonZeroU64;
use std::ops::Range;

/// A small sensor message of 32 bytes: what an inertial measurement unit tells.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reading {
    /// When it was measured.
    pub time_ns: u64,
    /// In rad/s.
    pub angular_velocity: [f32; 3],
    /// In m/s².
    pub linear_acceleration: [f32; 3],
}

impl Reading {
    /// A reading that tells its number as its time.
    #[must_use]
    pub fn new(number: u64) -> Self {
        Self { time_ns: number, angular_velocity: [0.25; 3], linear_acceleration: [0.0, 0.0, 9.81] }
    }
}

/// The state of a subscriber. Its callback touches each message: it adds a field of it, and the compiler may not
/// leave out or merge any of these additions.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sum(u64);

impl Sum {
    /// What every callback does.
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
    /// How many modules subscribe.
    pub modules: u64,
    /// How many messages are published in a trial.
    pub messages: u64,
    /// How many of them are published in one cycle at most. A trial with more takes several cycles, which bounds
    /// the memory of the designs that store one entry per delivery.
    pub batch: NonZeroU64,
}

impl Load {
    /// How many times a callback is called with a message in a trial.
    #[must_use]
    pub fn deliveries(self) -> u64 {
        self.modules * self.messages
    }

    /// The numbers of the messages of each cycle of a trial, from 1 on so that none is lost unnoticed.
    pub fn batches(self) -> impl Iterator<Item = Range<u64>> {
        let end_of = move |batch: u64| (batch * self.batch.get()).min(self.messages);
        (0..self.messages.div_ceil(self.batch.get()))
            .map(move |batch| end_of(batch) + 1..end_of(batch + 1) + 1)
    }

    /// What the sums of all subscribers add up to after a trial in which nothing was lost.
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
