//! Options of SQLite files, as in preset profiles and storage config files of `rosbag2_storage_sqlite3`.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Deserialize;

use crate::storage::Storage;
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
    /// Returns an error if rosbag2 would not accept the text.
    pub fn with_config(self, text: &str, path: &Path) -> Result<Self, StorageConfigError> {
        Ok(Self { pragmas: read(text, path)?, ..self })
    }

    /// [`SqliteOptions::with_config`] with the text of a file.
    ///
    /// # Errors
    /// Returns an error if the file cannot be read, or rosbag2 would not accept it.
    pub fn with_config_file(self, path: &Path) -> Result<Self, StorageConfigError> {
        let read = |source| StorageConfigError::Read { path: path.to_owned(), source };
        self.with_config(&downbeat_msgs::user_file::read_text(path).map_err(read)?, path)
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

/// A setting of SQLite.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Pragma {
    pub(super) name: String,
    /// The text after `PRAGMA`.
    pub(super) statement: String,
}

impl From<(&str, &str)> for Pragma {
    fn from((name, value): (&str, &str)) -> Self {
        Self { name: name.to_owned(), statement: format!("{name}={value}") }
    }
}

/// Reads the settings for writing from the text of a config file; `path` is for messages.
fn read(text: &str, path: &Path) -> Result<Vec<Pragma>, StorageConfigError> {
    let wrong = |line, found| StorageConfigError::Form {
        path: path.to_owned(),
        line,
        storage: Storage::Sqlite3,
        found,
    };
    // An empty file has no settings.
    let config: Option<Config> = downbeat_msgs::yaml::from_str(text)
        .map_err(|error| wrong(error.location().map_or(0, |location| location.line()), error.to_string()))?;
    let config = config.unwrap_or_default();
    for key in config.unknown.keys() {
        tracing::warn!("{}: unknown key \"{key}\" is ignored", path.display());
    }
    let entries = config.write.unwrap_or_default().pragmas;
    let entries = entries.iter().filter(|entry| !entry.is_empty());
    entries.map(|entry| pragma(entry).map_err(|found| wrong(0, found))).collect()
}

/// Rejects the same entries as rosbag2 (`parse_pragmas`).
fn pragma(entry: &str) -> Result<Pragma, String> {
    if let Some(character) = entry.chars().find(|character| "';\"".contains(*character)) {
        return Err(format!("the pragma {entry:?} must not have the character {character}"));
    }
    let name = entry.split_once('=').or_else(|| entry.split_once('(')).map_or(entry, |(name, _)| name);
    let name = name.trim();
    if name.is_empty() {
        return Err(format!("the pragma {entry:?} has no name"));
    }
    Ok(Pragma { name: name.to_owned(), statement: entry.to_owned() })
}

#[derive(Default, Deserialize)]
struct Config {
    /// The settings for reading, which are ignored.
    #[serde(rename = "read")]
    _read: Option<serde_norway::Value>,
    write: Option<Pragmas>,
    #[serde(flatten)]
    unknown: BTreeMap<String, serde_norway::Value>,
}

#[derive(Default, Deserialize)]
struct Pragmas {
    pragmas: Vec<String>,
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::writer::SyncPolicy;
    use crate::writer::sqlite::{SqliteOptions, SqlitePreset};

    fn statements(options: &SqliteOptions, sync: SyncPolicy) -> Vec<String> {
        options.pragmas(sync).into_iter().map(|pragma| pragma.statement).collect()
    }

    #[test]
    fn pragmas_of_a_config_file_override_the_preset_and_the_policy() {
        // As in rosbag2_storage_sqlite3/README.md.
        let text = "read:\n  pragmas: [\"cache_size = 10\"]\nwrite:\n  pragmas: [\"journal_mode = MEMORY\", \"\", \
                    \"cache_size(1000)\"]\n";
        let options = SqlitePreset::Resilient.options().with_config(text, Path::new("s.yaml")).unwrap();
        assert_eq!(
            statements(&options, SyncPolicy::Chunks),
            ["journal_mode = MEMORY", "cache_size(1000)", "synchronous=FULL"]
        );
        let plain = SqliteOptions::default().with_config("", Path::new("s.yaml")).unwrap();
        assert_eq!(plain, SqliteOptions::default());
    }

    #[test]
    fn presets_are_those_of_rosbag2_and_the_policy_decides_when_to_sync() {
        let none = SqlitePreset::None.options();
        assert_eq!(statements(&none, SyncPolicy::Files), ["journal_mode=MEMORY", "synchronous=OFF"]);
        let resilient = SqlitePreset::Resilient.options();
        assert_eq!(statements(&resilient, SyncPolicy::Files), ["journal_mode=WAL", "synchronous=NORMAL"]);
        assert_eq!(statements(&resilient, SyncPolicy::Never), ["journal_mode=WAL", "synchronous=OFF"]);
        assert_eq!(statements(&none, SyncPolicy::Chunks), ["journal_mode=MEMORY", "synchronous=FULL"]);
    }

    #[test]
    fn entries_that_rosbag2_refuses_are_refused_with_the_name_of_the_file() {
        for wrong in [
            "write:\n  pragmas: [\"cache_size = 1; DROP TABLE messages\"]\n",
            "write:\n  pragmas: [\"= 1\"]\n",
            "write:\n  pragmas: 7\n",
            "- a\n",
        ] {
            let error = SqliteOptions::default().with_config(wrong, Path::new("s.yaml")).unwrap_err();
            let message = error.to_string();
            assert!(
                message.starts_with("s.yaml:") && message.contains("rosbag2_storage_sqlite3"),
                "{message}"
            );
        }
    }
}
