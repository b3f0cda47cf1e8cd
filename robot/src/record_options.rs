//! The options of how a recording is written, each declared once: `[record]` of robot files, the options of
//! `downbeat bag record`, those that `bag convert`, `cut` and `repair` share with it, and the table in
//! `docs/robot_files.md` come from this list.

use std::fmt::Write;
use std::num::NonZeroUsize;
use std::ops::RangeInclusive;
use std::time::Duration;

use downbeat_bags::metadata::{FORMAT_VERSION, HUMBLE_VERSION};
use downbeat_bags::{
    Compression, RecordingOptions, SnapshotLimits, Storage, StorageOptions, SyncPolicy, WhenDiskFull,
    WhenLow, WhenSlow, WriterOptions,
};
use downbeat_files::duration;
use downbeat_msgs::encoding::Encoding;

/// How a recording is written, as set in `[record]` of a robot file and on the command line.
#[derive(Clone, Debug, Default)]
pub struct RecordOptions {
    /// The serialisation format of the messages.
    pub encoding: Encoding,
    /// How its files are written.
    pub writer: WriterOptions,
    /// What happens to messages until they are written.
    pub recording: RecordingOptions,
    /// When a recording takes a snapshot without being asked.
    pub snapshot_triggers: SnapshotTriggers,
    /// Whether each further file, or snapshot, begins with the last messages of latched topics; `None` as
    /// the recorder's default.
    pub repeats_latched: Option<bool>,
}

/// When a recording takes a snapshot without being asked.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SnapshotTriggers {
    /// When this expression over the latest messages of topics becomes true.
    pub when: Option<String>,
    /// When a module panics.
    pub on_panic: bool,
    /// How long messages after the trigger still belong to the snapshot.
    pub after: Duration,
}

impl SnapshotTriggers {
    /// Returns whether there is a trigger.
    #[must_use]
    pub fn are_some(&self) -> bool {
        self.when.is_some() || self.on_panic
    }
}

impl RecordOptions {
    /// Returns the reason if the storage cannot contain messages in the encoding.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        let is_sqlite = self.writer.storage.storage() == Storage::Sqlite3;
        if is_sqlite && self.repeats_latched == Some(true) {
            let reason = "the storage sqlite3 has no place for the publish times of repeated messages: leave out \
                          repeat_latched, or record in the storage mcap";
            return Some(reason.to_owned());
        }
        let is_refused = is_sqlite && self.encoding != Encoding::Cdr;
        is_refused.then(|| {
            let encoding = self.encoding;
            format!("the storage sqlite3 does not support the encoding {encoding}: record as cdr, or in the storage mcap")
        })
    }

    /// The options of the files, for a recorder with that default of [`Self::repeats_latched`].
    #[must_use]
    pub fn writer(&self, repeats_latched: bool) -> WriterOptions {
        let repeats_latched = self.repeats_latched.unwrap_or(repeats_latched);
        let mut writer = self.writer.clone();
        writer.repeats_latched = repeats_latched;
        writer
    }

    /// The options of the queue, as for [`Self::writer`].
    #[must_use]
    pub fn recording(&self, repeats_latched: bool) -> RecordingOptions {
        let repeats_latched = self.repeats_latched.unwrap_or(repeats_latched);
        RecordingOptions { repeats_latched, ..self.recording.clone() }
    }

    /// Sets how many bytes of messages may wait, to be written or for a snapshot.
    pub fn set_cache_bytes(&mut self, cache_bytes: usize) {
        self.recording.cache_bytes = cache_bytes;
        if let Some(snapshot) = &mut self.recording.snapshot {
            snapshot.max_bytes = cache_bytes;
        }
    }

    fn set_storage(&mut self, storage: Storage) -> Result<(), String> {
        // The options of a robot file stay if the command line names the same storage.
        if storage != self.writer.storage.storage() {
            self.writer.storage = StorageOptions::of(storage).map_err(|error| error.to_string())?;
        }
        Ok(())
    }

    fn set_compression(&mut self, compression: Compression) -> Result<(), String> {
        match self.writer.storage.mcap_mut() {
            Ok(mcap) => mcap.compression = compression,
            Err(_) if compression == Compression::None => {}
            Err(error) => return Err(error.to_string()),
        }
        Ok(())
    }

    /// Keeps messages for snapshots, unless the options say so already.
    fn keep_for_triggers(&mut self) -> Result<(), String> {
        if self.recording.snapshot.is_none() { self.keep_snapshots(None) } else { Ok(()) }
    }

    /// Keeps messages for snapshots, of this duration if there is one.
    fn keep_snapshots(&mut self, max_duration: Option<Duration>) -> Result<(), String> {
        let max_bytes = self.recording.cache_bytes;
        if max_bytes == 0 {
            return Err("Max cache size must be greater than 0 when snapshot mode is enabled".into());
        }
        self.recording.snapshot = Some(SnapshotLimits { max_bytes, max_duration });
        Ok(())
    }
}

/// An option of how a recording is written.
#[derive(Debug)]
pub struct RecordOption {
    /// Its key in `[record]` of a robot file.
    pub key: &'static str,
    /// Its name on the command line, after `--`.
    pub flag: &'static str,
    /// Another name on the command line.
    pub alias: Option<&'static str>,
    /// Its letter on the command line.
    pub letter: Option<char>,
    /// Which commands have it.
    pub scope: Scope,
    /// What it does, as a sentence.
    pub help: &'static str,
    /// What applies without it, as users read it.
    pub default: &'static str,
    /// Its values, and how one is applied.
    pub takes: Takes,
}

/// Which commands have an option.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scope {
    /// Every command that writes bags.
    Files,
    /// Only commands that record.
    Recording,
}

/// The values of an option, and how one is applied.
#[derive(Debug)]
pub enum Takes {
    /// One of these.
    Choice(&'static [Choice]),
    /// A preset profile of the storage.
    Preset,
    /// A number of bytes.
    Bytes {
        /// The range in robot files.
        in_file: RangeInclusive<i64>,
        /// The range on the command line, which for limits of rosbag2 is that of `ros2 bag record`.
        on_command_line: RangeInclusive<u64>,
        /// Applies it.
        set: fn(&mut RecordOptions, u64),
    },
    /// A number above 0.
    Count(fn(&mut RecordOptions, NonZeroUsize)),
    /// A time with its unit; on the command line also a plain number of seconds.
    Time(fn(&mut RecordOptions, Duration) -> Result<(), String>),
    /// `true` or `false`; on the command line `true` if given.
    Switch(fn(&mut RecordOptions, bool) -> Result<(), String>),
    /// A text.
    Text(fn(&mut RecordOptions, &str) -> Result<(), String>),
    /// A table of texts; on the command line `KEY=VALUE`, which may be repeated.
    Entries(fn(&mut RecordOptions, &str, &str)),
}

/// A value of an option.
#[derive(Debug)]
pub struct Choice {
    /// Its name.
    pub name: &'static str,
    /// What it means.
    pub help: &'static str,
    /// Applies it.
    pub set: fn(&mut RecordOptions) -> Result<(), String>,
}

impl RecordOption {
    /// The name of its value on the command line.
    #[must_use]
    pub fn value_name(&self) -> &'static str {
        match self.takes {
            Takes::Choice(_) => "CHOICE",
            Takes::Preset => "PRESET",
            Takes::Bytes { .. } => "BYTES",
            Takes::Count(_) => "N",
            Takes::Time(_) => "TIME",
            Takes::Switch(_) => "",
            Takes::Text(_) => "TEXT",
            Takes::Entries(_) => "KEY=VALUE",
        }
    }

    /// Applies a value of the command line.
    ///
    /// # Errors
    /// Returns the reason if it is not a value of the option, or does not fit those that were applied before.
    pub fn set_text(&self, options: &mut RecordOptions, text: &str) -> Result<(), String> {
        match &self.takes {
            Takes::Choice(choices) => match choices.iter().find(|choice| choice.name == text) {
                Some(choice) => (choice.set)(options),
                None => Err(format!("unknown choice \"{text}\"")),
            },
            Takes::Preset => set_preset(options, text),
            Takes::Bytes { on_command_line, set, .. } => {
                let number = text.parse::<u64>().ok().filter(|number| on_command_line.contains(number));
                set(
                    options,
                    number.ok_or_else(|| {
                        let (least, most) = (on_command_line.start(), on_command_line.end());
                        format!("\"{text}\" is not a number of bytes from {least} to {most}")
                    })?,
                );
                Ok(())
            }
            Takes::Count(set) => {
                let number = text.parse();
                set(options, number.map_err(|_| format!("\"{text}\" is not a whole number above 0"))?);
                Ok(())
            }
            Takes::Time(set) => set(options, duration::parse_or_seconds(text)?),
            Takes::Switch(set) => set(options, text == "true"),
            Takes::Text(set) => set(options, text),
            Takes::Entries(set) => {
                let (key, value) =
                    text.split_once('=').ok_or_else(|| format!("\"{text}\" is not KEY=VALUE"))?;
                set(options, key, value);
                Ok(())
            }
        }
    }

    /// Its row in a table of Markdown for users.
    fn row(&self) -> String {
        let values = match &self.takes {
            Takes::Choice(choices) => {
                let choices = choices.iter().map(|choice| format!("`\"{}\"`: {}", choice.name, choice.help));
                format!(" {}", choices.collect::<Vec<_>>().join("; "))
            }
            Takes::Preset => {
                let [mcap, sqlite3] = [Storage::Mcap, Storage::Sqlite3].map(|storage| {
                    let presets = storage.presets().iter().map(|preset| format!("`\"{preset}\"`"));
                    presets.collect::<Vec<_>>().join(", ")
                });
                format!(" {mcap}; for `\"sqlite3\"` {sqlite3}")
            }
            _ => String::new(),
        };
        let letter = self.letter.map(|letter| format!("`-{letter}`, ")).unwrap_or_default();
        format!("| `{}` | {letter}`--{}` | {}{values} | {} |", self.key, self.flag, self.help, self.default)
    }
}

/// Applies a preset profile of the storage.
pub(crate) fn set_preset(options: &mut RecordOptions, name: &str) -> Result<(), String> {
    let preset = StorageOptions::preset(options.writer.storage.storage(), name);
    options.writer.storage = preset.map_err(|error| error.to_string())?;
    Ok(())
}

/// The options as a table of Markdown for users.
#[must_use]
pub fn table() -> String {
    let mut table =
        "| key | `downbeat bag record` | meaning | default |\n| --- | --- | --- | --- |\n".to_owned();
    for option in RECORD_OPTIONS {
        // Writing to a string does not fail.
        let _ = writeln!(table, "{}", option.row());
    }
    table
}

/// The smallest size of a chunk, of a file and of the queue in a robot file.
const LEAST_BYTES: i64 = 1024;
const MOST_CHUNK_BYTES: i64 = 1 << 30;

/// All options, in the order in which they are applied: a storage before its preset, a preset before what
/// overrides it, the size of the queue before snapshots.
pub const RECORD_OPTIONS: &[RecordOption] = &[
    RecordOption {
        key: "storage",
        flag: "storage",
        alias: None,
        letter: Some('s'),
        scope: Scope::Files,
        help: "The files of the bag.",
        default: "`mcap`",
        takes: Takes::Choice(&[
            Choice { name: "mcap", help: "MCAP", set: |options| options.set_storage(Storage::Mcap) },
            Choice {
                name: "sqlite3",
                help: "SQLite, in builds with the feature `sqlite`, without publish times, with no encoding but cdr",
                set: |options| options.set_storage(Storage::Sqlite3),
            },
        ]),
    },
    RecordOption {
        key: "preset",
        flag: "storage-preset-profile",
        alias: None,
        letter: None,
        scope: Scope::Files,
        help: "A preset profile of rosbag2:",
        default: "`none` with checksums; `resilient`",
        takes: Takes::Preset,
    },
    RecordOption {
        key: "compression",
        flag: "compression",
        alias: None,
        letter: None,
        scope: Scope::Files,
        help: "How chunks of mcap are compressed.",
        default: "as the preset",
        takes: Takes::Choice(&[
            Choice {
                name: "none",
                help: "not at all",
                set: |options| options.set_compression(Compression::None),
            },
            Choice { name: "lz4", help: "LZ4", set: |options| options.set_compression(Compression::Lz4) },
            Choice {
                name: "zstd",
                help: "Zstandard",
                set: |options| options.set_compression(Compression::Zstd),
            },
        ]),
    },
    RecordOption {
        key: "chunk_size",
        flag: "chunk-size",
        alias: None,
        letter: None,
        scope: Scope::Files,
        help: "Bytes of a chunk, before compression: 1024 to 1073741824.",
        default: "as the preset, 786432",
        takes: Takes::Bytes {
            in_file: LEAST_BYTES..=MOST_CHUNK_BYTES,
            on_command_line: LEAST_BYTES as u64..=MOST_CHUNK_BYTES as u64,
            set: |options, bytes| options.writer.storage.set_chunk_size(bytes),
        },
    },
    RecordOption {
        key: "max_bag_size",
        flag: "max-bag-size",
        alias: None,
        letter: Some('b'),
        scope: Scope::Files,
        help: "Bytes after which the bag continues in a new file.",
        default: "one file; 0 on the command line",
        takes: Takes::Bytes {
            in_file: LEAST_BYTES..=i64::MAX,
            on_command_line: 0..=u64::MAX,
            set: |options, bytes| options.writer.split.max_bytes = (bytes > 0).then_some(bytes),
        },
    },
    RecordOption {
        key: "max_bag_duration",
        flag: "max-bag-duration",
        alias: None,
        letter: Some('d'),
        scope: Scope::Files,
        help: "Time after which the bag continues in a new file.",
        default: "one file; 0 on the command line",
        takes: Takes::Time(|options, time| {
            options.writer.split.max_duration = (!time.is_zero()).then_some(time);
            Ok(())
        }),
    },
    RecordOption {
        key: "max_bag_files",
        flag: "max-bag-files",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "The maximum number of files: the oldest is deleted.",
        default: "all are kept",
        takes: Takes::Count(|options, count| options.writer.max_bag_files = Some(count)),
    },
    RecordOption {
        key: "metadata_version",
        flag: "metadata-version",
        alias: None,
        letter: None,
        scope: Scope::Files,
        help: "The version of metadata.yaml.",
        default: "`9`",
        takes: Takes::Choice(&[
            Choice {
                name: "9",
                help: "as ROS 2 Jazzy",
                set: |options| {
                    options.writer.metadata_version = FORMAT_VERSION;
                    Ok(())
                },
            },
            Choice {
                name: "5",
                help: "as ROS 2 Humble, which reads no later one",
                set: |options| {
                    options.writer.metadata_version = HUMBLE_VERSION;
                    Ok(())
                },
            },
        ]),
    },
    RecordOption {
        key: "repeat_latched",
        flag: "repeat-latched",
        alias: Some("repeat-transient-local"),
        letter: None,
        scope: Scope::Recording,
        help: "Begin each further file, or snapshot, of the bag with the last messages of latched (transient local) topics.",
        default: "of a robot in the storage mcap, not of ROS 2",
        takes: Takes::Switch(|options, repeats_latched| {
            options.repeats_latched = Some(repeats_latched);
            Ok(())
        }),
    },
    RecordOption {
        key: "custom_data",
        flag: "custom-data",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "Texts by key that are added to the metadata. The last value of a key is used.",
        default: "none",
        takes: Takes::Entries(|options, key, value| {
            options.writer = std::mem::take(&mut options.writer).custom_data(key, value);
        }),
    },
    RecordOption {
        key: "encoding",
        flag: "encoding",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "How messages are serialised.",
        default: "`cdr`",
        takes: Takes::Choice(&[
            encoding(Encoding::Cdr, "as in ROS 2", |options| set_encoding(options, Encoding::Cdr)),
            encoding(Encoding::Json, "objects with the names of the fields", |options| {
                set_encoding(options, Encoding::Json)
            }),
            encoding(Encoding::Cbor, "like `json`, but binary", |options| {
                set_encoding(options, Encoding::Cbor)
            }),
            encoding(Encoding::Protobuf, "with a schema derived from the definition", |options| {
                set_encoding(options, Encoding::Protobuf)
            }),
            encoding(
                Encoding::FoxgloveProtobuf,
                "with the schema of Foxglove for the type, other types as `protobuf`",
                |options| set_encoding(options, Encoding::FoxgloveProtobuf),
            ),
            encoding(Encoding::FlatBuffers, "with a schema derived from the definition", |options| {
                set_encoding(options, Encoding::FlatBuffers)
            }),
            encoding(
                Encoding::FoxgloveFlatBuffers,
                "with the schema of Foxglove for the type, other types as `flatbuffers`",
                |options| set_encoding(options, Encoding::FoxgloveFlatBuffers),
            ),
        ]),
    },
    RecordOption {
        key: "max_cache_size",
        flag: "max-cache-size",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "Bytes of messages that may be queued for the disk. With 0, on the command line, every message of ROS 2 waits for the disk.",
        default: "67108864 of a robot, 104857600 of ROS 2",
        takes: Takes::Bytes {
            in_file: LEAST_BYTES..=i64::MAX,
            on_command_line: 0..=u64::MAX,
            set: |options, bytes| options.set_cache_bytes(usize::try_from(bytes).unwrap_or(usize::MAX)),
        },
    },
    RecordOption {
        key: "snapshot_mode",
        flag: "snapshot-mode",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "Keep messages in memory, as many as max_cache_size allows, and write them only when the service ~/snapshot is called.",
        default: "everything is written",
        takes: Takes::Switch(|options, is_on| {
            if is_on {
                return options.keep_snapshots(None);
            }
            options.recording.snapshot = None;
            Ok(())
        }),
    },
    RecordOption {
        key: "snapshot",
        flag: "snapshot-duration",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "As the snapshot mode, for messages of this duration.",
        default: "no limit of time",
        takes: Takes::Time(|options, time| options.keep_snapshots(Some(time))),
    },
    RecordOption {
        key: "snapshot_when",
        flag: "snapshot-when",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "Take a snapshot whenever this expression over the latest messages of topics becomes true, such as `battery_state.voltage < 11`.",
        default: "none",
        takes: Takes::Text(|options, expression| {
            options.snapshot_triggers.when = Some(expression.to_owned());
            options.keep_for_triggers()
        }),
    },
    RecordOption {
        key: "snapshot_on_panic",
        flag: "snapshot-on-panic",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "Take a snapshot of a robot when one of its modules panics.",
        default: "none",
        takes: Takes::Switch(|options, is_on| {
            options.snapshot_triggers.on_panic = is_on;
            if is_on { options.keep_for_triggers() } else { Ok(()) }
        }),
    },
    RecordOption {
        key: "snapshot_after",
        flag: "snapshot-after",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "How long such a snapshot continues after its trigger.",
        default: "it ends there",
        takes: Takes::Time(|options, after| {
            options.snapshot_triggers.after = after;
            Ok(())
        }),
    },
    RecordOption {
        key: "start_paused",
        flag: "start-paused",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "Start paused.",
        default: "not paused",
        takes: Takes::Switch(|options, is_paused| {
            options.recording.is_paused = is_paused;
            Ok(())
        }),
    },
    RecordOption {
        key: "slow_disk",
        flag: "slow-disk",
        alias: Some("when-slow"),
        letter: None,
        scope: Scope::Recording,
        help: "What to do if messages arrive faster than they can be written.",
        default: "`drop`",
        takes: Takes::Choice(&[
            Choice {
                name: "drop",
                help: "drop and count messages, and continue",
                set: |options| {
                    options.recording.when_slow = WhenSlow::Drop;
                    Ok(())
                },
            },
            Choice {
                name: "stop",
                help: "stop recording, earlier messages are kept",
                set: |options| {
                    options.recording.when_slow = WhenSlow::Stop;
                    Ok(())
                },
            },
        ]),
    },
    RecordOption {
        key: "disk_full",
        flag: "disk-full",
        alias: Some("when-disk-full"),
        letter: None,
        scope: Scope::Recording,
        help: "What to do if the disk is full.",
        default: "`stop`",
        takes: Takes::Choice(&[
            Choice {
                name: "stop",
                help: "stop recording, earlier messages are kept",
                set: |options| {
                    options.writer.disk_full = WhenDiskFull::Stop;
                    Ok(())
                },
            },
            Choice {
                name: "drop",
                help: "drop and count messages until there is room",
                set: |options| {
                    options.writer.disk_full = WhenDiskFull::Drop;
                    Ok(())
                },
            },
        ]),
    },
    RecordOption {
        key: "keep_free",
        flag: "keep-free",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "Bytes of the disk that stay free for others, checked after each chunk.",
        default: "no check",
        takes: Takes::Bytes {
            in_file: 0..=i64::MAX,
            on_command_line: 0..=u64::MAX,
            set: |options, bytes| options.writer.keep_free = bytes,
        },
    },
    RecordOption {
        key: "when_low",
        flag: "when-low",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "What to do if less than keep_free is free.",
        default: "`stop`",
        takes: Takes::Choice(&[
            Choice {
                name: "stop",
                help: "finish the bag and stop recording",
                set: |options| {
                    options.writer.when_low = WhenLow::Stop;
                    Ok(())
                },
            },
            Choice {
                name: "drop-oldest",
                help: "delete the oldest files of this bag, which needs max_bag_size or max_bag_duration; stop if there are none",
                set: |options| {
                    options.writer.when_low = WhenLow::DropOldest;
                    Ok(())
                },
            },
        ]),
    },
    RecordOption {
        key: "sync",
        flag: "sync",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "When to sync written data to disk.",
        default: "`files`",
        takes: Takes::Choice(&[
            Choice {
                name: "never",
                help: "never",
                set: |options| {
                    options.writer.sync = SyncPolicy::Never;
                    Ok(())
                },
            },
            Choice {
                name: "files",
                help: "at the end of each file",
                set: |options| {
                    options.writer.sync = SyncPolicy::Files;
                    Ok(())
                },
            },
            Choice {
                name: "chunks",
                help: "after each chunk",
                set: |options| {
                    options.writer.sync = SyncPolicy::Chunks;
                    Ok(())
                },
            },
        ]),
    },
    RecordOption {
        key: "flush_interval",
        flag: "flush-interval",
        alias: None,
        letter: None,
        scope: Scope::Recording,
        help: "The most that a killed recording loses.",
        default: "`1s`",
        takes: Takes::Time(|options, time| {
            options.writer.flush_interval = time;
            Ok(())
        }),
    },
];

const fn encoding(
    encoding: Encoding,
    help: &'static str,
    set: fn(&mut RecordOptions) -> Result<(), String>,
) -> Choice {
    Choice { name: encoding.as_str(), help, set }
}

fn set_encoding(options: &mut RecordOptions, encoding: Encoding) -> Result<(), String> {
    options.encoding = encoding;
    Ok(())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

    #[test]
    fn the_page_on_robot_files_has_the_table_of_these_options() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/robot_files.md");
        let page = std::fs::read_to_string(path).unwrap();
        let table = table();
        let header = table.lines().next().unwrap();
        let at = page.find(header).unwrap_or_else(|| panic!("no table in {path}; it is:\n{table}"));
        let end = page[at..].find("\n\n").map_or(page.len(), |length| at + length + 1);
        assert!(page[at..end] == table, "the table in {path} differs; the right one is:\n{table}");
    }

    #[test]
    fn the_choice_that_is_documented_as_the_default_changes_nothing() {
        for option in RECORD_OPTIONS {
            let Takes::Choice(choices) = &option.takes else { continue };
            let documented = option.default.trim_matches('`');
            let Some(choice) = choices.iter().find(|choice| choice.name == documented) else {
                assert_eq!(option.default, "as the preset", "{}", option.key);
                continue;
            };
            let mut options = RecordOptions::default();
            (choice.set)(&mut options).unwrap();
            assert_eq!(format!("{options:?}"), format!("{:?}", RecordOptions::default()), "{}", option.key);
        }
    }

    #[test]
    fn every_encoding_storage_and_compression_can_be_chosen() {
        let names = |key: &str| {
            let option = RECORD_OPTIONS.iter().find(|option| option.key == key).unwrap();
            let Takes::Choice(choices) = &option.takes else { panic!("{key} has no choices") };
            choices.iter().map(|choice| choice.name).collect::<Vec<_>>()
        };
        assert_eq!(names("encoding"), Encoding::ALL.map(Encoding::as_str));
        assert_eq!(names("storage"), Storage::ALL.map(|(name, _)| name));
        assert_eq!(names("compression"), Compression::ALL.map(|(name, _)| name));
    }
}
