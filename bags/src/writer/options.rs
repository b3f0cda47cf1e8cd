//! How to record.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;
use std::time::Duration;

use super::{Writer, WriterError};

/// Whether chunks are compressed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Compression {
    /// They are not: least work while recording. What rosbag2 does unless told otherwise.
    #[default]
    None,
    /// With Zstandard at the fastest level, as rosbag2's preset `zstd_fast`. The compressor is slower than the one in C
    /// (see README.md), and works when a chunk is handed over: record with [`Recording`](crate::Recording) where the
    /// thread must not wait for a full chunk.
    Zstd,
}

/// How to record a bag.
///
/// ```
/// use std::time::Duration;
/// use downbeat_bags::{Compression, WriterOptions};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let folder = tempfile::tempdir()?;
/// let writer = WriterOptions::new()
///     .compression(Compression::Zstd)
///     .flush_interval(Duration::from_millis(250))
///     .custom_data("emulated", "true")
///     .create(folder.path().join("morning_run"))?;
/// assert!(writer.path().join("morning_run_0.mcap").exists());
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct WriterOptions {
    pub(super) compression: Compression,
    pub(super) chunk_size: u64,
    pub(super) flush_interval: Duration,
    pub(super) custom_data: BTreeMap<String, String>,
}

impl WriterOptions {
    /// The chunk size of rosbag2 (that of the MCAP C++ library it carries): 768 KiB.
    pub const DEFAULT_CHUNK_SIZE: u64 = 768 * 1024;
    /// 1 s.
    pub const DEFAULT_FLUSH_INTERVAL: Duration = Duration::from_secs(1);

    /// No compression, [`Self::DEFAULT_CHUNK_SIZE`], [`Self::DEFAULT_FLUSH_INTERVAL`], no custom data.
    #[must_use]
    pub fn new() -> Self {
        Self {
            compression: Compression::None,
            chunk_size: Self::DEFAULT_CHUNK_SIZE,
            flush_interval: Self::DEFAULT_FLUSH_INTERVAL,
            custom_data: BTreeMap::new(),
        }
    }

    /// Whether chunks are compressed.
    #[must_use]
    pub fn compression(self, compression: Compression) -> Self {
        Self { compression, ..self }
    }

    /// The size in bytes, before compression, from which on a chunk is closed.
    #[must_use]
    pub fn chunk_size(self, chunk_size: u64) -> Self {
        Self { chunk_size, ..self }
    }

    /// The age at which a chunk is closed though it is not full: what a killed process loses at most.
    #[must_use]
    pub fn flush_interval(self, flush_interval: Duration) -> Self {
        Self { flush_interval, ..self }
    }

    /// Adds an entry to the `custom_data` of the metadata.
    #[must_use]
    pub fn custom_data(mut self, key: impl Into<String>, value: impl Into<String>) -> Self {
        self.custom_data.insert(key.into(), value.into());
        self
    }

    /// Creates the bag directory, the folders above it where they are missing, and the files in it.
    ///
    /// # Errors
    /// If it exists already, or cannot be created.
    pub fn create(self, directory: impl AsRef<Path>) -> Result<Writer, WriterError> {
        Writer::create(directory.as_ref(), self)
    }
}

impl Default for WriterOptions {
    fn default() -> Self {
        Self::new()
    }
}

pub(super) fn create_directory(directory: &Path) -> Result<(), WriterError> {
    let create = || -> io::Result<()> {
        if let Some(parent) = directory.parent() {
            fs::create_dir_all(parent)?;
        }
        // Not create_dir_all: creating must fail if the directory is there, whoever was faster.
        fs::create_dir(directory)
    };
    create().map_err(|source| {
        let path = directory.to_owned();
        if source.kind() == io::ErrorKind::AlreadyExists && directory.exists() {
            WriterError::AlreadyExists { path }
        } else {
            WriterError::Create { path, source }
        }
    })
}
