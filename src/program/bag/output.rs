//! The bag that a command makes.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use downbeat::bags::{Compression, Copied, Copy, WriterOptions};

use super::progress::Progress;

/// How a new bag is written.
#[derive(Args)]
pub(crate) struct OutputArguments {
    /// The new rosbag2 directory.
    #[arg(long, short, value_name = "DIR")]
    pub(crate) output: PathBuf,
    /// How its chunks are compressed.
    #[arg(long, value_enum, default_value_t = CompressionChoice::None)]
    pub(crate) compression: CompressionChoice,
}

#[derive(Clone, Copy, ValueEnum)]
pub(crate) enum CompressionChoice {
    /// Not at all.
    None,
    /// With Zstandard.
    Zstd,
}

impl CompressionChoice {
    fn compression(self) -> Compression {
        match self {
            Self::None => Compression::None,
            Self::Zstd => Compression::Zstd,
        }
    }
}

/// Writes the copy into a new bag, with what the bags noted of themselves, and tells what is in it.
pub(crate) fn write(
    copy: Copy<'_>,
    custom_data: impl Iterator<Item = (String, String)>,
    directory: &Path,
    compression: CompressionChoice,
) -> anyhow::Result<Copied> {
    let options = WriterOptions::new().compression(compression.compression());
    let options = custom_data.fold(options, |options, (key, value)| options.custom_data(key, value));
    let mut progress = Progress::new("writing", copy.message_count());
    let copied = copy.into_writer(options.create(directory)?, |written| progress.at(written))?;
    drop(progress);
    for error in &copied.unreadable {
        tracing::warn!("{error}");
    }
    let summary = &copied.summary;
    println!("wrote {} messages into {}", summary.message_count(), summary.path.display());
    Ok(copied)
}
