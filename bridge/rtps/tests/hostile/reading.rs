//! The fuzz target `wire` on recorded datagrams that are changed at random.
//!
//! Each round depends only on its number. `DOWNBEAT_FUZZ_ROUNDS=10000000` sets the number of rounds,
//! `DOWNBEAT_FUZZ_FIRST=1234567` the first round.

use std::panic::{AssertUnwindSafe, catch_unwind};

use fuzzing::{Random, most_in, rounds};

use crate::mutation::mutate;
use crate::{capture, targets};

#[test]
fn changed_datagrams_are_read_to_their_end_in_bounded_memory() {
    let seeds = [capture::fast_dds(), capture::cyclone_dds()].concat();
    let (mut understood, mut most) = (0, (0, 0));
    let rounds = rounds(50_000);
    for round in rounds.clone() {
        let mut random = Random::new(round);
        let mut datagram = random.choose(&seeds).to_vec();
        mutate(&mut datagram, &mut random);
        let run = || catch_unwind(AssertUnwindSafe(|| targets::wire::run(&datagram)));
        let (memory, result) = most_in(run);
        understood += usize::from(result.unwrap_or_else(|_| panic!("round {round}: {datagram:02x?}")) > 0);
        // The parsed values and the datagram written again.
        assert!(memory < 4 * datagram.len() + 4096, "round {round} takes {memory} bytes of memory");
        most = most.max((memory, round));
    }
    println!("{understood} of {rounds:?} understood; most memory and its round {most:?}");
    assert!(understood as u64 > (rounds.end - rounds.start) / 2, "most changes leave something to be read");
}

#[test]
fn random_bytes_are_read_to_their_end() {
    for round in rounds(50_000) {
        let mut random = Random::new(round);
        let mut datagram = b"RTPS\x02\x03\x01\x0f".to_vec();
        datagram.extend((0..random.below(300)).map(|_| random.bits() as u8));
        // Payloads with random parameters after a valid encapsulation are read as well.
        if random.one_in(2) && datagram.len() > 48 {
            datagram[20..24].copy_from_slice(&[0x15, 0x05, 0, 0]);
            datagram[26..28].copy_from_slice(&[16, 0]);
            datagram[36..48].copy_from_slice(&[0, 0, 0, 0, 1, 0, 0, 0, 0, 3, 0, 0]);
        }
        assert!(catch_unwind(|| targets::wire::run(&datagram)).is_ok(), "round {round}: {datagram:02x?}");
    }
}
