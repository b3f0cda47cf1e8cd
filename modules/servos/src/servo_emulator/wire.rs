//! The timing of bytes on the bus.
//!
//! On a real Darwin OP the sync write and bulk read of one cycle take 6.87 ms with a deviation of 0.02 to 0.1
//! ms, and sometimes 1 ms more. At ten bit times per byte, the bytes alone take 5.39 ms; the rest is
//! attributed to the devices, each of which waits before it answers.
//!
//! # References
//! klowrey/darwin, `notes.txt` (measurements of 2015).

use super::random::Random;
use std::time::Duration;

/// The bit times of a byte.
const BITS_PER_BYTE: u64 = 10;
/// From the last preceding byte to the first byte of the answer.
const TURNAROUND: Duration = Duration::from_micros(70);
const JITTER_US: f64 = 40.0;
/// One of this many instructions is late by [`LATE`].
const LATE_ONE_IN: u64 = 1000;
const LATE: Duration = Duration::from_millis(1);
/// The serial chip passes on bytes in bundles at this interval.
const BUNDLE: Duration = Duration::from_millis(1);

/// Whether the timing of the bus is emulated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Timing {
    /// As on a robot: bytes take time, devices wait before they answer.
    #[default]
    Measured,
    /// Answers arrive at once, and the emulator's time is the time that the bus would have taken, so that it
    /// advances only with instructions. The same instructions then get the same answers. Servos answer as
    /// soon as they have power.
    Immediate,
    /// As [`Timing::Immediate`], and time also advances to that of each step of the owner of the bus
    /// ([`Emulator::begin_step`](super::Emulator::begin_step)).
    Stepped,
}

/// An answer of a device.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Answer {
    /// The status packet.
    pub packet: Vec<u8>,
    /// The delay before it, from the device's setting.
    pub return_delay: Duration,
}

/// Bytes that reach the computer together.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Bundle {
    pub(super) at: Duration,
    pub(super) bytes: Vec<u8>,
}

pub(super) struct Wire {
    per_byte: Duration,
    free_at: Duration,
    jitter: Random,
}

impl Wire {
    pub(super) fn new(seed: u64, baud: u32) -> Self {
        let per_byte = Duration::from_nanos(BITS_PER_BYTE * 1_000_000_000 / u64::from(baud.max(1)));
        Self { per_byte, free_at: Duration::ZERO, jitter: Random::new(seed, 3) }
    }

    /// When all bytes so far have been transmitted.
    pub(super) fn free_at(&self) -> Duration {
        self.free_at
    }

    /// When the answers to an instruction sent at `now` reach the computer.
    pub(super) fn carry(
        &mut self,
        now: Duration,
        instruction_length: usize,
        answers: &[Answer],
    ) -> Vec<Bundle> {
        let begin = now.max(self.free_at);
        let mut at = begin + self.per_byte * instruction_length as u32;
        if !answers.is_empty() {
            at += self.delay();
        }
        let mut bundles: Vec<Bundle> = Vec::new();
        let mut bundle_begins = begin;
        for answer in answers {
            at += TURNAROUND + answer.return_delay + self.per_byte * answer.packet.len() as u32;
            match bundles.last_mut() {
                Some(bundle) if at < bundle_begins + BUNDLE => {
                    bundle.at = at;
                    bundle.bytes.extend_from_slice(&answer.packet);
                }
                _ => {
                    bundle_begins = at;
                    bundles.push(Bundle { at, bytes: answer.packet.clone() });
                }
            }
        }
        self.free_at = at;
        bundles
    }

    fn delay(&mut self) -> Duration {
        let jitter_us = self.jitter.normal(JITTER_US).abs();
        let late = if self.jitter.next_u64().is_multiple_of(LATE_ONE_IN) { LATE } else { Duration::ZERO };
        Duration::from_nanos((jitter_us * 1000.0) as u64) + late
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn answer(length: usize) -> Answer {
        Answer { packet: vec![0; length], return_delay: Duration::ZERO }
    }

    #[test]
    fn sync_write_and_bulk_read_take_the_measured_time() {
        let mut wire = Wire::new(1, 1_000_000);
        let answers: Vec<Answer> = std::iter::once(answer(33)).chain((0..20).map(|_| answer(14))).collect();
        let mut times: Vec<f64> = (0..500)
            .map(|cycle| {
                let now = Duration::from_millis(8 * cycle);
                for length in [78, 78] {
                    wire.carry(now, length, &[]);
                }
                wire.carry(now, 70, &answers);
                (wire.free_at() - now).as_secs_f64() * 1000.0
            })
            .collect();
        times.sort_by(f64::total_cmp);
        assert!((times[250] - 6.87).abs() < 0.03, "median {} ms", times[250]);
        assert!(times[475] - times[25] < 0.2, "from {} to {} ms", times[25], times[475]);
    }

    #[test]
    fn no_part_of_the_answers_is_lost_or_early() {
        let mut wire = Wire::new(1, 1_000_000);
        let bundles = wire.carry(Duration::ZERO, 70, &[answer(33), answer(14), answer(200), answer(14)]);
        assert_eq!(bundles.iter().map(|bundle| bundle.bytes.len()).sum::<usize>(), 261);
        assert!(bundles.is_sorted_by_key(|bundle| bundle.at));
        assert_eq!(bundles.last().map(|bundle| bundle.at), Some(wire.free_at()));
        assert!(bundles[0].at >= Duration::from_micros(700 + 330));
    }

    #[test]
    fn an_instruction_waits_until_the_wire_is_free() {
        let mut wire = Wire::new(1, 1_000_000);
        wire.carry(Duration::ZERO, 100, &[]);
        wire.carry(Duration::ZERO, 100, &[]);
        assert_eq!(wire.free_at(), Duration::from_millis(2));
    }
}
