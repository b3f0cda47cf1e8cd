//! Writing of a bag: the recorder without its thread.

mod bag_file;
mod channels;
mod chunk;
mod compress;
mod describe;
mod error;
mod file;
mod hand_over;
mod layout;
mod options;
mod output;
mod records;
mod split;
#[cfg(feature = "sqlite")]
mod sqlite;
mod storage;
mod summary;
mod times;

use std::collections::VecDeque;
use std::ffi::OsString;
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::metadata;
use crate::storage::Storage;
use crate::summary::RecordingSummary;
use crate::topic::{TopicId, TopicInfo};

use bag_file::BagFile;
pub use error::WriterError;
pub use layout::{StorageError, StorageOptions};
pub use options::{SplitLimits, SyncPolicy, WhenDiskFull, WriterOptions};
pub use split::FileSplit;
use split::{SplitHandler, WrittenFile};
#[cfg(feature = "sqlite")]
pub use sqlite::{SqliteOptions, SqlitePreset};
pub use storage::{Compression, CompressionLevel, McapOptions, StorageConfigError, StoragePreset};
use times::Times;

/// Writes one bag directory.
///
/// Messages are collected in a chunk, which is handed to the operating system when it is full or
/// [`WriterOptions::flush_interval`] old. A process that is killed loses the open chunk and nothing else; a reader
/// says so. metadata.yaml is kept up to date on the way, so that a killed bag opens in other programs too.
///
/// With the storage `sqlite3` a chunk is a transaction. What a killed process has committed is partly in a log beside the file
/// (`-wal`), with which SQLite reads it; only the preset `none` of rosbag2, which has no log, may leave a damaged file. A message has
/// one time there: its publish time is not kept.
///
/// After a failed write ([`WriterError::Write`], reported once) the file is ended after its last complete chunk, and
/// everything but [`Writer::finish`] returns [`WriterError::Stopped`]. Dropping a writer finishes it and logs what
/// fails then.
pub struct Writer {
    directory: PathBuf,
    /// What the names of the files begin with.
    name: OsString,
    options: WriterOptions,
    /// That of the storage, at hand for each message.
    chunk_size: u64,
    file: BagFile,
    /// The files of the bag; the last is the one that is written.
    files: VecDeque<WrittenFile>,
    /// The number of the next file.
    next_number: u64,
    topics: Vec<Topic>,
    /// Of the messages in the open chunk.
    open: Times,
    /// When the first message came into the open chunk.
    open_since: Option<Instant>,
    /// When metadata.yaml was last written, and whether it knows all topics.
    metadata_written: Instant,
    metadata_has_all_topics: bool,
    /// Messages in files that were deleted.
    deleted: u64,
    /// Whether the last chunk found no room.
    is_disk_full: bool,
    on_split: Option<SplitHandler>,
    /// How often what [`Writer::summary`] tells has changed.
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
    info: TopicInfo,
    channel: u16,
    /// Messages in finished chunks.
    written: u64,
    /// Messages in the open chunk.
    open: u64,
    /// Messages in chunks that could not be written.
    lost: u64,
    /// Messages that were refused before they reached the writer.
    refused: u64,
}

/// The shortest time between two updates of metadata.yaml while recording.
const METADATA_INTERVAL: Duration = Duration::from_secs(1);

impl Writer {
    /// The bag directory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.directory
    }

    /// The storage that is written.
    #[must_use]
    pub fn storage(&self) -> Storage {
        self.options.storage.storage()
    }

    /// The topics in the order in which they were added: [`TopicId`] is the position.
    pub fn topics(&self) -> impl ExactSizeIterator<Item = &TopicInfo> {
        self.topics.iter().map(|topic| &topic.info)
    }

    /// Adds a topic. Adding it again with the same type returns the id it has.
    ///
    /// # Errors
    /// If the bag has the topic with another type, its storage no place for what describes the topic, or recording has stopped.
    pub fn add_topic(&mut self, info: TopicInfo) -> Result<TopicId, WriterError> {
        self.check_recording()?;
        if let Some(index) = self.topics.iter().position(|topic| topic.info.name == info.name) {
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
        let channel = self.file.add_topic(&info).map_err(|source| self.fail(source))?;
        self.topics.push(Topic { info, channel, written: 0, open: 0, lost: 0, refused: 0 });
        self.metadata_has_all_topics = false;
        self.changes += 1;
        Ok(id)
    }

    /// Writes a message: its data is the CDR bytes with their encapsulation header; `log_time` is when it was
    /// received, `publish_time` when it was sent, both in nanoseconds since the epoch. `sqlite3` keeps `log_time` only.
    ///
    /// # Errors
    /// If the topic is not of this writer, a time is negative, writing fails, or recording has stopped.
    pub fn write(
        &mut self,
        topic: TopicId,
        log_time: i64,
        publish_time: i64,
        data: &[u8],
    ) -> Result<(), WriterError> {
        self.write_at(Instant::now(), topic, log_time, publish_time, data)
    }

    /// Hands the open chunk to the operating system now.
    ///
    /// # Errors
    /// If writing fails, or recording has stopped.
    pub fn flush(&mut self) -> Result<(), WriterError> {
        self.flush_at(Instant::now())
    }

    /// Hands the open chunk to the operating system if it is older than the flush interval. Returns how long the open
    /// chunk may still wait, `None` if there is none: for a thread that waits for messages.
    ///
    /// # Errors
    /// If writing fails, or recording has stopped.
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

    /// Goes on in a new file.
    ///
    /// # Errors
    /// If the new file cannot be created, writing fails, or recording has stopped.
    pub fn split(&mut self) -> Result<FileSplit, WriterError> {
        self.split_at(Instant::now())
    }

    /// Has `handler` called after each file that was ended, the last one too. It replaces the one before.
    pub fn on_split(&mut self, handler: impl FnMut(&FileSplit) + Send + 'static) {
        self.on_split = Some(Box::new(handler));
    }

    /// Notes something in the `custom_data` of the metadata. It is in the bag from the next flush on.
    pub fn set_custom_data(&mut self, key: impl Into<String>, value: impl Into<String>) {
        self.options.custom_data.insert(key.into(), value.into());
    }

    /// Notes how many messages of a topic were refused in all before they reached this writer: they are told in
    /// `custom_data` with those that it lost itself. False where it has no such topic.
    pub fn set_refused(&mut self, topic: TopicId, messages: u64) -> bool {
        let found = self.topics.get_mut(topic.index());
        found.map(|topic| topic.refused = messages).is_some()
    }

    /// Whether there was no room for the last chunk, and it was given up ([`WhenDiskFull::Drop`]).
    #[must_use]
    pub fn is_disk_full(&self) -> bool {
        self.is_disk_full
    }

    /// Ends the bag and waits until the medium has it. After a failed write, which was reported then, returns what
    /// was kept.
    ///
    /// # Errors
    /// If writing the end fails; what was written before is kept.
    pub fn finish(mut self) -> Result<RecordingSummary, WriterError> {
        self.close()?;
        Ok(self.summary())
    }

    pub(crate) fn create(directory: &Path, options: WriterOptions) -> Result<Self, WriterError> {
        let Some(name) = directory.file_name() else {
            return Err(WriterError::Unnamed { path: directory.to_owned() });
        };
        options::create_directory(directory)?;

        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| WriterError::Create { path, source }
        };
        let path = split::path(directory, name, 0, options.storage.storage());
        let file = BagFile::create(&path, &options.storage, options.sync).map_err(failed(&path))?;
        let mut writer = Self {
            directory: directory.to_owned(),
            name: name.to_owned(),
            chunk_size: options.storage.chunk_size(),
            options,
            files: VecDeque::from([WrittenFile::new(&path)]),
            file,
            next_number: 1,
            topics: Vec::new(),
            open: Times::default(),
            open_since: None,
            metadata_written: Instant::now(),
            metadata_has_all_topics: true,
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
        let open_bytes = written.map_err(|source| self.fail(source))?;

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
        let is_stale = now.saturating_duration_since(self.metadata_written) >= METADATA_INTERVAL;
        if is_stale || !self.metadata_has_all_topics {
            self.replace_metadata(now)?;
        }
        Ok(())
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

    /// Keeps what is complete, and makes the error to report.
    fn fail(&mut self, source: io::Error) -> WriterError {
        self.state = State::Stopped;
        self.lose_open_chunk();
        // These fail for the reason that is being reported; the bag is readable without them.
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
