//! Writes a bag: the recorder without its thread.

mod channels;
mod chunk;
mod error;
mod file;
mod free_space;
mod hand_over;
mod latched;
mod layout;
mod options;
mod output;
mod records;
mod split;
#[cfg(feature = "sqlite")]
mod sqlite;
mod storage;
mod summary;
mod sync;
mod times;
mod totals;

use std::collections::{HashMap, VecDeque};
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::metadata;
use crate::storage::Storage;
use crate::topic::{RecordingSummary, TopicDescription, TopicId};
pub use error::WriterError;
pub use free_space::WhenLow;
use latched::Latched;
pub use layout::{StorageError, StorageOptions};
pub use options::{SplitLimits, WhenDiskFull, WriterOptions};
pub use split::FileSplit;
use split::{BagFile, SplitHandler, WrittenFile};
#[cfg(feature = "sqlite")]
pub use sqlite::{SqliteOptions, SqlitePreset};
pub use storage::{Compression, CompressionLevel, McapOptions, StorageConfigError, StoragePreset};
pub use sync::SyncPolicy;
use times::Times;

/// Writes one bag directory.
///
/// Messages are collected in a chunk, which is passed to the operating system when it is full or
/// [`WriterOptions::flush_interval`] old. A killed process loses only the open chunk, which readers report.
/// metadata.yaml is updated during recording, so that other programs can open the bag as well.
///
/// With the storage `sqlite3`, a chunk is a transaction. After a kill, committed transactions are partly in a
/// log beside the file (`-wal`), which SQLite reads with it; only rosbag2's preset `none`, which has no log,
/// may leave a damaged file. Messages have only one time there: publish times are not stored.
///
/// After a failed write ([`WriterError::Write`], reported once), the file is finished after its last complete
/// chunk, and all methods except [`Writer::finish`] return [`WriterError::Stopped`]. Dropping a writer
/// finishes it and logs errors.
pub struct Writer {
    directory: PathBuf,
    /// The prefix of the file names.
    name: OsString,
    options: WriterOptions,
    /// The chunk size of the storage, cached.
    chunk_size: u64,
    file: BagFile,
    /// The files of the bag; the last one is being written.
    files: VecDeque<WrittenFile>,
    /// The number of the next file.
    next_number: u64,
    topics: Vec<Topic>,
    /// The positions of topics by their names.
    by_name: HashMap<String, usize>,
    /// The times of the messages in the open chunk.
    open: Times,
    /// When the first message was added to the open chunk.
    open_since: Option<Instant>,
    /// When metadata.yaml was last written, and whether it contains all topics.
    metadata_written: Instant,
    metadata_has_all_topics: bool,
    /// The time until the next update of metadata.yaml: of ten thousands of topics, one takes a second.
    metadata_interval: Duration,
    /// The size of the messages that later files repeat.
    latched_bytes: u64,
    /// The number of messages in deleted files.
    deleted: u64,
    /// Whether the last chunk was dropped because the disk was full.
    is_disk_full: bool,
    on_split: Option<SplitHandler>,
    /// The number of changes of [`Writer::summary`].
    changes: u64,
    state: State,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    Recording,
    Stopped,
    Closed,
}

struct Topic {
    info: TopicDescription,
    channel: u16,
    /// Messages in finished chunks.
    written: u64,
    /// Messages in the open chunk.
    open: u64,
    /// Messages in chunks that could not be written.
    lost: u64,
    /// Messages rejected before they reached the writer.
    refused: u64,
    /// What later files repeat, if they repeat messages of this topic.
    latched: Option<Latched>,
}

/// The shortest time between two updates of metadata.yaml while recording.
const METADATA_INTERVAL: Duration = Duration::from_secs(1);

impl Writer {
    /// The bag directory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.directory
    }

    /// The storage.
    #[must_use]
    pub fn storage(&self) -> Storage {
        self.options.storage.storage()
    }

    /// The topics in the order in which they were added: [`TopicId`] is the position.
    pub fn topics(&self) -> impl ExactSizeIterator<Item = &TopicDescription> {
        self.topics.iter().map(|topic| &topic.info)
    }

    /// Adds a topic. Adding it again with the same type returns the existing id.
    ///
    /// # Errors
    /// Returns an error if the bag contains the topic with another type, the storage cannot represent the
    /// topic, or recording has stopped.
    pub fn add_topic(&mut self, info: TopicDescription) -> Result<TopicId, WriterError> {
        self.check_recording()?;
        if let Some(&index) = self.by_name.get(&info.name) {
            let first = &self.topics[index].info.type_name;
            if *first != info.type_name {
                return Err(WriterError::TypeConflict {
                    topic: info.name,
                    first: first.clone(),
                    second: info.type_name,
                });
            }
            return TopicId::from_index(index).ok_or(WriterError::TooManyTopics { topic: info.name });
        }
        let id = TopicId::from_index(self.topics.len()).filter(|id| id.index() < usize::from(u16::MAX) - 1);
        let Some(id) = id else {
            return Err(WriterError::TooManyTopics { topic: info.name });
        };
        if let Some(found) = self.file.refusal(&info) {
            return Err(WriterError::NoPlace { topic: info.name, storage: self.storage(), found });
        }
        let channel =
            self.file.add_topic(&info, self.options.metadata_version).map_err(|source| self.fail(source))?;
        self.by_name.insert(info.name.clone(), id.index());
        let depth = if self.options.repeats_latched { info.latched_depth() } else { 0 };
        let latched = (depth > 0).then(|| Latched::new(depth));
        self.topics.push(Topic { info, channel, written: 0, open: 0, lost: 0, refused: 0, latched });
        self.metadata_has_all_topics = false;
        self.changes += 1;
        Ok(id)
    }

    /// Writes a message: its data is the CDR bytes with their encapsulation header; `log_time` is the receive
    /// time, `publish_time` the send time, both in nanoseconds since the epoch. `sqlite3` stores `log_time`
    /// only.
    ///
    /// # Errors
    /// Returns an error if the topic does not belong to this writer, a time is negative, writing fails, or
    /// recording has stopped.
    pub fn write(
        &mut self,
        topic: TopicId,
        log_time: i64,
        publish_time: i64,
        data: &[u8],
    ) -> Result<(), WriterError> {
        self.write_at(Instant::now(), topic, log_time, publish_time, data)
    }

    /// Passes the open chunk to the operating system now.
    ///
    /// # Errors
    /// Returns an error if writing fails, or recording has stopped.
    pub fn flush(&mut self) -> Result<(), WriterError> {
        self.flush_at(Instant::now())
    }

    /// Passes the open chunk to the operating system if it is older than the flush interval. Returns how long
    /// the open chunk may still wait, `None` if there is none, as a time-out for waiting threads.
    ///
    /// # Errors
    /// Returns an error if writing fails, or recording has stopped.
    pub fn flush_if_due(&mut self) -> Result<Option<Duration>, WriterError> {
        let now = Instant::now();
        let Some(since) = self.open_since else { return Ok(None) };
        let left = self.options.flush_interval.saturating_sub(now.saturating_duration_since(since));
        if left.is_zero() {
            self.flush_at(now)?;
            return Ok(None);
        }
        Ok(Some(left))
    }

    /// Continues in a new file.
    ///
    /// # Errors
    /// Returns an error if the new file cannot be created, writing fails, or recording has stopped.
    pub fn split(&mut self) -> Result<FileSplit, WriterError> {
        self.split_at(Instant::now())
    }

    /// Registers a handler that is called after each finished file, including the last one. Replaces the
    /// previous handler.
    pub fn on_split(&mut self, handler: impl FnMut(&FileSplit) + Send + 'static) {
        self.on_split = Some(Box::new(handler));
    }

    /// Sets an entry in the `custom_data` of the metadata. It is written with the next flush.
    pub fn set_custom_data(&mut self, key: impl Into<String>, value: impl Into<String>) {
        self.options.custom_data.insert(key.into(), value.into());
    }

    /// Sets the total number of messages of a topic that were rejected before they reached this writer;
    /// `custom_data` lists them with those lost by the writer. Returns false if there is no such topic.
    pub fn set_refused(&mut self, topic: TopicId, messages: u64) -> bool {
        let found = self.topics.get_mut(topic.index());
        found.map(|topic| topic.refused = messages).is_some()
    }

    /// Returns whether the last chunk was dropped because the disk was full ([`WhenDiskFull::Drop`]).
    #[must_use]
    pub fn is_disk_full(&self) -> bool {
        self.is_disk_full
    }

    /// Finishes the bag and syncs it to disk. After a failed write, which was already reported, returns the
    /// summary of what was recorded.
    ///
    /// # Errors
    /// Returns an error if writing the end fails; messages written before are kept.
    pub fn finish(mut self) -> Result<RecordingSummary, WriterError> {
        self.close()?;
        Ok(self.summary())
    }

    pub(crate) fn create(directory: &Path, options: WriterOptions) -> Result<Self, WriterError> {
        let Some(name) = directory.file_name() else {
            return Err(WriterError::Unnamed { path: directory.to_owned() });
        };
        if name.to_str().is_none() {
            // metadata.yaml could not name its files.
            let source = io::Error::new(io::ErrorKind::InvalidInput, "its name is not UTF-8; choose another");
            return Err(WriterError::Create { path: directory.to_owned(), source });
        }
        options::create_directory(directory)?;

        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| WriterError::Create { path, source }
        };
        let path = split::path(directory, name, 0, options.storage.storage());
        let file = BagFile::create(&path, &options).map_err(failed(&path))?;
        let mut writer = Self {
            directory: directory.to_owned(),
            name: name.to_owned(),
            chunk_size: options.storage.chunk_size(),
            options,
            files: VecDeque::from([WrittenFile::new(&path)]),
            file,
            next_number: 1,
            topics: Vec::new(),
            by_name: HashMap::new(),
            open: Times::default(),
            open_since: None,
            metadata_written: Instant::now(),
            metadata_has_all_topics: true,
            metadata_interval: METADATA_INTERVAL,
            latched_bytes: 0,
            deleted: 0,
            is_disk_full: false,
            on_split: None,
            changes: 0,
            state: State::Recording,
        };
        let metadata = writer.metadata();
        writer.file.write_metadata(metadata.to_record()).map_err(failed(&path))?;
        metadata.replace_in(directory).map_err(failed(&directory.join(metadata::FILE_NAME)))?;
        Ok(writer)
    }

    fn write_at(
        &mut self,
        now: Instant,
        topic: TopicId,
        log_time: i64,
        publish_time: i64,
        data: &[u8],
    ) -> Result<(), WriterError> {
        self.check_recording()?;
        let topics = self.topics.len();
        let Some(entry) = self.topics.get(topic.index()) else {
            return Err(WriterError::UnknownTopic { index: topic.index(), topics });
        };
        let unsigned = |time: i64| {
            u64::try_from(time)
                .map_err(|_| WriterError::NegativeTime { topic: entry.info.name.clone(), time })
        };
        let (log, publish) = (unsigned(log_time)?, unsigned(publish_time)?);
        if self.is_split_due(log_time) {
            self.split_at(now)?;
        }
        let Some(entry) = self.topics.get_mut(topic.index()) else { return Ok(()) };
        let written = self.file.write(entry.channel, log, publish, data);
        entry.open += 1;
        if let Some(file) = self.files.back_mut() {
            file.has_own = true;
        }
        let is_latched = entry.latched.is_some();
        let open_bytes = written.map_err(|source| self.fail(source))?;
        if is_latched {
            self.keep_latched(topic.index(), publish_time, data);
        }

        self.open.include(log_time);
        let since = *self.open_since.get_or_insert(now);
        let is_due = now.saturating_duration_since(since) >= self.options.flush_interval;
        if is_due || open_bytes >= self.chunk_size {
            self.flush_at(now)?;
        }
        Ok(())
    }

    fn flush_at(&mut self, now: Instant) -> Result<(), WriterError> {
        self.check_recording()?;
        self.hand_over()?;
        let is_stale = now.saturating_duration_since(self.metadata_written) >= self.metadata_interval;
        if is_stale || !self.metadata_has_all_topics {
            self.replace_metadata(now)?;
        }
        self.guard_free_space(now)
    }

    fn close(&mut self) -> Result<(), WriterError> {
        match std::mem::replace(&mut self.state, State::Closed) {
            State::Recording => {}
            State::Stopped | State::Closed => return Ok(()),
        }
        self.hand_over()?;
        let metadata = self.metadata();
        self.file
            .write_metadata(metadata.to_record())
            .and_then(|()| self.file.finish())
            .and_then(|()| metadata.replace_in(&self.directory))
            .map_err(|source| self.fail(source))?;
        self.state = State::Closed;
        self.tell_split(&FileSplit { closed: self.file.path().to_owned(), opened: None });
        Ok(())
    }

    /// Keeps complete chunks, and creates the error to report.
    fn fail(&mut self, source: io::Error) -> WriterError {
        self.state = State::Stopped;
        self.lose_open_chunk();
        // These fail for the same reason; the bag is readable without them.
        let _ = self.file.give_up();
        let metadata = self.metadata();
        let _ = metadata.replace_in(&self.directory).or_else(|_| metadata.overwrite_in(&self.directory));
        let kept = self.topics.iter().map(|topic| topic.written).sum();
        WriterError::Write { path: self.file.path().to_owned(), source, kept }
    }

    fn check_recording(&self) -> Result<(), WriterError> {
        match self.state {
            State::Recording => Ok(()),
            State::Stopped | State::Closed => Err(WriterError::Stopped { path: self.directory.clone() }),
        }
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        if let Err(error) = self.close() {
            tracing::error!("{error}");
        }
    }
}

#[cfg(test)]
mod tests;
