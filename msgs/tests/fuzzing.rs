//! Runs the corpus of the fuzzers and a few thousand random mutations of it. Longer runs: `fuzz/README.md`.
#![allow(clippy::expect_used, clippy::unwrap_used, missing_docs)]

use std::path::Path;

use fuzzing::Random;

#[path = "../fuzz/targets/mod.rs"]
mod targets;

/// Mutations of each file of the corpus.
const CHANGES: usize = 50;

#[test]
fn no_interface_file_crashes_the_parser() {
    check("interface_files", targets::interface_files::run);
}

#[test]
fn no_idl_file_crashes_the_parser() {
    check("idl_files", targets::idl_files::run);
}

#[test]
fn no_bytes_crash_the_reader_of_a_message() {
    check("cdr", targets::cdr::run);
}

#[test]
fn compiled_and_dynamic_messages_agree_on_any_bytes() {
    check("dynamic", targets::dynamic::run);
}

fn check(target: &str, run: fn(&[u8])) {
    let folder = Path::new("fuzz/corpus").join(target);
    let mut files: Vec<_> = std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert!(!files.is_empty(), "{} is empty", folder.display());
    let mut random = Random::new(0);
    for file in files {
        let seed = std::fs::read(&file).unwrap();
        run(&seed);
        for _ in 0..CHANGES {
            let changed = changed(&seed, &mut random);
            let outcome = std::panic::catch_unwind(|| run(&changed));
            assert!(outcome.is_ok(), "a change of {}: {changed:?}", file.display());
        }
    }
}

/// A copy with one to four bytes changed, removed, inserted or truncated.
fn changed(seed: &[u8], random: &mut Random) -> Vec<u8> {
    const SPECIAL: [u8; 8] = [0, 1, 0x7F, 0x80, 0xFF, b'\n', b'[', b'='];
    let mut bytes = seed.to_vec();
    for _ in 0..=random.below(4) {
        let (place, special) = (random.below(bytes.len()), *random.choose(&SPECIAL));
        match random.below(5) {
            0 if !bytes.is_empty() => bytes[place] = special,
            1 if !bytes.is_empty() => bytes[place] ^= 1 << random.below(8),
            2 if !bytes.is_empty() => drop(bytes.remove(place)),
            3 => bytes.insert(place, special),
            _ => bytes.truncate(place),
        }
    }
    bytes
}
