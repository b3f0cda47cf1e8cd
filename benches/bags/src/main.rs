//! Benchmarks of bags: see `benches/README.md`.

mod checks;
mod messages;
mod readers;
mod robot;
mod writers;

use std::path::PathBuf;

use clap::{Parser, Subcommand};

#[derive(Parser)]
struct Arguments {
    /// Folder in which bags are written and removed again. Defaults to the folder for temporary files.
    #[arg(long, global = true)]
    folder: Option<PathBuf>,
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Record in process: 100 topics at 1 kHz, and four images of 1 MB at 30 Hz, both with zstd_fast.
    Robot {
        /// The duration of each recording, in seconds
        #[arg(long, default_value_t = 20)]
        seconds: u64,
    },
    /// Write the same messages with the writers of this project, of the mcap crate and of Python.
    Writers {
        /// Megabytes written per turn; the Python writers write a tenth of it
        #[arg(long, default_value_t = 400)]
        megabytes: u64,
        /// Number of turns; the best one counts.
        #[arg(long, default_value_t = 5)]
        turns: u32,
    },
    /// Check and repair bags, compared with the bare readers of the mcap crate and of PyPI.
    Checks {
        /// Megabytes of messages in each bag.
        #[arg(long, default_value_t = 400)]
        megabytes: u64,
        /// Number of turns; the best one counts.
        #[arg(long, default_value_t = 3)]
        turns: u32,
    },
    /// Read one topic of a bag with two topics, as bytes and decoded, and compare with rosbags.
    Readers {
        /// Messages on the topic that is read; the other topic has three times as many.
        #[arg(long, default_value_t = 50_000)]
        messages: u32,
        /// Number of turns; the best one counts.
        #[arg(long, default_value_t = 3)]
        turns: u32,
    },
}

fn main() -> anyhow::Result<()> {
    let Arguments { folder, what } = Arguments::parse();
    let folder = match folder {
        Some(folder) => tempfile::tempdir_in(folder)?,
        None => tempfile::tempdir()?,
    };
    match what {
        What::Robot { seconds } => robot::run(folder.path(), seconds),
        What::Writers { megabytes, turns } => writers::run(folder.path(), megabytes * 1_000_000, turns),
        What::Checks { megabytes, turns } => checks::run(folder.path(), megabytes * 1_000_000, turns),
        What::Readers { messages, turns } => readers::run(folder.path(), messages, turns),
    }
}
