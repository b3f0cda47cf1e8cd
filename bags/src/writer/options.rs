//! How to record.

use std::collections::BTreeMap;
use std::fmt;
use std::fs;
use std::io;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use super::storage::{Compression, DEFAULT_CHUNK_SIZE};
use super::{StorageOptions, Writer, WriterError};
use crate::storage::Storage;

/// How to record a bag.
///
/// ```
/// use std::time::Duration;
/// use downbeat_bags::{Compression, SplitLimits, WriterOptions};
///
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// # let folder = tempfile::tempdir()?;
/// let writer = WriterOptions::new()
///     .compression(Compression::Zstd)
///     .flush_interval(Duration::from_millis(250))
///     .split(SplitLimits { max_duration: Some(Duration::from_secs(60)), ..SplitLimits::NONE })
///     .custom_data("emulated", "true")
///     .create(folder.path().join("morning_run"))?;
/// assert!(writer.path().join("morning_run_0.mcap").exists());
/// # Ok(())
/// # }
/// ```
#[derive(Clone, Debug)]
pub struct WriterOptions {
    pub(super) storage: StorageOptions,
    /// Stands over that of the storage.
    compression: Option<Compression>,
    pub(super) flush_interval: Duration,
    pub(super) split: SplitLimits,
    pub(super) max_bag_files: Option<NonZeroUsize>,
    pub(super) sync: SyncPolicy,
    pub(super) disk_full: WhenDiskFull,
    pub(super) custom_data: BTreeMap<String, String>,
    pub(super) counted_data: BTreeMap<String, CountedData>,
}

/// What the metadata says that is known only when it is written.
#[derive(Clone)]
pub(super) struct CountedData(pub(super) Arc<dyn Fn() -> String + Send + Sync>);

impl fmt::Debug for CountedData {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("CountedData")
    }
}

/// When a bag goes on in a new file: at the first of these limits that a file reaches.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SplitLimits {
    /// Bytes of a file, those of its open chunk before compression included; `--max-bag-size`. A file is larger by its last
    /// message and its summary, an SQLite file by its index of those.
    pub max_bytes: Option<u64>,
    /// From the first message of a file to its last, by the times at which they were received; `--max-bag-duration`.
    pub max_duration: Option<Duration>,
}

impl SplitLimits {
    /// One file.
    pub const NONE: Self = Self { max_bytes: None, max_duration: None };
    /// The least that rosbag2 takes for `max_bytes` (`get_minimum_split_file_size` of its storages).
    #[must_use]
    pub fn least_bytes(storage: Storage) -> u64 {
        match storage {
            Storage::Mcap => 1024,
            Storage::Sqlite3 => 84 * 1024,
        }
    }
}

/// When to wait until the medium has what was written. A process that is killed loses nothing either way; a machine that loses
/// power loses what its operating system had not written yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SyncPolicy {
    /// Never: when is up to the operating system, as with rosbag2. An SQLite file may then be damaged as a whole.
    Never,
    /// At the end of each file: robots are switched off after a recording. An SQLite file besides when its log is moved into it,
    /// unless its preset is `none`.
    #[default]
    Files,
    /// After each chunk too: no more than that of the open one is lost, and writing is as slow as the medium.
    Chunks,
}

/// What to do when there is no room for a chunk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenDiskFull {
    /// End the file after its last chunk and record no more.
    #[default]
    Stop,
    /// Give the chunk up, count its messages as lost, and go on: there may be room again, where something else deletes or
    /// [`WriterOptions::max_bag_files`] does.
    Drop,
}

impl WriterOptions {
    /// The chunk size of rosbag2 (that of the MCAP C++ library it carries): 768 KiB.
    pub const DEFAULT_CHUNK_SIZE: u64 = DEFAULT_CHUNK_SIZE;
    /// 1 s.
    pub const DEFAULT_FLUSH_INTERVAL: Duration = Duration::from_secs(1);

    /// One file without compression, [`Self::DEFAULT_CHUNK_SIZE`], [`Self::DEFAULT_FLUSH_INTERVAL`], no custom data.
    #[must_use]
    pub fn new() -> Self {
        Self {
            storage: StorageOptions::default(),
            compression: None,
            flush_interval: Self::DEFAULT_FLUSH_INTERVAL,
            split: SplitLimits::NONE,
            max_bag_files: None,
            sync: SyncPolicy::default(),
            disk_full: WhenDiskFull::default(),
            custom_data: BTreeMap::new(),
            counted_data: BTreeMap::new(),
        }
    }

    /// Which storage is written, and how its files are laid out: [`McapOptions`](super::McapOptions) or, with the feature
    /// `sqlite`, `SqliteOptions`.
    #[must_use]
    pub fn storage(self, storage: impl Into<StorageOptions>) -> Self {
        Self { storage: storage.into(), ..self }
    }

    /// How chunks are compressed, whatever the storage says. `sqlite3` compresses nothing.
    #[must_use]
    pub fn compression(self, compression: Compression) -> Self {
        Self { compression: Some(compression), ..self }
    }

    /// The size in bytes, before compression, from which on a chunk is closed.
    #[must_use]
    pub fn chunk_size(mut self, chunk_size: u64) -> Self {
        self.storage.set_chunk_size(chunk_size);
        self
    }

    /// The age at which a chunk is closed though it is not full: what a killed process loses at most.
    #[must_use]
    pub fn flush_interval(self, flush_interval: Duration) -> Self {
        Self { flush_interval, ..self }
    }

    /// When the bag goes on in a new file.
    #[must_use]
    pub fn split(self, split: SplitLimits) -> Self {
        Self { split, ..self }
    }

    /// How many files the bag has at the most: when there would be one more, the oldest is deleted. Its messages are then
    /// no longer counted, and `custom_data` says how many were (`deleted_messages`).
    #[must_use]
    pub fn max_bag_files(self, max_bag_files: NonZeroUsize) -> Self {
        Self { max_bag_files: Some(max_bag_files), ..self }
    }

    /// When to wait until the medium has what was written.
    #[must_use]
    pub fn sync(self, sync: SyncPolicy) -> Self {
        Self { sync, ..self }
    }

    /// What to do when there is no room for a chunk.
    #[must_use]
    pub fn when_disk_full(self, disk_full: WhenDiskFull) -> Self {
        Self { disk_full, ..self }
    }

    /// Adds an entry to the `custom_data` of the metadata.
    #[must_use]
    pub fn custom_data(mut self, key: impl Into<String>, value: impl Into<String>) -> Self {
        self.custom_data.insert(key.into(), value.into());
        self
    }

    /// Notes what `value` returns at the time when the metadata is written: for what is counted while the recording goes on.
    #[must_use]
    pub fn counted_data(
        mut self,
        key: impl Into<String>,
        value: impl Fn() -> String + Send + Sync + 'static,
    ) -> Self {
        self.counted_data.insert(key.into(), CountedData(Arc::new(value)));
        self
    }

    /// Creates the bag directory, the folders above it where they are missing, and the files in it.
    ///
    /// # Errors
    /// If it exists already or cannot be created, files are to be smaller than [`SplitLimits::least_bytes`], or compressed
    /// where the storage does not.
    pub fn create(mut self, directory: impl AsRef<Path>) -> Result<Writer, WriterError> {
        let least = SplitLimits::least_bytes(self.storage.storage());
        if let Some(bytes) = self.split.max_bytes.filter(|bytes| *bytes < least) {
            return Err(WriterError::SplitSize { bytes, least });
        }
        match (self.compression, self.storage.mcap_mut()) {
            (None, _) | (Some(Compression::None), Err(_)) => {}
            (Some(compression), Ok(mcap)) => mcap.compression = compression,
            (Some(_), Err(error)) => return Err(error.into()),
        }
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
