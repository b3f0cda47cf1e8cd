//! The storages of rosbag2.

use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// The kind of files of a bag: `--storage` of `ros2 bag record`, `storage_identifier` of metadata.yaml.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Storage {
    /// `.mcap`, the default of Jazzy.
    #[default]
    Mcap,
    /// `.db3`, SQLite; only with the feature `sqlite`, which compiles it. It only stores the receive time of
    /// messages.
    Sqlite3,
}

impl Storage {
    /// All storages with their names in rosbag2.
    pub const ALL: [(&'static str, Self); 2] = [("mcap", Self::Mcap), ("sqlite3", Self::Sqlite3)];

    /// Its name in rosbag2.
    #[must_use]
    pub fn identifier(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Sqlite3 => "sqlite3",
        }
    }

    /// The extension of its files.
    pub(crate) fn extension(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Sqlite3 => "db3",
        }
    }

    /// Files that may accompany an unfinished one.
    pub(crate) fn companions(self, file: &Path) -> Vec<PathBuf> {
        match self {
            Self::Mcap => Vec::new(),
            Self::Sqlite3 => vec![write_ahead_log(file), with_suffix(file, "-shm")],
        }
    }

    /// Returns whether it stores the publish time of messages in addition to the receive time.
    pub(crate) fn keeps_publish_time(self) -> bool {
        match self {
            Self::Mcap => true,
            Self::Sqlite3 => false,
        }
    }
}

impl fmt::Display for Storage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.identifier())
    }
}

impl FromStr for Storage {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL
            .iter()
            .find(|(name, _)| *name == text)
            .map(|&(_, storage)| storage)
            .ok_or_else(|| format!("unknown storage \"{text}\"; available are mcap, sqlite3"))
    }
}

/// SQLite's write-ahead log of a file.
pub(crate) fn write_ahead_log(file: &Path) -> PathBuf {
    with_suffix(file, "-wal")
}

fn with_suffix(file: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(file);
    name.push(suffix);
    name.into()
}
