//! Determines which faults are active at a time.

use super::fault::{Fault, FaultKind, Rate};
use super::random::Random;
use crate::darwin_op::protocol::Id;
use std::time::Duration;

/// The faults of a run. Times are those of the emulator.
pub(super) struct FaultSchedule {
    faults: Vec<Fault>,
    random: Random,
}

impl FaultSchedule {
    pub(super) fn new(faults: Vec<Fault>, seed: u64) -> Self {
        Self { faults, random: Random::new(seed, 4) }
    }

    /// Adds a fault with times relative to `now`, and removes those that are over.
    pub(super) fn inject(&mut self, fault: Fault, now: Duration) {
        self.faults.retain(|fault| fault.to.is_none_or(|to| now < to) && !is_used_up(fault));
        self.faults.push(Fault { from: now + fault.from, to: fault.to.map(|to| now + to), ..fault });
    }

    pub(super) fn is_dead(&self, id: Id, now: Duration) -> bool {
        self.on(now).any(|fault| fault.kind == FaultKind::DeadServo(id))
    }

    pub(super) fn is_port_closed(&self, now: Duration) -> bool {
        self.on(now).any(|fault| fault.kind == FaultKind::ClosePort)
    }

    /// Whether the answer that is about to be sent is lost.
    pub(super) fn loses_answer(&mut self, now: Duration) -> bool {
        let random = &mut self.random;
        let mut is_lost = false;
        for fault in self.faults.iter_mut().filter(|fault| is_on(fault, now)) {
            if let FaultKind::Drop(rate) = &mut fault.kind {
                is_lost |= happens(rate, random);
            }
        }
        is_lost
    }

    /// Flips bits of an answer. Returns their number.
    pub(super) fn flip(&mut self, packet: &mut [u8], now: Duration) -> u64 {
        let random = &mut self.random;
        let mut flipped = 0;
        for fault in self.faults.iter_mut().filter(|fault| is_on(fault, now)) {
            let FaultKind::Flip(rate) = &mut fault.kind else { continue };
            match rate {
                Rate::Probability(probability) => {
                    for byte in packet.iter_mut() {
                        if random.unit() < *probability {
                            *byte ^= 1 << (random.next_u64() % 8);
                            flipped += 1;
                        }
                    }
                }
                Rate::Next(_) => {
                    if happens(rate, random) {
                        let index = random.next_u64() as usize % packet.len().max(1);
                        if let Some(byte) = packet.get_mut(index) {
                            *byte ^= 1 << (random.next_u64() % 8);
                            flipped += 1;
                        }
                    }
                }
            }
        }
        flipped
    }

    fn on(&self, now: Duration) -> impl Iterator<Item = &Fault> {
        self.faults.iter().filter(move |fault| is_on(fault, now))
    }
}

fn is_on(fault: &Fault, now: Duration) -> bool {
    fault.from <= now && fault.to.is_none_or(|to| now < to)
}

fn is_used_up(fault: &Fault) -> bool {
    matches!(fault.kind, FaultKind::Drop(Rate::Next(0)) | FaultKind::Flip(Rate::Next(0)))
}

fn happens(rate: &mut Rate, random: &mut Random) -> bool {
    match rate {
        Rate::Probability(probability) => random.unit() < *probability,
        Rate::Next(0) => false,
        Rate::Next(count) => {
            *count -= 1;
            true
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn schedule(faults: &[&str]) -> FaultSchedule {
        FaultSchedule::new(faults.iter().map(|text| text.parse().unwrap()).collect(), 1)
    }

    #[test]
    fn a_fault_is_active_in_its_time_only() {
        let schedule = schedule(&["dead-servo:5@3s..6s", "close-port@8s.."]);
        let dead = |ms| schedule.is_dead(Id::new(5).unwrap(), Duration::from_millis(ms));
        assert_eq!([2999, 3000, 5999, 6000].map(dead), [false, true, true, false]);
        assert!(!schedule.is_dead(Id::new(6).unwrap(), Duration::from_secs(4)));
        assert!(
            !schedule.is_port_closed(Duration::from_secs(7))
                && schedule.is_port_closed(Duration::from_secs(9))
        );
    }

    #[test]
    fn the_times_of_an_injected_fault_are_relative_to_the_injection() {
        let mut schedule = schedule(&[]);
        schedule.inject("close-port@1s..2s".parse().unwrap(), Duration::from_secs(10));
        let closed = |s| schedule.is_port_closed(Duration::from_secs(s));
        assert_eq!([1, 10, 11, 12].map(closed), [false, false, true, false]);
    }

    #[test]
    fn a_count_is_used_up() {
        let mut schedule = schedule(&["drop:2x"]);
        let lost: Vec<bool> = (0..4).map(|_| schedule.loses_answer(Duration::ZERO)).collect();
        assert_eq!(lost, [true, true, false, false]);
    }

    #[test]
    fn a_probability_is_approximately_met() {
        let mut schedule = schedule(&["drop:0.25"]);
        let lost = (0..10_000).filter(|_| schedule.loses_answer(Duration::ZERO)).count();
        assert!((2300..2700).contains(&lost), "{lost} of 10000");
    }

    #[test]
    fn one_flip_changes_one_bit_of_one_answer() {
        let mut schedule = schedule(&["flip:1x"]);
        let mut packet = [0_u8; 14];
        assert_eq!(schedule.flip(&mut packet, Duration::ZERO), 1);
        assert_eq!(packet.iter().map(|byte| byte.count_ones()).sum::<u32>(), 1);
        assert_eq!(schedule.flip(&mut packet, Duration::ZERO), 0);
    }
}
