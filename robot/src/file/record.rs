//! `[record]`: what is recorded and how it is written.

use std::num::NonZeroUsize;

use downbeat_bags::{
    Compression, RecordingOptions, SnapshotLimits, Storage, StorageOptions, SyncPolicy, WhenDiskFull,
    WhenSlow, WriterOptions,
};
use downbeat_bridge::expose::TopicPattern;
use downbeat_msgs::encoding::Encoding;

use super::table::{Table, Value};
use super::{Result, choice};

/// What is recorded and how it is written.
#[derive(Clone)]
pub struct RecordEntry {
    pub(crate) line: usize,
    /// Names or patterns of the recorded topics; `None` for all topics.
    pub topics: Option<Vec<String>>,
    /// Names or patterns of topics that are excluded.
    pub except: Vec<String>,
    /// If not empty, only topics of these types are recorded.
    pub types: Vec<String>,
    /// If not empty, only topics that these modules publish are recorded.
    pub modules: Vec<String>,
    /// Records only exposed topics, or only topics that are not exposed; `None` for both.
    pub exposed: Option<bool>,
    /// How the recording is written.
    pub options: RecordOptions,
}

/// How a recording is written, as set in `[record]` of a robot file and on the command line.
#[derive(Clone, Debug, Default)]
pub struct RecordOptions {
    /// The serialisation format of the messages.
    pub encoding: Encoding,
    /// How its files are written.
    pub writer: WriterOptions,
    /// What happens to messages until they are written.
    pub recording: RecordingOptions,
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
            options: RecordOptions::default(),
        }
    }
}

impl RecordOptions {
    /// Returns the reason if the storage cannot contain messages in the encoding.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        let is_refused = self.writer.storage.storage() == Storage::Sqlite3 && self.encoding != Encoding::Cdr;
        is_refused.then(|| {
            let encoding = self.encoding;
            format!("the storage sqlite3 does not support the encoding {encoding}: record as cdr, or in the storage mcap")
        })
    }

    /// Sets how many bytes of messages may wait, to be written or for a snapshot.
    pub fn set_cache_bytes(&mut self, cache_bytes: usize) {
        self.recording.cache_bytes = cache_bytes;
        if let Some(snapshot) = &mut self.recording.snapshot {
            snapshot.max_bytes = cache_bytes;
        }
    }
}

/// The smallest size of a chunk.
const LEAST_CHUNK: i64 = 1024;

pub(super) fn record(value: Value<'_>) -> Result<RecordEntry> {
    let mut table = value.table("[record]")?;
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
    let entry = RecordEntry {
        line,
        topics,
        except: list(&mut table, "except", pattern)?,
        types: list(&mut table, "types", |value| Ok(value.text()?.to_owned()))?,
        modules: list(&mut table, "modules", |value| Ok(value.text()?.to_owned()))?,
        exposed: table.take("exposed").map(|value| value.flag()).transpose()?,
        options: options(&mut table, encoding)?,
    };
    table.finish()?;
    match (encoding, entry.options.refusal()) {
        (Some(value), Some(reason)) => Err(value.error(reason)),
        _ => Ok(entry),
    }
}

fn options(table: &mut Table<'_>, encoding: Option<Value<'_>>) -> Result<RecordOptions> {
    let mut options = RecordOptions::default();
    if let Some(value) = encoding {
        options.encoding = choice(value, &Encoding::ALL.map(|encoding| (encoding.as_str(), encoding)))?;
    }
    let writer = &mut options.writer;
    writer.storage = storage(table)?;
    writer.split.max_bytes = table.take("max_bag_size").map(bytes).transpose()?;
    writer.split.max_duration = table.take("max_bag_duration").map(|value| value.duration()).transpose()?;
    if let Some(value) = table.take("max_bag_files") {
        writer.max_bag_files = NonZeroUsize::new(value.count()? as usize);
    }
    if let Some(value) = table.take("disk_full") {
        writer.disk_full = choice(value, &[("stop", WhenDiskFull::Stop), ("drop", WhenDiskFull::Drop)])?;
    }
    if let Some(value) = table.take("sync") {
        let policies =
            [("never", SyncPolicy::Never), ("files", SyncPolicy::Files), ("chunks", SyncPolicy::Chunks)];
        writer.sync = choice(value, &policies)?;
    }
    if let Some(value) = table.take("slow_disk") {
        options.recording.when_slow = choice(value, &[("stop", WhenSlow::Stop), ("drop", WhenSlow::Drop)])?;
    }
    if let Some(value) = table.take("max_cache_size") {
        options.recording.cache_bytes = bytes(value)?;
    }
    if let Some(value) = table.take("snapshot") {
        let max_bytes = options.recording.cache_bytes;
        options.recording.snapshot =
            Some(SnapshotLimits { max_bytes, max_duration: Some(value.duration()?) });
    }
    Ok(options)
}

/// Reads `storage`, `preset` and the keys that override a preset.
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

fn bytes<N: TryFrom<i64>>(value: Value<'_>) -> Result<N> {
    value.number_in(LEAST_CHUNK..=i64::MAX, "a number of bytes, 1024 or more")
}

/// Reads a name or a valid pattern.
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
