//! Errors of recording.

use std::io;
use std::path::PathBuf;

/// Why a bag could not be created, or why recording stopped.
#[derive(Debug, thiserror::Error)]
pub enum WriterError {
    /// The path exists already.
    #[error("cannot record into {}: it exists already; choose another name, or remove it first", path.display())]
    AlreadyExists {
        /// The directory to create.
        path: PathBuf,
    },
    /// The path has no last component to name the bag after.
    #[error("cannot record into {}: the path does not end in a name for the bag", path.display())]
    Unnamed {
        /// The given path.
        path: PathBuf,
    },
    /// The maximum file size is too small.
    #[error("cannot split a bag into files of {bytes} bytes: the minimum is {least}")]
    SplitSize {
        /// The requested size.
        bytes: u64,
        /// The minimum of the storage.
        least: u64,
    },
    /// The storage options are not supported.
    #[error(transparent)]
    Storage(#[from] super::StorageError),
    /// The directory or a first file in it could not be created.
    #[error("cannot create {}: {source}", path.display())]
    Create {
        /// The directory or file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// Writing failed (disk full, disk removed). Recording has stopped; the messages written before are
    /// readable.
    #[error(
        "cannot write to {}: {source}; recording has stopped, the {kept} messages written before are kept",
        path.display()
    )]
    Write {
        /// The file.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
        /// The number of readable messages in the bag.
        kept: u64,
    },
    /// Too little of the disk is free ([`WriterOptions::keep_free`](super::WriterOptions::keep_free)).
    /// Recording has stopped; the bag is complete up to there.
    #[error(
        "cannot go on recording into {}: {free} bytes of the disk are free, of {keep} to keep free; recording has \
         stopped, the {kept} messages written before are kept; free some space, or record elsewhere",
        path.display()
    )]
    LowSpace {
        /// The bag directory.
        path: PathBuf,
        /// The free bytes.
        free: u64,
        /// How many are to stay free.
        keep: u64,
        /// The number of messages in the bag.
        kept: u64,
    },
    /// [`WhenLow::DropOldest`](super::WhenLow::DropOldest) needs a bag of several files.
    #[error(
        "cannot record into {}: its oldest files cannot be dropped, because it is one file: also set max_bag_size or \
         max_bag_duration",
        path.display()
    )]
    NothingToDrop {
        /// The bag directory.
        path: PathBuf,
    },
    /// Messages arrived faster than they could be written, and recording stops in this case
    /// ([`WhenSlow::Stop`](crate::WhenSlow::Stop)). Earlier messages are kept.
    #[error(
        "cannot keep up with recording into {}: {cache_bytes} bytes are queued; recording has stopped, earlier messages are kept",
        path.display()
    )]
    TooSlow {
        /// The bag directory.
        path: PathBuf,
        /// The capacity of the queue.
        cache_bytes: usize,
    },
    /// Recording has stopped, for the reason that an earlier error contains.
    #[error("cannot record into {}: recording has stopped", path.display())]
    Stopped {
        /// The bag directory.
        path: PathBuf,
    },
    /// A topic has one type.
    #[error("cannot record topic {topic} with type {second}: this bag has it with type {first}")]
    TypeConflict {
        /// The topic.
        topic: String,
        /// The type it was added with.
        first: String,
        /// The type of the second attempt.
        second: String,
    },
    /// The tables of `sqlite3` cannot represent everything in an MCAP channel.
    #[error("cannot record topic {topic} in the storage {storage}: {found}; record it in the storage mcap")]
    NoPlace {
        /// The topic to add.
        topic: String,
        /// The storage.
        storage: crate::storage::Storage,
        /// The unsupported property.
        found: String,
    },
    /// MCAP numbers channels with 16 bits.
    #[error("cannot record topic {topic}: a bag holds at most 65534 topics")]
    TooManyTopics {
        /// The topic to add.
        topic: String,
    },
    /// The topic id does not belong to this writer.
    #[error("cannot record a message of topic number {index}: the writer has {topics} topics")]
    UnknownTopic {
        /// The topic's position.
        index: usize,
        /// The number of topics.
        topics: usize,
    },
    /// MCAP times are unsigned.
    #[error(
        "cannot record a message of {topic} with time {time} ns: bags cannot represent times before 1970"
    )]
    NegativeTime {
        /// The topic.
        topic: String,
        /// The given time, in nanoseconds since the epoch.
        time: i64,
    },
}
