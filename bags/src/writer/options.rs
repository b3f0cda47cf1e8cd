//! Options of writing a bag.

use std::collections::BTreeMap;
use std::num::NonZeroUsize;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;
use std::{fmt, fs, io};

use super::free_space::{WhenLow, free_bytes};
use super::storage::{Compression, DEFAULT_CHUNK_SIZE};
use super::sync::SyncPolicy;
use super::{StorageOptions, Writer, WriterError};
use crate::storage::Storage;

/// Options of writing a bag.
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
    /// The storage, and the layout of its files: [`McapOptions`](super::McapOptions) or, with the feature
    /// `sqlite`, `SqliteOptions`.
    pub storage: StorageOptions,
    /// Overrides that of the storage.
    compression: Option<Compression>,
    /// The age at which a chunk is closed even if it is not full: the most that a killed process loses.
    pub flush_interval: Duration,
    /// When the bag continues in a new file.
    pub split: SplitLimits,
    /// The maximum number of files: when it is exceeded, the oldest file is deleted. Its messages are no
    /// longer counted, but `custom_data` contains their number (`deleted_messages`).
    pub max_bag_files: Option<NonZeroUsize>,
    /// When to sync written data to disk.
    pub sync: SyncPolicy,
    /// What to do if the disk is full.
    pub disk_full: WhenDiskFull,
    /// How many bytes of the disk stay free for others: checked after each chunk. 0 for no check.
    pub keep_free: u64,
    /// What to do if less is free.
    pub when_low: WhenLow,
    /// Whether each further file of a bag in MCAP begins with the last messages of latched (transient local)
    /// topics, which a subscriber joining then would receive. [`Reader::messages`](crate::Reader::messages)
    /// leaves these copies out. `sqlite3` has no place for their publish times and repeats nothing.
    pub repeats_latched: bool,
    /// The version of the metadata: [`FORMAT_VERSION`](crate::metadata::FORMAT_VERSION), or
    /// [`HUMBLE_VERSION`](crate::metadata::HUMBLE_VERSION) for bags that ROS 2 Humble shall read.
    pub metadata_version: u32,
    /// The distribution of ROS 2 that the metadata names.
    pub(super) ros_distro: String,
    pub(super) custom_data: BTreeMap<String, String>,
    pub(super) counted_data: BTreeMap<String, CountedData>,
}

/// A metadata entry computed when the metadata is written.
#[derive(Clone)]
pub(super) struct CountedData(pub(super) Arc<dyn Fn() -> String + Send + Sync>);

impl fmt::Debug for CountedData {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("CountedData")
    }
}

/// When a bag continues in a new file: when a file reaches one of these limits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SplitLimits {
    /// Size of a file, including its uncompressed open chunk; `--max-bag-size`. The file is larger by its
    /// last message and its summary, or its index in SQLite.
    pub max_bytes: Option<u64>,
    /// From the first message of a file to its last, by receive time; `--max-bag-duration`.
    pub max_duration: Option<Duration>,
}

impl SplitLimits {
    /// A single file.
    pub const NONE: Self = Self { max_bytes: None, max_duration: None };
    /// rosbag2's minimum of `max_bytes` (`get_minimum_split_file_size` of its storages).
    #[must_use]
    pub fn least_bytes(storage: Storage) -> u64 {
        match storage {
            Storage::Mcap => 1024,
            Storage::Sqlite3 => 84 * 1024,
        }
    }
}

/// What to do if the disk is full.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum WhenDiskFull {
    /// Finish the file after its last chunk and stop recording.
    #[default]
    Stop,
    /// Drop the chunk, count its messages as lost, and continue: there may be room again if files are
    /// deleted, for example by [`WriterOptions::max_bag_files`].
    Drop,
}

impl WriterOptions {
    /// The chunk size of rosbag2 (that of the MCAP C++ library it carries): 768 KiB.
    pub const DEFAULT_CHUNK_SIZE: u64 = DEFAULT_CHUNK_SIZE;
    /// 1 s.
    pub const DEFAULT_FLUSH_INTERVAL: Duration = Duration::from_secs(1);

    /// One file without compression, [`Self::DEFAULT_CHUNK_SIZE`], [`Self::DEFAULT_FLUSH_INTERVAL`], no
    /// custom data.
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
            keep_free: 0,
            when_low: WhenLow::default(),
            repeats_latched: false,
            metadata_version: crate::metadata::FORMAT_VERSION,
            ros_distro: crate::metadata::ros_distro(),
            custom_data: BTreeMap::new(),
            counted_data: BTreeMap::new(),
        }
    }

    /// Sets [`Self::storage`].
    #[must_use]
    pub fn storage(self, storage: impl Into<StorageOptions>) -> Self {
        Self { storage: storage.into(), ..self }
    }

    /// How chunks are compressed, overriding the storage options. `sqlite3` does not support compression.
    #[must_use]
    pub fn compression(self, compression: Compression) -> Self {
        Self { compression: Some(compression), ..self }
    }

    /// The size in bytes, before compression, at which a chunk is closed.
    #[must_use]
    pub fn chunk_size(mut self, chunk_size: u64) -> Self {
        self.storage.set_chunk_size(chunk_size);
        self
    }

    /// Sets [`Self::flush_interval`].
    #[must_use]
    pub fn flush_interval(self, flush_interval: Duration) -> Self {
        Self { flush_interval, ..self }
    }

    /// Sets [`Self::split`].
    #[must_use]
    pub fn split(self, split: SplitLimits) -> Self {
        Self { split, ..self }
    }

    /// Sets [`Self::max_bag_files`].
    #[must_use]
    pub fn max_bag_files(self, max_bag_files: NonZeroUsize) -> Self {
        Self { max_bag_files: Some(max_bag_files), ..self }
    }

    /// Sets [`Self::sync`].
    #[must_use]
    pub fn sync(self, sync: SyncPolicy) -> Self {
        Self { sync, ..self }
    }

    /// Sets [`Self::disk_full`].
    #[must_use]
    pub fn when_disk_full(self, disk_full: WhenDiskFull) -> Self {
        Self { disk_full, ..self }
    }

    /// Sets [`Self::keep_free`] and [`Self::when_low`].
    #[must_use]
    pub fn keep_free(self, keep_free: u64, when_low: WhenLow) -> Self {
        Self { keep_free, when_low, ..self }
    }

    /// Sets [`Self::repeats_latched`].
    #[must_use]
    pub fn repeat_latched(self) -> Self {
        Self { repeats_latched: true, ..self }
    }

    /// Sets [`Self::metadata_version`].
    #[must_use]
    pub fn metadata_version(self, metadata_version: u32) -> Self {
        Self { metadata_version, ..self }
    }

    /// The distribution of ROS 2 that the metadata names instead of [that of the environment]: for copies of
    /// bags of another.
    ///
    /// [that of the environment]: crate::metadata::ros_distro()
    #[must_use]
    pub fn ros_distro(self, ros_distro: impl Into<String>) -> Self {
        Self { ros_distro: ros_distro.into(), ..self }
    }

    /// Adds an entry to the `custom_data` of the metadata.
    #[must_use]
    pub fn custom_data(mut self, key: impl Into<String>, value: impl Into<String>) -> Self {
        self.custom_data.insert(key.into(), value.into());
        self
    }

    /// Adds an entry whose value is computed whenever the metadata is written, for example a count.
    #[must_use]
    pub fn counted_data(
        mut self,
        key: impl Into<String>,
        value: impl Fn() -> String + Send + Sync + 'static,
    ) -> Self {
        self.counted_data.insert(key.into(), CountedData(Arc::new(value)));
        self
    }

    /// Creates the bag directory, missing parent directories, and the files in it.
    ///
    /// # Errors
    /// Returns an error if it exists already or cannot be created, the maximum file size is below
    /// [`SplitLimits::least_bytes`], the storage does not support the compression, or space shall stay free
    /// ([`Self::keep_free`]) and either the system does not tell how much is free, or the oldest files shall
    /// be deleted of a bag that is never split.
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
        let directory = directory.as_ref();
        if self.keep_free > 0 {
            if self.when_low == WhenLow::DropOldest && self.split == SplitLimits::NONE {
                return Err(WriterError::NothingToDrop { path: directory.to_owned() });
            }
            let existing = directory.ancestors().find(|path| path.is_dir()).unwrap_or(Path::new("."));
            let failed = |source| WriterError::Create { path: directory.to_owned(), source };
            free_bytes(existing).map_err(failed)?;
        }
        Writer::create(directory, self)
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
        // Not create_dir_all: this must fail if the directory exists, even in a race.
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
