//! Why recording failed.

use std::io;
use std::path::PathBuf;

/// Why a bag could not be created, or why recording stopped.
#[derive(Debug, thiserror::Error)]
pub enum WriterError {
    /// Nothing is ever overwritten.
    #[error("cannot record into {}: it exists already; choose another name, or remove it first", path.display())]
    AlreadyExists {
        /// The directory that was to be created.
        path: PathBuf,
    },
    /// The path has no last component to name the bag after.
    #[error("cannot record into {}: the path does not end in a name for the bag", path.display())]
    Unnamed {
        /// The path that was given.
        path: PathBuf,
    },
    /// Files are to be smaller than a file can be.
    #[error("cannot split a bag into files of {bytes} bytes: the least is {least}")]
    SplitSize {
        /// The size that was asked for.
        bytes: u64,
        /// The least of the storage.
        least: u64,
    },
    /// The storage is not written as it was asked for.
    #[error(transparent)]
    Storage(#[from] super::StorageError),
    /// The directory or a first file in it could not be created.
    #[error("cannot create {}: {source}", path.display())]
    Create {
        /// The directory or file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
    },
    /// Writing failed (disk full, medium gone). Recording has stopped; what was written before is kept and readable.
    #[error(
        "cannot write to {}: {source}; recording has stopped, the {kept} messages written before are kept",
        path.display()
    )]
    Write {
        /// The file.
        path: PathBuf,
        /// What the operating system said.
        source: io::Error,
        /// Messages that can be read from the bag.
        kept: u64,
    },
    /// Messages came faster than they could be written, and recording was to stop then
    /// ([`WhenSlow::Stop`](crate::WhenSlow::Stop)). All before is kept.
    #[error(
        "cannot keep up with recording into {}: {cache_bytes} bytes wait to be written; recording has stopped, what came before is kept",
        path.display()
    )]
    TooSlow {
        /// The bag directory.
        path: PathBuf,
        /// How much may wait.
        cache_bytes: usize,
    },
    /// Recording has stopped after an earlier [`WriterError::Write`], which told why.
    #[error("cannot record into {}: recording has stopped after a failed write", path.display())]
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
        /// The type it was to be added with again.
        second: String,
    },
    /// The tables of `sqlite3` have no place for all that a channel of MCAP can tell.
    #[error("cannot record topic {topic} in the storage {storage}: {found}; record it in the storage mcap")]
    NoPlace {
        /// The topic that was to be added.
        topic: String,
        /// The storage.
        storage: crate::storage::Storage,
        /// What there is no place for.
        found: String,
    },
    /// MCAP numbers channels with 16 bits.
    #[error("cannot record topic {topic}: a bag holds at most 65534 topics")]
    TooManyTopics {
        /// The topic that was to be added.
        topic: String,
    },
    /// The topic id is not of this writer.
    #[error("cannot record a message of topic number {index}: the writer has {topics} topics")]
    UnknownTopic {
        /// The topic's position.
        index: usize,
        /// How many there are.
        topics: usize,
    },
    /// MCAP times are unsigned.
    #[error(
        "cannot record a message of {topic} with time {time} ns: times before 1970 have no place in a bag"
    )]
    NegativeTime {
        /// The topic.
        topic: String,
        /// The time that was given, in nanoseconds since the epoch.
        time: i64,
    },
}
