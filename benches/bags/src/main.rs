//! What bags cost: see `benches/README.md`.

mod readers;
mod robot;
mod writers;

use std::path::PathBuf;

use clap::{Parser, Subcommand};

#[derive(Parser)]
struct Arguments {
    /// Where bags are written and removed again; the folder of temporary files unless given.
    #[arg(long, global = true)]
    folder: Option<PathBuf>,
    #[command(subcommand)]
    what: What,
}

#[derive(Subcommand)]
enum What {
    /// Record in process: 100 topics at 1 kHz, and four images of 1 MB at 30 Hz, both with zstd_fast.
    Robot {
        /// How long each recording is, in seconds.
        #[arg(long, default_value_t = 20)]
        seconds: u64,
    },
    /// Write the same messages with this project's writer, the mcap crate's, and those of Python.
    Writers {
        /// Megabytes of each turn; Python has a tenth.
        #[arg(long, default_value_t = 400)]
        megabytes: u64,
        /// The best of so many turns counts.
        #[arg(long, default_value_t = 5)]
        turns: u32,
    },
    /// Read one topic of a bag with two, as bytes and decoded, beside rosbags.
    Readers {
        /// Messages of the topic; the other topic has three times as many.
        #[arg(long, default_value_t = 50_000)]
        messages: u32,
        /// The best of so many turns counts.
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
        What::Readers { messages, turns } => readers::run(folder.path(), messages, turns),
    }
}
