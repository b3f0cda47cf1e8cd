//! A short run of the fuzz target on bags of the real recorder that are changed at random.

use std::fs;

#[path = "../../fuzz/targets/mod.rs"]
mod targets;

use crate::support::fixture;

/// Numerical Recipes' linear congruential generator; the upper bits are good enough here.
struct Random(u64);

impl Random {
    fn below(&mut self, limit: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as usize % limit.max(1)
    }
}

/// Changes some bytes, lengths and stretches.
fn corrupt(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..=random.below(4) {
        let at = random.below(bytes.len());
        match random.below(6) {
            0 => bytes[at] ^= 1 << random.below(8),
            1 => bytes[at] = [0, 1, 0x7f, 0x80, 0xff][random.below(5)],
            2 => bytes.truncate(at.max(9)),
            3 => {
                let value = [0, 1, u64::from(u32::MAX), u64::MAX, bytes.len() as u64][random.below(5)];
                for (byte, new) in bytes[at..].iter_mut().zip(value.to_le_bytes()) {
                    *byte = new;
                }
            }
            4 => {
                let length = random.below(200).min(bytes.len() - at);
                bytes.drain(at..at + length);
            }
            _ => {
                let from = random.below(bytes.len());
                let length = random.below(200).min(bytes.len() - from);
                let stretch = bytes[from..from + length].to_vec();
                bytes.splice(at..at, stretch);
            }
        }
        if bytes.len() < 9 {
            return;
        }
    }
}

#[test]
fn whatever_is_changed_in_a_bag_the_reader_comes_to_an_end() {
    let rounds = std::env::var("DOWNBEAT_FUZZ_ROUNDS").ok().and_then(|rounds| rounds.parse().ok());
    let rounds: usize = rounds.unwrap_or(400);
    let of = |name: &str, file: &str| fs::read(fixture(name).join(file)).unwrap();
    let bags = [
        of("jazzy_mcap_zstd", "jazzy_mcap_zstd_0.mcap"),
        of("jazzy_mcap", "jazzy_mcap_0.mcap"),
        of("jazzy_mcap", "metadata.yaml"),
    ];
    let mut random = Random(20_261_121);
    for round in 0..rounds {
        let mut bytes = bags[round % bags.len()].clone();
        corrupt(&mut bytes, &mut random);
        targets::reader::run(&bytes);
        if round % 1_000_000 == 999_999 {
            println!("{} changed bags were read", round + 1);
        }
    }
}
