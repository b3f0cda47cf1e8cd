//! The storages of rosbag2.

use std::ffi::OsString;
use std::fmt;
use std::path::{Path, PathBuf};
use std::str::FromStr;

/// What kind of files a bag has: `--storage` of `ros2 bag record`, `storage_identifier` of metadata.yaml.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Storage {
    /// `.mcap`, what Jazzy records unless told otherwise.
    #[default]
    Mcap,
    /// `.db3`, SQLite; only with the feature `sqlite`, which compiles it. It keeps one time of a message: when it was received.
    Sqlite3,
}

impl Storage {
    /// All, by their names in rosbag2.
    pub const ALL: [(&'static str, Self); 2] = [("mcap", Self::Mcap), ("sqlite3", Self::Sqlite3)];

    /// Its name in rosbag2.
    #[must_use]
    pub fn identifier(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Sqlite3 => "sqlite3",
        }
    }

    /// What the names of its files end with.
    pub(crate) fn extension(self) -> &'static str {
        match self {
            Self::Mcap => "mcap",
            Self::Sqlite3 => "db3",
        }
    }

    /// Files that may stand beside one that was not ended.
    pub(crate) fn companions(self, file: &Path) -> Vec<PathBuf> {
        match self {
            Self::Mcap => Vec::new(),
            Self::Sqlite3 => vec![write_ahead_log(file), with_suffix(file, "-shm")],
        }
    }

    /// Whether a message has the time at which it was published besides that at which it was received.
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
            .ok_or_else(|| format!("there is no storage \"{text}\"; there are mcap, sqlite3"))
    }
}

/// Where SQLite keeps what it has not yet moved into the file.
pub(crate) fn write_ahead_log(file: &Path) -> PathBuf {
    with_suffix(file, "-wal")
}

fn with_suffix(file: &Path, suffix: &str) -> PathBuf {
    let mut name = OsString::from(file);
    name.push(suffix);
    name.into()
}
