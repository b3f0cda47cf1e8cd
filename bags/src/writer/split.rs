//! Bags of several files: when a new file starts, and which are kept.

use std::ffi::OsStr;
use std::io;
use std::path::{Path, PathBuf};
use std::time::Instant;

use super::file::ChunkedFile;
#[cfg(feature = "sqlite")]
use super::sqlite::SqliteFile;
use super::times::Times;
use super::{StorageOptions, Writer, WriterError, WriterOptions};
use crate::storage::Storage;
use crate::topic::TopicDescription;

/// A file of a bag was finished.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FileSplit {
    /// The finished file.
    pub closed: PathBuf,
    /// The next file of the bag; `None` at its end.
    pub opened: Option<PathBuf>,
}

pub(super) type SplitHandler = Box<dyn FnMut(&FileSplit) + Send>;

/// A file of the bag.
pub(super) struct WrittenFile {
    /// Relative to the bag directory.
    pub(super) name: String,
    /// The times of its messages in finished chunks.
    pub(super) times: Times,
    /// The number of these messages by topic; topics added later may be missing.
    pub(super) counts: Vec<u64>,
    /// Its size once it is finished.
    pub(super) bytes: u64,
    /// Whether it has a message that is not repeated from an earlier file.
    pub(super) has_own: bool,
}

impl WrittenFile {
    pub(super) fn new(path: &Path) -> Self {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Self { name, times: Times::default(), counts: Vec::new(), bytes: 0, has_own: false }
    }

    pub(super) fn message_count(&self) -> u64 {
        self.counts.iter().sum()
    }
}

/// The path of a file: `<bag>/<bag>_<number>.mcap`, or `.db3`.
pub(super) fn path(directory: &Path, name: &OsStr, number: u64, storage: Storage) -> PathBuf {
    let mut file_name = name.to_owned();
    file_name.push(format!("_{number}.{}", storage.extension()));
    directory.join(file_name)
}

impl Writer {
    /// Returns whether a message with that time starts a new file. Every file has at least one message.
    pub(super) fn is_split_due(&self, log_time: i64) -> bool {
        let limits = &self.options.split;
        let Some(file) = self.files.back().filter(|file| file.has_own) else { return false };
        let mut times = file.times;
        times.merge(self.open);
        let Some(first) = times.first() else { return false };
        let is_large = limits.max_bytes.is_some_and(|most| self.file.kept() + self.file.open_bytes() >= most);
        let age = u128::try_from(log_time.saturating_sub(first)).unwrap_or(0);
        is_large || limits.max_duration.is_some_and(|most| age > most.as_nanos())
    }

    pub(super) fn split_at(&mut self, now: Instant) -> Result<FileSplit, WriterError> {
        self.check_recording()?;
        self.changes += 1;
        self.hand_over()?;
        // Before finishing the file: on a full disk this makes room for its end.
        let most = self.options.max_bag_files.map_or(usize::MAX, std::num::NonZeroUsize::get);
        self.delete_oldest(most.max(2) - 1, now)?;

        let closed = self.file.path().to_owned();
        let metadata = self.metadata().to_record();
        let ended = self.file.write_metadata(metadata).and_then(|()| self.file.finish());
        match ended {
            Ok(()) => {}
            // Its contents stay readable, and there may be room for the next file.
            Err(source) if self.goes_on_after(&source) => {
                self.file.give_up().map_err(|source| self.fail(source))?;
            }
            Err(source) => return Err(self.fail(source)),
        }
        if let Some(file) = self.files.back_mut() {
            file.bytes = self.file.kept();
        }
        let opened = path(&self.directory, &self.name, self.next_number, self.storage());
        self.file = self.next_file(&opened).map_err(|source| self.fail_to_open(&opened, source))?;
        self.next_number += 1;
        self.files.push_back(WrittenFile::new(&opened));
        let metadata = self.metadata().to_record();
        self.file.write_metadata(metadata).map_err(|source| self.fail(source))?;
        self.repeat_latched()?;
        self.replace_metadata(now)?;
        self.delete_oldest(most, now)?;
        let split = FileSplit { closed, opened: Some(opened) };
        self.tell_split(&split);
        Ok(split)
    }

    pub(super) fn tell_split(&mut self, split: &FileSplit) {
        if let Some(handler) = &mut self.on_split {
            handler(split);
        }
    }

    /// Creates a file with the topics of the bag.
    fn next_file(&mut self, path: &Path) -> std::io::Result<BagFile> {
        let mut file = BagFile::create(path, &self.options)?;
        for topic in &mut self.topics {
            topic.channel = file.add_topic(&topic.info, self.options.metadata_version)?;
        }
        Ok(file)
    }

    /// The previous file is already finished: only removes the new one.
    fn fail_to_open(&mut self, path: &Path, source: std::io::Error) -> WriterError {
        self.state = super::State::Stopped;
        // It may not exist; if it does, the bag would be damaged by it.
        let _ = self.remove_file(path);
        let _ = self.metadata().replace_in(&self.directory);
        let kept = self.topics.iter().map(|topic| topic.written).sum();
        WriterError::Write { path: path.to_owned(), source, kept }
    }

    /// Removes a file and its companions.
    fn remove_file(&self, path: &Path) -> std::io::Result<()> {
        for companion in self.storage().companions(path) {
            // A finished file has none.
            let _ = std::fs::remove_file(companion);
        }
        std::fs::remove_file(path)
    }

    /// Deletes the oldest files until at most that many are left.
    pub(super) fn delete_oldest(&mut self, most: usize, now: Instant) -> Result<(), WriterError> {
        while self.files.len() > most {
            let Some(oldest) = self.files.pop_front() else { return Ok(()) };
            for (topic, count) in self.topics.iter_mut().zip(&oldest.counts) {
                topic.written = topic.written.saturating_sub(*count);
            }
            self.deleted += oldest.message_count();
            // First, so that metadata.yaml never names a missing file.
            self.replace_metadata(now)?;
            let path = self.directory.join(&oldest.name);
            if let Err(error) = self.remove_file(&path) {
                tracing::warn!(
                    "cannot delete {}, which is no longer part of the bag: {error}",
                    path.display()
                );
            }
        }
        Ok(())
    }
}

/// An enum rather than a trait object: it costs one branch per message, and none with MCAP only.
pub(super) enum BagFile {
    Mcap(ChunkedFile),
    #[cfg(feature = "sqlite")]
    Sqlite(SqliteFile),
}

/// Forwards a call to the file of either storage.
macro_rules! of {
    ($bag_file:expr, $file:ident => $result:expr) => {
        match $bag_file {
            BagFile::Mcap($file) => $result,
            #[cfg(feature = "sqlite")]
            BagFile::Sqlite($file) => $result,
        }
    };
}

impl BagFile {
    pub(super) fn create(path: &Path, options: &WriterOptions) -> io::Result<Self> {
        let sync = options.sync;
        match &options.storage {
            StorageOptions::Mcap(storage) => ChunkedFile::create(path, *storage, sync).map(Self::Mcap),
            #[cfg(feature = "sqlite")]
            StorageOptions::Sqlite(storage) => {
                SqliteFile::create(path, storage, sync, &options.ros_distro).map(Self::Sqlite)
            }
        }
    }

    pub(super) fn path(&self) -> &Path {
        of!(self, file => file.path())
    }

    /// The readable bytes in the file.
    pub(super) fn kept(&self) -> u64 {
        of!(self, file => file.kept())
    }

    /// Size of the open chunk, before compression.
    pub(super) fn open_bytes(&self) -> u64 {
        of!(self, file => file.open_bytes())
    }

    /// Why the file cannot represent the topic, if so.
    #[cfg_attr(not(feature = "sqlite"), expect(unused_variables, reason = "MCAP supports all of it"))]
    pub(super) fn refusal(&self, topic: &TopicDescription) -> Option<String> {
        match self {
            Self::Mcap(_) => None,
            #[cfg(feature = "sqlite")]
            Self::Sqlite(_) => SqliteFile::refusal(topic),
        }
    }

    /// Returns the channel of the topic.
    pub(super) fn add_topic(&mut self, topic: &TopicDescription, metadata_version: u32) -> io::Result<u16> {
        of!(self, file => file.add_topic(topic, metadata_version))
    }

    /// Adds a message to the open chunk. Returns the size of the chunk, before compression.
    pub(super) fn write(
        &mut self,
        channel: u16,
        log_time: u64,
        publish_time: u64,
        data: &[u8],
    ) -> io::Result<u64> {
        match self {
            Self::Mcap(file) => {
                file.write(channel, log_time, publish_time, data)?;
                Ok(file.open_bytes())
            }
            #[cfg(feature = "sqlite")]
            Self::Sqlite(file) => {
                file.write(channel, log_time, data);
                Ok(file.open_bytes())
            }
        }
    }

    /// Writes a message of an earlier file again, with its times of receiving and sending.
    pub(super) fn repeat(&mut self, channel: u16, times: (u64, u64), data: &[u8]) -> io::Result<()> {
        match self {
            Self::Mcap(file) => file.repeat(channel, times, data),
            #[cfg(feature = "sqlite")]
            Self::Sqlite(file) => {
                file.write(channel, times.0, data);
                Ok(())
            }
        }
    }

    /// Ends the open chunk and passes it to the operating system. If that fails, the chunk is still open.
    pub(super) fn flush(&mut self) -> io::Result<()> {
        of!(self, file => file.flush())
    }

    /// Drops the open chunk after a failed flush.
    pub(super) fn drop_chunk(&mut self) -> io::Result<()> {
        of!(self, file => file.drop_chunk())
    }

    /// Writes rosbag2's metadata record, after the open chunk.
    pub(super) fn write_metadata(&mut self, text: String) -> io::Result<()> {
        of!(self, file => file.write_metadata(text))
    }

    /// Finishes the file and syncs it to disk, unless the policy is not to.
    pub(super) fn finish(&mut self) -> io::Result<()> {
        of!(self, file => file.finish())
    }

    /// After a failed write: finishes the file after its last chunk, in the remaining room.
    pub(super) fn give_up(&mut self) -> io::Result<()> {
        of!(self, file => file.give_up())
    }
}
