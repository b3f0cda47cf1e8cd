//! The bag file being written, in either storage.

use std::io;
use std::path::Path;

use super::file::ChunkedFile;
#[cfg(feature = "sqlite")]
use super::sqlite::SqliteFile;
use super::{StorageOptions, SyncPolicy};
use crate::topic::TopicInfo;

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
    pub(super) fn create(path: &Path, storage: &StorageOptions, sync: SyncPolicy) -> io::Result<Self> {
        match storage {
            StorageOptions::Mcap(options) => ChunkedFile::create(path, *options, sync).map(Self::Mcap),
            #[cfg(feature = "sqlite")]
            StorageOptions::Sqlite(options) => SqliteFile::create(path, options, sync).map(Self::Sqlite),
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
    #[cfg_attr(not(feature = "sqlite"), expect(unused_variables, reason = "MCAP can tell all of it"))]
    pub(super) fn refusal(&self, topic: &TopicInfo) -> Option<String> {
        match self {
            Self::Mcap(_) => None,
            #[cfg(feature = "sqlite")]
            Self::Sqlite(_) => SqliteFile::refusal(topic),
        }
    }

    /// Returns the channel of the topic.
    pub(super) fn add_topic(&mut self, topic: &TopicInfo) -> io::Result<u16> {
        of!(self, file => file.add_topic(topic))
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
