//! Options of SQLite files, as in preset profiles and storage config files of `rosbag2_storage_sqlite3`.

use std::path::Path;

use super::config::{self, Pragma};
use crate::writer::storage::DEFAULT_CHUNK_SIZE;
use crate::writer::{StorageConfigError, SyncPolicy};

/// A preset profile of rosbag2 for the storage `sqlite3`: `--storage-preset-profile`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SqlitePreset {
    /// The default of rosbag2 (`journal_mode=MEMORY`, `synchronous=OFF`): the least work. A process killed
    /// during a commit may leave a damaged file.
    None,
    /// The default of this crate (`journal_mode=WAL`, `synchronous=NORMAL`): after a crash of the process or
    /// the machine, the file contains complete transactions, without some of the last ones.
    #[default]
    Resilient,
}

impl SqlitePreset {
    /// All presets with their names in rosbag2.
    pub const ALL: [(&'static str, Self); 2] = [("none", Self::None), ("resilient", Self::Resilient)];

    /// The options of the preset.
    #[must_use]
    pub fn options(self) -> SqliteOptions {
        SqliteOptions { preset: self, ..SqliteOptions::default() }
    }
}

/// Options of SQLite files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SqliteOptions {
    /// Determines what is lost in a crash.
    pub preset: SqlitePreset,
    /// The size of messages in bytes at which a transaction is closed.
    pub chunk_size: u64,
    /// Settings of a config file, which override the preset.
    pragmas: Vec<Pragma>,
}

impl Default for SqliteOptions {
    fn default() -> Self {
        Self { preset: SqlitePreset::default(), chunk_size: DEFAULT_CHUNK_SIZE, pragmas: Vec::new() }
    }
}

impl SqliteOptions {
    /// Overrides these options with those of a storage config file: `--storage-config-file`. Uses the
    /// `pragmas` of `write`, which override the preset and the [`SyncPolicy`].
    ///
    /// Keys that rosbag2 does not know are ignored with a warning; `path` is for messages.
    ///
    /// # Errors
    /// If rosbag2 would not accept the text.
    pub fn with_config(self, text: &str, path: &Path) -> Result<Self, StorageConfigError> {
        Ok(Self { pragmas: config::read(text, path)?, ..self })
    }

    /// [`SqliteOptions::with_config`] with the text of a file.
    ///
    /// # Errors
    /// If the file cannot be read, or rosbag2 would not accept it.
    pub fn with_config_file(self, path: &Path) -> Result<Self, StorageConfigError> {
        let read = |source| StorageConfigError::Read { path: path.to_owned(), source };
        self.with_config(&std::fs::read_to_string(path).map_err(read)?, path)
    }

    /// The settings of a connection, in the order in which they are applied: those of the config file first,
    /// since the page size cannot change once there is a write-ahead log.
    pub(super) fn pragmas(&self, sync: SyncPolicy) -> Vec<Pragma> {
        let (journal_mode, synchronous) = match self.preset {
            SqlitePreset::None => ("MEMORY", "OFF"),
            SqlitePreset::Resilient => ("WAL", "NORMAL"),
        };
        let synchronous = match sync {
            SyncPolicy::Never => "OFF",
            SyncPolicy::Files => synchronous,
            SyncPolicy::Chunks => "FULL",
        };
        let mut pragmas = self.pragmas.clone();
        for preset in [("journal_mode", journal_mode), ("synchronous", synchronous)].map(Pragma::from) {
            if !pragmas.iter().any(|pragma| pragma.name.eq_ignore_ascii_case(&preset.name)) {
                pragmas.push(preset);
            }
        }
        pragmas
    }
}
