//! Recordings killed at random moments: what readers find and what is lost.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::time::{Duration, Instant};

use downbeat_bags::{
    Compression, McapOptions, Reader, SplitLimits, StorageOptions, StoragePreset, WriterOptions,
};

use crate::interrupted::{BAG, child};
use crate::support::{messages, number, topic, value};

/// The seed, which determines how the child writes.
const SEED: &str = "DOWNBEAT_TEST_SEED";

const FLUSH_INTERVAL: Duration = Duration::from_millis(40);

/// Recordings use SQLite from this seed.
const SQLITE: u64 = 100;

fn options(seed: u64) -> WriterOptions {
    let storage: StorageOptions = match seed % 5 {
        #[cfg(feature = "sqlite")]
        _ if seed >= SQLITE => downbeat_bags::SqliteOptions::default().into(),
        0 => StoragePreset::FastWrite.options().into(),
        1 => StoragePreset::ZstdFast.options().into(),
        2 => McapOptions { compression: Compression::Zstd, ..McapOptions::default() }.into(),
        _ => StorageOptions::default(),
    };
    let chunk_size = [2_000, 20_000, 768 * 1024][(seed / 5 % 3) as usize];
    let split = if seed % 4 == 3 {
        let max_bytes = if seed < SQLITE { 30_000 } else { 100_000 };
        SplitLimits { max_bytes: Some(max_bytes), ..SplitLimits::NONE }
    } else {
        SplitLimits::NONE
    };
    WriterOptions::new().storage(storage).chunk_size(chunk_size).split(split).flush_interval(FLUSH_INTERVAL)
}

/// Prints for each message its number and, by the writer's clock, times before and after it was written.
#[test]
fn child_records_and_says_when() {
    let (Some(bag), Ok(seed)) = (std::env::var_os(BAG), std::env::var(SEED)) else { return };
    let mut writer = options(seed.parse().unwrap()).create(bag).unwrap();
    let id = writer.add_topic(topic("/numbers")).unwrap();
    let start = Instant::now();
    let mut output = std::io::stdout().lock();
    for n in 0.. {
        let before = start.elapsed().as_nanos();
        writer.write(id, n, n, &number(n)).unwrap();
        let after = start.elapsed().as_nanos();
        // Ends when the output is no longer read.
        if writeln!(output, "wrote {n} {before} {after}").and_then(|()| output.flush()).is_err() {
            return;
        }
    }
}

struct Killed {
    /// The readable messages.
    read: Vec<i64>,
    /// The times before and after each message that the child reported as written.
    said: BTreeMap<i64, (u64, u64)>,
}

/// Kills a recording after the child has reported `count` messages.
fn kill_after(seed: u64, count: usize, bag: &Path) -> Killed {
    let mut command = child("killed::child_records_and_says_when", bag, None);
    let mut child = command.env(SEED, seed.to_string()).spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    let mut said = BTreeMap::new();
    let mut note = |line: &str| {
        let Some((_, rest)) = line.split_once("wrote ") else { return };
        let mut numbers = rest.split(' ').map(|number| number.parse::<u64>().ok());
        if let (Some(Some(n)), Some(Some(before)), Some(Some(after))) =
            (numbers.next(), numbers.next(), numbers.next())
        {
            said.insert(n as i64, (before, after));
        }
    };
    for line in lines.by_ref().take(count) {
        note(&line.unwrap());
    }
    child.kill().unwrap(); // SIGKILL
    // The rest of the pipe; the last line may be incomplete.
    lines.map_while(Result::ok).for_each(|line| note(&line));
    child.wait().unwrap();
    let read = messages(&Reader::open(bag).unwrap()).iter().map(value).collect();
    Killed { read, said }
}

#[test]
fn a_recording_killed_at_any_of_50_moments_loses_no_more_than_the_open_chunk() {
    kill_each(0..50);
}

#[cfg(feature = "sqlite")]
#[test]
fn a_recording_in_sqlite_killed_at_any_of_25_moments_loses_no_more_than_the_open_transaction() {
    kill_each(SQLITE..SQLITE + 25);
}

fn kill_each(seeds: std::ops::Range<u64>) {
    let mut state = 20_260_101_u64;
    for seed in seeds {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        let count = 10 + (state >> 33) as usize % 3000;
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let Killed { read, said } = kill_after(seed, count, &bag);
        let kept = read.len() as i64;
        assert_eq!(read, (0..kept).collect::<Vec<_>>(), "seed {seed}: nothing is missing or out of order");
        let Some((last, (before_last, _))) = said.last_key_value() else {
            panic!("seed {seed}: nothing reported")
        };
        // The first lost message opened the chunk that was not written: when the last message arrived, the
        // chunk was younger than the interval, otherwise it would have been written.
        if let Some((_, after_first)) = said.get(&kept) {
            let age = Duration::from_nanos(before_last.saturating_sub(*after_first));
            assert!(age < FLUSH_INTERVAL, "seed {seed}: {kept} read of {last}, {age:?} lost");
        }
    }
}
