//! How an SQLite file is written: what `rosbag2_storage_sqlite3` takes from a preset profile and a storage config file.

use std::path::Path;

use super::config::{self, Pragma};
use crate::writer::storage::DEFAULT_CHUNK_SIZE;
use crate::writer::{StorageConfigError, SyncPolicy};

/// A preset profile of rosbag2 for the storage `sqlite3`: `--storage-preset-profile`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SqlitePreset {
    /// What rosbag2 does unless told otherwise (`journal_mode=MEMORY`, `synchronous=OFF`): the least work. A process that is
    /// killed while it commits may leave a file that is damaged.
    None,
    /// What this crate does unless told otherwise (`journal_mode=WAL`, `synchronous=NORMAL`): whatever happens to the process
    /// or the machine, the file has every transaction up to some of the last ones, whole.
    #[default]
    Resilient,
}

impl SqlitePreset {
    /// All, by their names in rosbag2.
    pub const ALL: [(&'static str, Self); 2] = [("none", Self::None), ("resilient", Self::Resilient)];

    /// What the preset stands for.
    #[must_use]
    pub fn options(self) -> SqliteOptions {
        SqliteOptions { preset: self, ..SqliteOptions::default() }
    }
}

/// How an SQLite file is written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SqliteOptions {
    /// What is not lost when a process or a machine ends.
    pub preset: SqlitePreset,
    /// The size of messages in bytes at which a transaction is closed.
    pub chunk_size: u64,
    /// What a config file sets besides, or in place of the preset.
    pragmas: Vec<Pragma>,
}

impl Default for SqliteOptions {
    fn default() -> Self {
        Self { preset: SqlitePreset::default(), chunk_size: DEFAULT_CHUNK_SIZE, pragmas: Vec::new() }
    }
}

impl SqliteOptions {
    /// These options with what a storage config file says in their place: `--storage-config-file`. Of the file the `pragmas` of
    /// `write` are heeded; they win over the preset and over the [`SyncPolicy`].
    ///
    /// Keys that rosbag2 does not know are passed over, with a warning in the log; `path` is for messages.
    ///
    /// # Errors
    /// If the text is not what rosbag2 takes.
    pub fn with_config(self, text: &str, path: &Path) -> Result<Self, StorageConfigError> {
        Ok(Self { pragmas: config::read(text, path)?, ..self })
    }

    /// [`SqliteOptions::with_config`] with the text of a file.
    ///
    /// # Errors
    /// If the file cannot be read, or is not what rosbag2 takes.
    pub fn with_config_file(self, path: &Path) -> Result<Self, StorageConfigError> {
        let read = |source| StorageConfigError::Read { path: path.to_owned(), source };
        self.with_config(&std::fs::read_to_string(path).map_err(read)?, path)
    }

    /// The settings of a connection, in the order in which they are made: those of the config file first, since the size of a
    /// page cannot change any more once there is a write-ahead log.
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
