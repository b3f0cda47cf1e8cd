//! Every command on damaged bags: it exits with 0 only if its result is whole.
//!
//! Each mutation depends only on the bag and its number. `DOWNBEAT_BAG_MUTATIONS=500` sets how many there are
//! of each bag and includes the large bags; `cargo xtask bags` does that.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use std::time::{Duration, Instant};

use common::{output_of, python};
use downbeat::bags::{Player, PlayerOptions, Rate, Reader, Step};
use fuzzing::Random;

/// A recorded bag, and a field to plot.
struct Recorded {
    path: &'static str,
    field: &'static str,
    is_large: bool,
    /// The numbers of mutations that once made a command exit with 0 without a whole result.
    found: &'static [usize],
}

const BAGS: [Recorded; 7] = [
    Recorded {
        path: "examples/own_device/tests/recorded_run",
        field: "range:range",
        is_large: false,
        found: &[273],
    },
    Recorded {
        path: "program/src/new/templates/robot/tests/field_run",
        field: "imu/data_raw:angular_velocity",
        is_large: false,
        found: &[],
    },
    Recorded {
        path: "bags/tests/data/jazzy_mcap_zstd",
        field: "reference/joint_states:position",
        is_large: false,
        found: &[141, 328],
    },
    Recorded {
        path: "bags/tests/data/jazzy_mcap",
        field: "reference/joint_states:position",
        is_large: false,
        found: &[63],
    },
    Recorded {
        path: "bags/tests/data/rosbags_rs/test_bag_mcap",
        field: "test/geometry_msgs/accel:linear",
        is_large: false,
        found: &[91, 450],
    },
    Recorded {
        path: "bags/recordings/darwin_op_walk_simulated",
        field: "joint_states:position",
        is_large: true,
        found: &[],
    },
    Recorded {
        path: "bags/recordings/darwin_op_emulated",
        field: "joint_states:position",
        is_large: true,
        found: &[],
    },
];

const USUAL: usize = 4;
/// No command takes longer, even on a busy machine.
const LONGEST: Duration = Duration::from_secs(60);

#[test]
fn commands_on_a_damaged_bag_exit_with_0_only_if_their_result_is_whole() {
    let wanted = std::env::var("DOWNBEAT_BAG_MUTATIONS").ok().map(|count| count.parse().unwrap());
    let count = wanted.unwrap_or(USUAL);
    let mut failures = Vec::new();
    for (bag, seed) in BAGS.iter().zip(1..).filter(|(bag, _)| wanted.is_some() || !bag.is_large) {
        let begun = Instant::now();
        let mut tally = Tally::default();
        let original = Path::new(env!("CARGO_MANIFEST_DIR")).join(bag.path);
        let expected = Reader::open(&original).unwrap().message_count();
        let folder = tempfile::tempdir().unwrap();
        let results = folder.path().join("results");
        fs::create_dir(&results).unwrap();
        let others = bag.found.iter().copied().filter(|number| *number >= count);
        let numbers: Vec<_> = (0..count).chain(others).collect();
        for (done, &number) in numbers.iter().enumerate() {
            let mut random = Random::new(seed << 32 | number as u64);
            let mut trial = Trial {
                bag,
                expected,
                folder: folder.path(),
                number,
                failures: Vec::new(),
                tally: &mut tally,
            };
            let what = trial.damage(&original, &mut random);
            trial.run();
            failures.extend(
                trial.failures.iter().map(|failure| format!("{} {number} ({what}): {failure}", bag.path)),
            );
            if done % 50 == 49 || done + 1 == numbers.len() {
                failures.extend(read_elsewhere(&results).err());
                fs::remove_dir_all(&results).unwrap();
                fs::create_dir(&results).unwrap();
            }
        }
        println!("{}: {count} mutations in {:.0?}; {tally:?}", bag.path, begun.elapsed());
    }
    assert!(failures.is_empty(), "{} failures:\n{}", failures.len(), failures.join("\n"));
}

/// The number of commands that exited with 0, and of messages that `repair` recovered.
#[derive(Debug, Default)]
struct Tally {
    check: usize,
    repair: usize,
    convert: usize,
    cut: usize,
    export: usize,
    plot: usize,
    play: usize,
    repaired_messages: u64,
}

struct Trial<'a> {
    bag: &'a Recorded,
    expected: u64,
    folder: &'a Path,
    number: usize,
    failures: Vec<String>,
    tally: &'a mut Tally,
}

impl Trial<'_> {
    fn path(&self, name: &str) -> PathBuf {
        self.folder.join(name)
    }

    /// Copies the bag with one damage, and describes it.
    fn damage(&self, original: &Path, random: &mut Random) -> String {
        let damaged = self.path("damaged");
        let _ = fs::remove_dir_all(&damaged);
        fs::create_dir(&damaged).unwrap();
        let is_metadata = random.one_in(10);
        let mut what = String::new();
        for entry in fs::read_dir(original).unwrap() {
            let entry = entry.unwrap();
            let mut bytes = fs::read(entry.path()).unwrap();
            if (entry.file_name() == "metadata.yaml") == is_metadata {
                what = format!("{} in {}", mutate(&mut bytes, random), entry.file_name().display());
            }
            fs::write(damaged.join(entry.file_name()), bytes).unwrap();
        }
        what
    }

    fn run(&mut self) {
        let damaged = self.path("damaged");
        let is_sound = self.succeeds(&["bag", "check", text(&damaged)]);
        self.tally.check += usize::from(is_sound);
        for command in ["repair", "convert", "cut"] {
            let result = self.folder.join("results").join(format!("{command}_{}", self.number));
            let mut arguments = vec!["bag", command, text(&damaged), "--output", text(&result)];
            let compression = ["none", "lz4", "zstd"][self.number % 3];
            arguments.extend(["--compression", compression]);
            if command == "cut" {
                arguments.extend(["--from", "0s"]);
            }
            if !self.succeeds(&arguments) {
                if command == "repair" {
                    self.tally.repaired_messages +=
                        Reader::open(&result).map_or(0, |bag| bag.message_count());
                }
                let _ = fs::remove_dir_all(&result);
                continue;
            }
            match command {
                "repair" => self.tally.repair += 1,
                "convert" => self.tally.convert += 1,
                _ => self.tally.cut += 1,
            }
            let checked = output_of(&["bag", "check", text(&result)]);
            if !checked.status.success() {
                self.failures.push(format!("the result of {command} has problems: {}", said(&checked)));
            }
            let messages = Reader::open(&result).map_or(0, |bag| bag.message_count());
            if command == "repair" {
                self.tally.repaired_messages += messages;
                if messages == 0 {
                    self.failures.push("repair carried over nothing".to_owned());
                }
            } else if messages != self.expected {
                self.failures.push(format!("{command} wrote {messages} of {} messages", self.expected));
            }
        }
        let tables = self.path("tables");
        let _ = fs::remove_dir_all(&tables);
        if self.succeeds(&["bag", "export", text(&damaged), "--format", "jsonl", "--output", text(&tables)]) {
            self.tally.export += 1;
            let files = fs::read_dir(&tables).unwrap().map(|file| fs::read(file.unwrap().path()).unwrap());
            let lines: usize = files.map(|text| text.iter().filter(|byte| **byte == b'\n').count()).sum();
            if lines as u64 != self.expected {
                self.failures.push(format!("export wrote {lines} of {} messages", self.expected));
            }
        }
        let picture = self.path("plot.svg");
        let field = self.bag.field;
        if !field.is_empty()
            && self.succeeds(&["bag", "plot", text(&damaged), field, "--force", "--output", text(&picture)])
        {
            self.tally.plot += 1;
        }
        if let Ok(bag) = Reader::open(&damaged) {
            self.play(&[bag]);
        }
    }

    /// Plays without a network, as fast as possible.
    fn play(&mut self, bags: &[Reader]) {
        let options =
            PlayerOptions { rate: Rate::new(1e9).unwrap(), skips_gaps: true, ..PlayerOptions::default() };
        let Ok(mut player) = Player::open(bags, &options, |_| true) else { return };
        let (mut now, mut played, mut failed) = (Duration::ZERO, 0, 0);
        loop {
            match player.step(now) {
                Step::Due(_) => played += 1,
                Step::Wait(wait) => now += wait,
                Step::Failed(_) => failed += 1,
                Step::Skipped(_) => {}
                Step::Paused | Step::Repeats | Step::Finished => break,
            }
        }
        let is_told = failed > 0 || bags[0].truncation().count() > 0 || bags[0].oddities().len() > 0;
        let declared = bags[0].metadata().map_or(0, |metadata| metadata.message_count);
        if is_told || played < declared {
            return;
        }
        self.tally.play += 1;
        if played != self.expected {
            self.failures.push(format!("played {played} of {} messages in silence", self.expected));
        }
    }

    fn succeeds(&mut self, arguments: &[&str]) -> bool {
        let begun = Instant::now();
        let output = output_of(arguments);
        if begun.elapsed() > LONGEST {
            self.failures.push(format!("{arguments:?} took {:?}", begun.elapsed()));
        }
        if output.status.code().is_none_or(|code| code > 1) || said(&output).contains("panicked") {
            self.failures.push(format!("{arguments:?}: {:?} {}", output.status, said(&output)));
        }
        output.status.success()
    }
}

fn mutate(bytes: &mut Vec<u8>, random: &mut Random) -> String {
    let at = random.below(bytes.len().max(1));
    let length = (1 + random.below(300)).min(bytes.len() - at);
    match random.below(10) {
        0 => {
            bytes.truncate(at);
            format!("truncated to {at}")
        }
        1 => {
            bytes.drain(at..at + length);
            format!("{length} bytes removed at {at}")
        }
        2 => {
            let stretch = bytes[at..at + length].to_vec();
            bytes.splice(at..at, stretch);
            format!("{length} bytes doubled at {at}")
        }
        3 => {
            bytes[at..at + length].fill(0);
            format!("{length} zeros at {at}")
        }
        4 => {
            bytes[at..at + length].fill_with(|| random.bits() as u8);
            format!("{length} random bytes at {at}")
        }
        _ => {
            let bit = random.below(8);
            bytes[at] ^= 1 << bit;
            format!("bit {bit} of byte {at}")
        }
    }
}

/// Reads the results with `mcap` of PyPI, if there is a Python.
fn read_elsewhere(results: &Path) -> Result<(), String> {
    let Some(counts) = python("read_bags.py", &[results]) else { return Ok(()) };
    for (bag, count) in counts.as_object().unwrap() {
        let ours = Reader::open(results.join(bag)).unwrap().message_count();
        if count.as_u64() != Some(ours) {
            return Err(format!("mcap reads {count} messages from {bag}, not {ours}"));
        }
    }
    Ok(())
}

fn said(output: &Output) -> String {
    format!("{}{}", String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr))
}

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}
