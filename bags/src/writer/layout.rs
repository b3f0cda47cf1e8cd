//! The layout of the files of a bag, for either storage.

use std::path::Path;

#[cfg(feature = "sqlite")]
use super::sqlite::{SqliteOptions, SqlitePreset};
use super::storage::{McapOptions, StorageConfigError, StoragePreset};
use crate::storage::Storage;

/// The layout of the files of a bag.
///
/// ```
/// use downbeat_bags::{Storage, StorageOptions, StoragePreset};
///
/// let storage = StorageOptions::preset(Storage::Mcap, "zstd_fast")?;
/// assert_eq!(storage, StoragePreset::ZstdFast.options().into());
///
/// let error = StorageOptions::preset(Storage::Mcap, "resilient").unwrap_err();
/// assert_eq!(
///     error.to_string(),
///     "unknown preset profile \"resilient\" of the storage mcap; available are none, fastwrite, zstd_fast, zstd_small"
/// );
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StorageOptions {
    /// MCAP files.
    Mcap(McapOptions),
    /// SQLite files.
    #[cfg(feature = "sqlite")]
    Sqlite(SqliteOptions),
}

/// Why storage options are not supported.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum StorageError {
    /// The feature `sqlite` is missing.
    #[error(
        "this program writes no storage sqlite3, it is built without \"sqlite\": build with --features sqlite, which needs a C compiler"
    )]
    NotBuilt,
    /// The storage has no such preset.
    #[error("unknown preset profile \"{preset}\" of the storage {storage}; available are {}", storage.presets().join(", "))]
    Preset {
        /// The storage.
        storage: Storage,
        /// The unknown preset.
        preset: String,
    },
    /// Only MCAP compresses chunks.
    #[error("the storage sqlite3 does not support compression: omit it, or use the storage mcap")]
    Compression,
}

impl Storage {
    /// Its preset profiles, by their names in rosbag2: `--storage-preset-profile`.
    #[must_use]
    pub fn presets(self) -> &'static [&'static str] {
        match self {
            Self::Mcap => &["none", "fastwrite", "zstd_fast", "zstd_small"],
            Self::Sqlite3 => &["none", "resilient"],
        }
    }
}

impl StorageOptions {
    /// The default options of a storage.
    ///
    /// # Errors
    /// Returns an error if the build does not support it.
    pub fn of(storage: Storage) -> Result<Self, StorageError> {
        match storage {
            Storage::Mcap => Ok(McapOptions::default().into()),
            #[cfg(feature = "sqlite")]
            Storage::Sqlite3 => Ok(SqliteOptions::default().into()),
            #[cfg(not(feature = "sqlite"))]
            Storage::Sqlite3 => Err(StorageError::NotBuilt),
        }
    }

    /// The options of a preset profile.
    ///
    /// # Errors
    /// Returns an error if the storage has no such preset, or the build does not support the storage.
    pub fn preset(storage: Storage, name: &str) -> Result<Self, StorageError> {
        let found: Option<Self> = match storage {
            Storage::Mcap => named(&StoragePreset::ALL, name).map(|preset| preset.options().into()),
            #[cfg(feature = "sqlite")]
            Storage::Sqlite3 => named(&SqlitePreset::ALL, name).map(|preset| preset.options().into()),
            #[cfg(not(feature = "sqlite"))]
            Storage::Sqlite3 => return Err(StorageError::NotBuilt),
        };
        found.ok_or_else(|| StorageError::Preset { storage, preset: name.to_owned() })
    }

    /// Overrides these options with those of a storage config file: `--storage-config-file`.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, or rosbag2 would not accept it.
    pub fn with_config_file(self, path: &Path) -> Result<Self, StorageConfigError> {
        match self {
            Self::Mcap(options) => options.with_config_file(path).map(Self::Mcap),
            #[cfg(feature = "sqlite")]
            Self::Sqlite(options) => options.with_config_file(path).map(Self::Sqlite),
        }
    }

    /// The storage.
    #[must_use]
    pub fn storage(&self) -> Storage {
        match self {
            Self::Mcap(_) => Storage::Mcap,
            #[cfg(feature = "sqlite")]
            Self::Sqlite(_) => Storage::Sqlite3,
        }
    }

    /// The options of MCAP files, including compression.
    ///
    /// # Errors
    /// Returns an error if the storage does not support compression.
    pub fn mcap_mut(&mut self) -> Result<&mut McapOptions, StorageError> {
        match self {
            Self::Mcap(options) => Ok(options),
            #[cfg(feature = "sqlite")]
            Self::Sqlite(_) => Err(StorageError::Compression),
        }
    }

    /// The size in bytes, before compression, at which a chunk is closed.
    #[must_use]
    pub fn chunk_size(&self) -> u64 {
        match self {
            Self::Mcap(options) => options.chunk_size,
            #[cfg(feature = "sqlite")]
            Self::Sqlite(options) => options.chunk_size,
        }
    }

    /// Sets the size in bytes, before compression, at which a chunk is closed.
    pub fn set_chunk_size(&mut self, chunk_size: u64) {
        match self {
            Self::Mcap(options) => options.chunk_size = chunk_size,
            #[cfg(feature = "sqlite")]
            Self::Sqlite(options) => options.chunk_size = chunk_size,
        }
    }
}

fn named<T: Copy>(presets: &[(&str, T)], name: &str) -> Option<T> {
    presets.iter().find(|(known, _)| *known == name).map(|&(_, preset)| preset)
}

impl Default for StorageOptions {
    fn default() -> Self {
        McapOptions::default().into()
    }
}

impl From<McapOptions> for StorageOptions {
    fn from(options: McapOptions) -> Self {
        Self::Mcap(options)
    }
}

#[cfg(feature = "sqlite")]
impl From<SqliteOptions> for StorageOptions {
    fn from(options: SqliteOptions) -> Self {
        Self::Sqlite(options)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_are_listed_by_the_names_by_which_they_are_found() {
        assert_eq!(StoragePreset::ALL.map(|(name, _)| name), Storage::Mcap.presets());
        #[cfg(feature = "sqlite")]
        assert_eq!(SqlitePreset::ALL.map(|(name, _)| name), Storage::Sqlite3.presets());
    }
}
