//! The fuzz targets on genuine inputs that are changed at random.
//!
//! Each round depends only on its number. `DOWNBEAT_FUZZ_ROUNDS=10000000` sets the number of rounds,
//! `DOWNBEAT_FUZZ_FIRST=1234567` the first round.

mod mutation;
#[path = "../fuzz/targets/mod.rs"]
mod targets;

use std::panic::{AssertUnwindSafe, catch_unwind};

use fuzzing::{Random, most_in, rounds};
use mutation::mutate;

/// Runs a target. Its memory must be a small multiple of its input.
fn run(name: &str, usual: u64) {
    let target = targets::ALL.iter().find(|target| target.name == name).expect("a target of this name");
    let seeds = (target.seeds)();
    for seed in &seeds {
        assert!((target.run)(seed), "a genuine input is refused");
    }
    let (mut understood, mut most) = (0_u64, (0, 0));
    let rounds = rounds(usual);
    for round in rounds.clone() {
        let mut random = Random::new(round);
        let mut input = random.choose(&seeds).clone();
        mutate(&mut input, &mut random);
        let (memory, result) = most_in(|| catch_unwind(AssertUnwindSafe(|| (target.run)(&input))));
        let is_understood = result.unwrap_or_else(|_| panic!("round {round} of {name}: {input:02x?}"));
        understood += u64::from(is_understood);
        // Trees of XML, and texts of errors.
        assert!(memory < 100 * input.len() + 65_536, "round {round} of {name} takes {memory} bytes");
        most = most.max((memory, round));
    }
    println!("{name}: {understood} of {rounds:?} understood; most memory and its round {most:?}");
    assert!(understood > 0, "{name}: no change leaves anything to be understood");
}

macro_rules! targets {
    ($($name:ident: $usual:literal,)*) => {
        $(
            #[test]
            fn $name() {
                run(stringify!($name), $usual);
            }
        )*

        #[test]
        fn no_target_is_left_out() {
            let tested = [$(stringify!($name)),*];
            assert_eq!(targets::ALL.each_ref().map(|target| target.name), tested);
        }
    };
}

targets! {
    certificate: 5000,
    key: 2000,
    revocations: 5000,
    pem: 5000,
    smime: 2000,
    signature: 2000,
    governance: 5000,
    permissions: 5000,
    policy: 5000,
    token: 10_000,
    message: 10_000,
    key_material: 10_000,
    payload: 5000,
    submessage: 5000,
    datagram: 5000,
    handshake: 500,
}
