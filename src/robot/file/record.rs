//! `[record]`: what a recording holds, and how it is written.

use std::num::NonZeroUsize;
use std::time::Duration;

use downbeat_bags::{
    Compression, Recording, RecordingOptions, SnapshotLimits, SplitLimits, Storage, StorageOptions,
    SyncPolicy, WhenDiskFull, WhenSlow, WriterOptions,
};
use downbeat_bridge::expose::TopicPattern;
use downbeat_msgs::encoding::Encoding;

use super::table::{Table, Value};
use super::{Result, choice};

/// What a recording holds, and how it is written.
#[derive(Clone)]
pub struct RecordEntry {
    pub(crate) line: usize,
    /// The topics by name or pattern, or nothing for all of them.
    pub topics: Option<Vec<String>>,
    /// What `topics` does not mean, by name or pattern.
    pub except: Vec<String>,
    /// Only topics of these types, if any are named.
    pub types: Vec<String>,
    /// Only topics that these modules publish, if any are named.
    pub modules: Vec<String>,
    /// Only topics that are exposed, or only those that are not; nothing for both.
    pub exposed: Option<bool>,
    /// How its messages are serialised.
    pub encoding: Encoding,
    /// Which storage it has, and how its files are laid out.
    pub storage: StorageOptions,
    /// When it goes on in a new file.
    pub split: SplitLimits,
    /// How many files it has at the most.
    pub max_bag_files: Option<NonZeroUsize>,
    /// How many bytes of messages may wait to be written.
    pub cache_bytes: usize,
    /// For snapshots: how long messages are kept; nothing where all is written.
    pub snapshot: Option<Duration>,
    /// What to do when the disk is full.
    pub disk_full: WhenDiskFull,
    /// What to do when the disk is slow.
    pub slow_disk: WhenSlow,
    /// When to wait for the medium.
    pub sync: SyncPolicy,
}

impl Default for RecordEntry {
    fn default() -> Self {
        Self {
            line: 1,
            topics: None,
            except: Vec::new(),
            types: Vec::new(),
            modules: Vec::new(),
            exposed: None,
            encoding: Encoding::default(),
            storage: StorageOptions::default(),
            split: SplitLimits::NONE,
            max_bag_files: None,
            cache_bytes: Recording::DEFAULT_QUEUE_BYTES,
            snapshot: None,
            disk_full: WhenDiskFull::default(),
            slow_disk: WhenSlow::default(),
            sync: SyncPolicy::default(),
        }
    }
}

impl RecordEntry {
    /// How the bag is written.
    #[must_use]
    pub fn writer_options(&self) -> WriterOptions {
        let options = WriterOptions::new()
            .storage(self.storage.clone())
            .split(self.split)
            .sync(self.sync)
            .when_disk_full(self.disk_full);
        match self.max_bag_files {
            Some(most) => options.max_bag_files(most),
            None => options,
        }
    }

    /// Why the storage cannot hold messages in that encoding, if it cannot.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        let is_refused = self.storage.storage() == Storage::Sqlite3 && self.encoding != Encoding::Cdr;
        is_refused.then(|| {
            let encoding = self.encoding;
            format!("the storage sqlite3 has no place for the encoding {encoding}: record it as cdr, or in the storage mcap")
        })
    }

    /// What becomes of messages until they are written.
    #[must_use]
    pub fn recording_options(&self) -> RecordingOptions {
        let options = RecordingOptions::new().cache_bytes(self.cache_bytes).when_slow(self.slow_disk);
        match self.snapshot {
            Some(duration) => {
                options.snapshot(SnapshotLimits { max_bytes: self.cache_bytes, max_duration: Some(duration) })
            }
            None => options,
        }
    }
}

/// The least that a chunk may hold.
const LEAST_CHUNK: i64 = 1024;

pub(super) fn record(value: Value<'_>) -> Result<RecordEntry> {
    let mut table = value.table("[record]")?;
    let unless_given = RecordEntry::default();
    let topics = table.take("topics");
    let line = topics.map_or(table.line(), |value| value.line());
    let encoding = table.take("encoding");
    let topics = match topics {
        Some(value) if value.text().is_ok_and(|text| text == "all") => None,
        Some(value) => {
            let names = value.list().map_err(|_| value.error("expected \"all\" or a list of topics"))?;
            Some(names.iter().map(|name| pattern(*name)).collect::<Result<_>>()?)
        }
        None => None,
    };
    let bytes = |table: &mut Table<'_>, key, least: i64| -> Result<Option<u64>> {
        let what = "a number of bytes, 1024 or more";
        table.take(key).map(|value| value.number_in(least..=i64::MAX, what)).transpose()
    };
    let entry = RecordEntry {
        line,
        topics,
        except: list(&mut table, "except", pattern)?,
        types: list(&mut table, "types", |value| Ok(value.text()?.to_owned()))?,
        modules: list(&mut table, "modules", |value| Ok(value.text()?.to_owned()))?,
        exposed: table.take("exposed").map(|value| value.flag()).transpose()?,
        encoding: match encoding {
            Some(value) => choice(value, &Encoding::ALL.map(|encoding| (encoding.as_str(), encoding)))?,
            None => unless_given.encoding,
        },
        storage: storage(&mut table)?,
        split: SplitLimits {
            max_bytes: bytes(&mut table, "max_bag_size", LEAST_CHUNK)?,
            max_duration: table.take("max_bag_duration").map(|value| value.duration()).transpose()?,
        },
        max_bag_files: match table.take("max_bag_files") {
            Some(value) => NonZeroUsize::new(value.count()? as usize),
            None => None,
        },
        cache_bytes: bytes(&mut table, "max_cache_size", LEAST_CHUNK)?
            .map_or(unless_given.cache_bytes, |bytes| usize::try_from(bytes).unwrap_or(usize::MAX)),
        snapshot: table.take("snapshot").map(|value| value.duration()).transpose()?,
        disk_full: match table.take("disk_full") {
            Some(value) => choice(value, &[("stop", WhenDiskFull::Stop), ("drop", WhenDiskFull::Drop)])?,
            None => unless_given.disk_full,
        },
        slow_disk: match table.take("slow_disk") {
            Some(value) => choice(value, &[("stop", WhenSlow::Stop), ("drop", WhenSlow::Drop)])?,
            None => unless_given.slow_disk,
        },
        sync: match table.take("sync") {
            Some(value) => choice(
                value,
                &[("never", SyncPolicy::Never), ("files", SyncPolicy::Files), ("chunks", SyncPolicy::Chunks)],
            )?,
            None => unless_given.sync,
        },
    };
    table.finish()?;
    match (encoding, entry.refusal()) {
        (Some(value), Some(reason)) => Err(value.error(reason)),
        _ => Ok(entry),
    }
}

/// `storage` and `preset`, and what stands over them.
fn storage(table: &mut Table<'_>) -> Result<StorageOptions> {
    let mut options = match table.take("storage") {
        Some(value) => {
            let options = StorageOptions::of(choice(value, &Storage::ALL)?);
            options.map_err(|error| value.error(error.to_string()))?
        }
        None => StorageOptions::default(),
    };
    if let Some(value) = table.take("preset") {
        let storage = options.storage();
        let presets: Vec<_> = storage.presets().iter().map(|&name| (name, name)).collect();
        let preset = StorageOptions::preset(storage, choice(value, &presets)?);
        options = preset.map_err(|error| value.error(error.to_string()))?;
    }
    if let Some(value) = table.take("compression") {
        let mcap = options.mcap_mut().map_err(|error| value.error(error.to_string()))?;
        mcap.compression = choice(value, &Compression::ALL)?;
    }
    if let Some(value) = table.take("chunk_size") {
        options.set_chunk_size(value.number_in(LEAST_CHUNK..=1 << 30, "1024 to 1073741824 bytes")?);
    }
    Ok(options)
}

/// A name, or a pattern that is one.
fn pattern(value: Value<'_>) -> Result<String> {
    let text = value.text()?;
    TopicPattern::new(text).map_err(|error| value.error(error.to_string()))?;
    Ok(text.to_owned())
}

fn list(
    table: &mut Table<'_>,
    key: &'static str,
    read: impl Fn(Value<'_>) -> Result<String>,
) -> Result<Vec<String>> {
    let Some(value) = table.take(key) else { return Ok(Vec::new()) };
    value.list()?.into_iter().map(read).collect()
}
