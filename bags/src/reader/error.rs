//! Errors of reading bags, and descriptions of missing parts.

use std::path::PathBuf;
use std::{fmt, io};

use crate::metadata::MetadataError;

/// Why a bag, or a part of it, could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReaderError {
    /// The path is not a bag.
    #[error("{} is not a bag: {found}", path.display())]
    NotABag {
        /// The path to open.
        path: PathBuf,
        /// What was found, and what is expected.
        found: String,
    },
    /// The file is not an MCAP file.
    #[error("{} is not an MCAP file: it starts with {found:02x?}, an MCAP file with {:02x?}", path.display(), mcap::MAGIC)]
    NotMcap {
        /// The file.
        path: PathBuf,
        /// Its first bytes, at most 8.
        found: Vec<u8>,
    },
    /// A file of a bag is a directory, a pipe or a device, which is not opened since reading could block
    /// forever.
    #[error("{} is not a regular file", path.display())]
    NotAFile {
        /// The path of the file.
        path: PathBuf,
    },
    /// metadata.yaml names a file outside of the bag, or a link to one.
    #[error("{} is not in the bag {}, whose metadata.yaml names it", path.display(), bag.display())]
    Outside {
        /// The named file, which is not opened.
        path: PathBuf,
        /// The directory.
        bag: PathBuf,
    },
    /// The kind of the bag is not supported.
    #[error("cannot read the bag {}: {found}", path.display())]
    Unsupported {
        /// The bag.
        path: PathBuf,
        /// The kind of the bag.
        found: String,
    },
    /// metadata.yaml cannot be read.
    #[error(transparent)]
    Metadata(#[from] MetadataError),
    /// The operating system could not read the file.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file or directory.
        path: PathBuf,
        /// The error of the operating system.
        source: io::Error,
    },
    /// A part of the file is damaged. What is whole in it is read, and so are the following parts.
    #[error("{}: the part at byte {offset} is damaged: {found}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// The offset of the part.
        offset: u64,
        /// The problem, and how many messages are lost where that is known.
        found: String,
    },
}

/// A missing part of a bag file, because recording was interrupted or the file was damaged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Truncation {
    /// The file.
    pub path: PathBuf,
    /// The offset of the missing or unreadable part.
    pub offset: u64,
    /// Bytes of the file that cannot be used; 0 when only the end mark is missing.
    pub lost_bytes: u64,
    /// The cause, as far as it can be inferred from the file.
    pub cause: TruncationCause,
}

/// Why a file is incomplete, as far as it can be inferred.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TruncationCause {
    /// The file ends after a complete chunk, without the end mark: recording was interrupted. The open chunk
    /// was never written.
    NoEnd,
    /// From here the file contains no complete record: recording or copying was interrupted.
    TornRecord,
    /// The file ends within a chunk: recording or copying was interrupted. Its first messages are read.
    TornChunk {
        /// The number of messages of the chunk that are read.
        messages: u64,
    },
    /// Some bytes are no record; the records behind them are read.
    DamagedRecord,
    /// All messages are present, but the summary after them is missing or damaged.
    NoSummary,
    /// A chunk is damaged; what is whole in it is read, and so are later ones. The text tells what is lost.
    DamagedChunk(String),
    /// A compressed file cannot be decompressed completely; the part before the error is read.
    Packed(String),
    /// An SQLite file has a write-ahead log, which is read with it: recording was interrupted, or is in
    /// progress. The open transaction was never written.
    NotEnded,
    /// Some rows of an SQLite file cannot be read; the others are.
    DamagedRows(String),
}

impl Truncation {
    /// Returns whether the file contains bytes of messages that cannot be read. An interrupted recording may
    /// lack messages that were never written; with an incomplete summary, all messages are present.
    #[must_use]
    pub fn loses_messages(&self) -> bool {
        match self.cause {
            TruncationCause::NoEnd | TruncationCause::NoSummary | TruncationCause::NotEnded => false,
            TruncationCause::TornRecord => self.lost_bytes > 0,
            TruncationCause::TornChunk { .. }
            | TruncationCause::DamagedRecord
            | TruncationCause::DamagedChunk(_)
            | TruncationCause::Packed(_)
            | TruncationCause::DamagedRows(_) => true,
        }
    }
}

impl fmt::Display for Truncation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { path, offset, lost_bytes, cause } = self;
        let path = path.display();
        match cause {
            TruncationCause::NoEnd => write!(
                f,
                "{path}: recording was interrupted; all {offset} bytes are readable, messages after them were not written"
            ),
            TruncationCause::TornRecord => write!(
                f,
                "{path}: recording or copying was interrupted; readable up to byte {offset}, the last {lost_bytes} bytes \
                 are an incomplete chunk and lost"
            ),
            TruncationCause::NoSummary => {
                write!(f, "{path}: the summary at byte {offset} is incomplete; all messages are readable")
            }
            TruncationCause::Packed(found) => write!(
                f,
                "{path}: the compressed file cannot be decompressed completely: {found}; the first {offset} bytes of its \
                 content are read"
            ),
            TruncationCause::NotEnded => write!(
                f,
                "{path}: recording was interrupted, or is in progress; its log (-wal) is read with it, and messages are missing without it"
            ),
            TruncationCause::DamagedRows(found) => {
                write!(f, "{path}: message rows cannot be read, starting at number {offset}: {found}")
            }
            TruncationCause::TornChunk { messages } => write!(
                f,
                "{path}: recording or copying was interrupted; the last {lost_bytes} bytes are an incomplete chunk at byte \
                 {offset}, of which {messages} messages are read and the others are lost"
            ),
            TruncationCause::DamagedRecord => write!(
                f,
                "{path}: the {lost_bytes} bytes at byte {offset} are no record and are skipped; the file continues behind them"
            ),
            TruncationCause::DamagedChunk(found) => {
                write!(f, "{path}: the chunk of {lost_bytes} bytes at byte {offset} is damaged: {found}")
            }
        }
    }
}
