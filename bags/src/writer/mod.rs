//! Writing of a bag: the recorder without its thread.

mod chunk;
mod error;
mod file;
mod options;
mod records;
mod summary;

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::metadata::{self, FileMetadata, Metadata, RecordedQos, TopicMetadata};
use crate::summary::{RecordingSummary, TopicCount};
use crate::topic::{TopicId, TopicInfo};

pub use error::WriterError;
use file::ChunkedFile;
pub use options::{Compression, WriterOptions};

/// Writes one bag directory.
///
/// Messages are collected in a chunk, which is handed to the operating system when it is full or
/// [`WriterOptions::flush_interval`] old. A process that is killed loses the open chunk and nothing else; a reader
/// says so. metadata.yaml is kept up to date on the way, so that a killed bag opens in other programs too.
///
/// After a failed write ([`WriterError::Write`], reported once) the file is ended after its last complete chunk, and
/// everything but [`Writer::finish`] returns [`WriterError::Stopped`]. Dropping a writer finishes it and logs what
/// fails then.
pub struct Writer {
    directory: PathBuf,
    options: WriterOptions,
    file: ChunkedFile,
    topics: Vec<Topic>,
    /// Of the messages in finished chunks.
    written: Times,
    /// Of the messages in the open chunk.
    open: Times,
    /// When the first message came into the open chunk.
    open_since: Option<Instant>,
    /// When metadata.yaml was last written, and whether it knows all topics.
    metadata_written: Instant,
    metadata_has_all_topics: bool,
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
    /// Messages in a chunk that could not be written.
    lost: u64,
}

/// The shortest time between two updates of metadata.yaml while recording.
const METADATA_INTERVAL: Duration = Duration::from_secs(1);

impl Writer {
    /// The bag directory.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.directory
    }

    /// The topics in the order in which they were added: [`TopicId`] is the position.
    pub fn topics(&self) -> impl ExactSizeIterator<Item = &TopicInfo> {
        self.topics.iter().map(|topic| &topic.info)
    }

    /// Adds a topic. Adding it again with the same type returns the id it has.
    ///
    /// # Errors
    /// If the bag has the topic with another type, or recording has stopped.
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
        let channel = self.file.add_topic(&info).map_err(|source| self.fail(source))?;
        self.topics.push(Topic { info, channel, written: 0, open: 0, lost: 0 });
        self.metadata_has_all_topics = false;
        Ok(id)
    }

    /// Writes a message: its data is the CDR bytes with their encapsulation header; `log_time` is when it was
    /// received, `publish_time` when it was sent, both in nanoseconds since the epoch.
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

    /// Notes something in the `custom_data` of the metadata. It is in the bag from the next flush on.
    pub fn set_custom_data(&mut self, key: impl Into<String>, value: impl Into<String>) {
        self.options.custom_data.insert(key.into(), value.into());
    }

    /// What has been handed to the operating system so far: the open chunk does not count.
    #[must_use]
    pub fn summary(&self) -> RecordingSummary {
        RecordingSummary {
            path: self.directory.clone(),
            bytes: self.file.kept(),
            starting_time: self.written.first(),
            duration: self.written.duration(),
            topics: self
                .topics
                .iter()
                .map(|topic| TopicCount {
                    name: topic.info.name.clone(),
                    type_name: topic.info.type_name.clone(),
                    written: topic.written,
                    lost: topic.lost,
                })
                .collect(),
        }
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
        let mut file_name = name.to_owned();
        file_name.push("_0.mcap");
        options::create_directory(directory)?;

        let path = directory.join(file_name);
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| WriterError::Create { path, source }
        };
        let file = ChunkedFile::create(&path, options.compression).map_err(failed(&path))?;
        let mut writer = Self {
            directory: directory.to_owned(),
            options,
            file,
            topics: Vec::new(),
            written: Times::default(),
            open: Times::default(),
            open_since: None,
            metadata_written: Instant::now(),
            metadata_has_all_topics: true,
            state: State::Recording,
        };
        let metadata = writer.metadata();
        writer
            .file
            .write_metadata(metadata.to_record())
            .and_then(|()| writer.file.flush())
            .map_err(failed(&path))?;
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
        let Some(entry) = self.topics.get_mut(topic.index()) else {
            return Err(WriterError::UnknownTopic { index: topic.index(), topics });
        };
        let unsigned = |time: i64| {
            u64::try_from(time)
                .map_err(|_| WriterError::NegativeTime { topic: entry.info.name.clone(), time })
        };
        let (log, publish) = (unsigned(log_time)?, unsigned(publish_time)?);
        let written = self.file.write(entry.channel, log, publish, data);
        entry.open += 1;
        written.map_err(|source| self.fail(source))?;

        self.open.include(log_time);
        let since = *self.open_since.get_or_insert(now);
        let is_due = now.saturating_duration_since(since) >= self.options.flush_interval;
        if is_due || self.file.open_bytes() >= self.options.chunk_size {
            self.flush_at(now)?;
        }
        Ok(())
    }

    fn flush_at(&mut self, now: Instant) -> Result<(), WriterError> {
        self.check_recording()?;
        // A chunk of topics without messages can wait: readers sort chunks by the times of their messages.
        if self.open_since.is_some() {
            self.file.flush().map_err(|source| self.fail(source))?;
            self.count_open_chunk();
        }
        let is_stale = now.saturating_duration_since(self.metadata_written) >= METADATA_INTERVAL;
        if is_stale || !self.metadata_has_all_topics {
            self.metadata().replace_in(&self.directory).map_err(|source| self.fail(source))?;
            self.metadata_written = now;
            self.metadata_has_all_topics = true;
        }
        Ok(())
    }

    fn count_open_chunk(&mut self) {
        for topic in &mut self.topics {
            topic.written += std::mem::take(&mut topic.open);
        }
        self.written.merge(std::mem::take(&mut self.open));
        self.open_since = None;
    }

    fn close(&mut self) -> Result<(), WriterError> {
        match std::mem::replace(&mut self.state, State::Closed) {
            State::Recording => {}
            State::Stopped | State::Closed => return Ok(()),
        }
        self.file.flush().map_err(|source| self.fail(source))?;
        self.count_open_chunk();
        let metadata = self.metadata();
        self.file
            .write_metadata(metadata.to_record())
            .and_then(|()| self.file.finish())
            .and_then(|()| metadata.replace_in(&self.directory))
            .map_err(|source| self.fail(source))?;
        self.state = State::Closed;
        Ok(())
    }

    /// Keeps what is complete, and makes the error to report.
    fn fail(&mut self, source: std::io::Error) -> WriterError {
        self.state = State::Stopped;
        self.open = Times::default();
        for topic in &mut self.topics {
            topic.lost += std::mem::take(&mut topic.open);
        }
        // These two fail for the reason that is being reported; the bag is readable without them.
        let _ = self.file.give_up();
        let _ = self.metadata().replace_in(&self.directory);
        let kept = self.topics.iter().map(|topic| topic.written).sum();
        WriterError::Write { path: self.file.path().to_owned(), source, kept }
    }

    fn check_recording(&self) -> Result<(), WriterError> {
        match self.state {
            State::Recording => Ok(()),
            State::Stopped | State::Closed => Err(WriterError::Stopped { path: self.directory.clone() }),
        }
    }

    fn metadata(&self) -> Metadata {
        let message_count = self.topics.iter().map(|topic| topic.written).sum();
        let path = self.file.path().file_name().unwrap_or_default().to_string_lossy().into_owned();
        let starting_time = self.written.first().unwrap_or(metadata::NEVER);
        let duration = self.written.duration();
        Metadata {
            version: metadata::FORMAT_VERSION,
            storage_identifier: "mcap".to_owned(),
            duration,
            starting_time,
            message_count,
            topics: self
                .topics
                .iter()
                .map(|topic| TopicMetadata {
                    name: topic.info.name.clone(),
                    type_name: topic.info.type_name.clone(),
                    serialization_format: topic.info.message_encoding().to_owned(),
                    offered_qos: topic.info.offered_qos.iter().map(RecordedQos::from).collect(),
                    type_hash: topic.info.type_hash.clone(),
                    message_count: topic.written,
                })
                .collect(),
            compression_format: String::new(),
            compression_mode: String::new(),
            relative_file_paths: vec![path.clone()],
            files: vec![FileMetadata { path, starting_time, duration, message_count }],
            custom_data: self.options.custom_data.clone(),
            ros_distro: "jazzy".to_owned(),
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

/// The first and the last of some times, in nanoseconds since the epoch.
#[derive(Clone, Copy, Default)]
struct Times(Option<(i64, i64)>);

impl Times {
    fn include(&mut self, time: i64) {
        self.merge(Self(Some((time, time))));
    }

    fn merge(&mut self, other: Self) {
        self.0 = match (self.0, other.0) {
            (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
            (one, None) | (None, one) => one,
        };
    }

    fn first(self) -> Option<i64> {
        self.0.map(|(first, _)| first)
    }

    fn duration(self) -> Duration {
        self.0.map_or(Duration::ZERO, |(first, last)| Duration::from_nanos(last.abs_diff(first)))
    }
}

#[cfg(test)]
mod tests;
