//! Runs the fuzz target of `fuzz/` on randomly mutated bags, and on files designed to exhaust memory.
//!
//! Each round depends only on its number. `DOWNBEAT_FUZZ_ROUNDS=10000000` sets the number of rounds,
//! `DOWNBEAT_FUZZ_FIRST=1234567` the first one.

#![allow(clippy::unwrap_used)]

mod bombs;
mod corrupt;
mod odd;
mod parts;
mod seeds;
#[path = "../../fuzz/targets/mod.rs"]
mod targets;

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

use fuzzing::{Random, most_in, rounds};
use parts::Parts;
use seeds::Seed;

/// The memory that reading may use in addition to the length of a bag file: two Zstandard windows of 128 MiB
/// each are allocated at once if a frame declares them.
const MOST_MEMORY: usize = 320 * 1024 * 1024;
/// A round takes a few hundred microseconds, even on a busy machine.
const LONGEST: Duration = Duration::from_secs(20);
/// Real bags take a hundred times as long as ours: this many rounds use one of them.
const RECORDED_ONE_IN: usize = 2000;

#[test]
fn the_reader_of_any_mutated_bag_terminates_in_bounded_memory() {
    let numbers = rounds(1_000);
    let (first, rounds) = (numbers.start, numbers.end - numbers.start);
    let (small, recorded) = (seeds::small(), seeds::recorded());
    let start = Instant::now();
    let (mut most, mut longest) = ((0, first), (Duration::ZERO, first));
    let mut opened = 0;
    for round in numbers {
        let mut random = Random::new(round);
        let seeds = if random.one_in(RECORDED_ONE_IN) { &recorded } else { &small };
        let bytes = changed(random.choose(seeds), &mut random);
        let begun = Instant::now();
        let run = || catch_unwind(AssertUnwindSafe(|| targets::reader::run(&bytes)));
        let (memory, result) = most_in(run);
        let took = begun.elapsed();
        opened += u64::from(*result.as_ref().unwrap_or_else(|_| panic!("round {round}: {bytes:02x?}")));
        assert!(memory < MOST_MEMORY + bytes.len(), "round {round} takes {memory} bytes of memory");
        assert!(took < LONGEST, "round {round} takes {took:?}");
        most = most.max((memory, round));
        longest = longest.max((took, round));
        if (round - first + 1).is_multiple_of(100_000) {
            let (done, seconds) = (round - first + 1, start.elapsed().as_secs());
            println!(
                "{done} changed bags in {seconds} s, {opened} opened; most memory and its round {most:?}, longest {longest:?}"
            );
        }
    }
    // Most mutations leave something readable.
    assert!(opened > rounds / 2, "{opened} of {rounds} were opened");
}

fn changed(seed: &Seed, random: &mut Random) -> Vec<u8> {
    match seed {
        Seed::Text(text) => with_changed_bytes(text, random),
        Seed::File(file) if random.one_in(3) => with_changed_bytes(file, random),
        Seed::File(file) => with_changed_parts(file, random),
        Seed::Packed(packed, _) if random.one_in(3) => with_changed_bytes(packed, random),
        Seed::Packed(_, content) if random.one_in(2) => parts::zstd(&with_changed_bytes(content, random)),
        Seed::Packed(_, content) => parts::zstd(&with_changed_parts(content, random)),
    }
}

fn with_changed_bytes(bytes: &[u8], random: &mut Random) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    corrupt::bytes(&mut bytes, random);
    bytes
}

/// Sometimes also truncates or changes bytes of a file with changed parts.
fn with_changed_parts(file: &[u8], random: &mut Random) -> Vec<u8> {
    let mut parts = Parts::of(file);
    corrupt::parts(&mut parts, random);
    let mut bytes = parts.to_file();
    if random.one_in(5) {
        corrupt::bytes(&mut bytes, random);
    }
    bytes
}
