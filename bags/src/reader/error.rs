//! Why a bag cannot be read, and what is missing in one that can.

use std::fmt;
use std::io;
use std::path::PathBuf;

use crate::metadata::MetadataError;

/// Why a bag, or a part of it, could not be read.
#[derive(Debug, thiserror::Error)]
pub enum ReaderError {
    /// The path leads to no bag.
    #[error("{} is no bag: {found}", path.display())]
    NotABag {
        /// What was to be opened.
        path: PathBuf,
        /// What is there instead, and what would be a bag.
        found: String,
    },
    /// The file is no MCAP file.
    #[error("{} is not an MCAP file: it begins with {found:02x?}, an MCAP file with {:02x?}", path.display(), mcap::MAGIC)]
    NotMcap {
        /// The file.
        path: PathBuf,
        /// Its first bytes, at most 8.
        found: Vec<u8>,
    },
    /// A file of a bag is a directory, a pipe or a device, which is not opened: it could wait for ever.
    #[error("{} is no regular file", path.display())]
    NotAFile {
        /// What is not opened.
        path: PathBuf,
    },
    /// metadata.yaml names a file that is not in the bag, or a link that leads out of it.
    #[error("{} is not in the bag {}, whose metadata.yaml names it", path.display(), bag.display())]
    Outside {
        /// The file that is named, which is not opened.
        path: PathBuf,
        /// The directory.
        bag: PathBuf,
    },
    /// The bag is of a kind that this crate does not read.
    #[error("cannot read the bag {}: {found}", path.display())]
    Unsupported {
        /// The bag.
        path: PathBuf,
        /// What it is.
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
        /// What the operating system said.
        source: io::Error,
    },
    /// A part of the file is not as it was written. The parts behind it can still be read.
    #[error("{}: the part at byte {offset} cannot be read and is skipped: {found}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where the part begins.
        offset: u64,
        /// What is wrong with it.
        found: String,
    },
}

/// Something that a bag file should have and has not, because recording was interrupted or the file was damaged.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Truncation {
    /// The file.
    pub path: PathBuf,
    /// Where the missing or unreadable part begins.
    pub offset: u64,
    /// Bytes of the file that cannot be used; 0 when only the end mark is missing.
    pub lost_bytes: u64,
    /// What happened, as far as the file tells.
    pub cause: TruncationCause,
}

/// What happened to a file, as far as it tells.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TruncationCause {
    /// The file ends after a whole chunk, without the end mark: recording was interrupted. What was in the open chunk
    /// never came into the file.
    NoEnd,
    /// From here on the file holds no whole record: recording or copying was interrupted.
    TornRecord,
    /// All messages are there, but the summary behind them is missing or damaged.
    NoSummary,
    /// A chunk is not as it was written; later ones are read.
    DamagedChunk(String),
    /// A compressed file does not decompress to its end; what came out before is read.
    Packed(String),
    /// An SQLite file has a write-ahead log beside it, which is read with it: recording was interrupted, or goes on. What was
    /// in the open transaction never came into the file.
    NotEnded,
    /// Some rows of an SQLite file cannot be read; the others are.
    DamagedRows(String),
}

impl Truncation {
    /// Whether the file holds bytes of messages that cannot be read. An interrupted recording may lack messages that never came
    /// into the file; those of an incomplete summary are all there.
    #[must_use]
    pub fn loses_messages(&self) -> bool {
        match self.cause {
            TruncationCause::NoEnd | TruncationCause::NoSummary | TruncationCause::NotEnded => false,
            TruncationCause::TornRecord => self.lost_bytes > 0,
            TruncationCause::DamagedChunk(_)
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
                 are no whole chunk and lost"
            ),
            TruncationCause::NoSummary => {
                write!(f, "{path}: the summary at byte {offset} is incomplete; all messages are readable")
            }
            TruncationCause::Packed(found) => write!(
                f,
                "{path}: the compressed file cannot be decompressed to its end: {found}; the first {offset} bytes of its \
                 content are read"
            ),
            TruncationCause::NotEnded => write!(
                f,
                "{path}: recording was interrupted, or goes on; its log (-wal) is read with it, and messages are missing without"
            ),
            TruncationCause::DamagedRows(found) => {
                write!(f, "{path}: rows of the messages cannot be read from number {offset} on: {found}")
            }
            TruncationCause::DamagedChunk(found) => {
                write!(
                    f,
                    "{path}: the chunk of {lost_bytes} bytes at byte {offset} is damaged and lost: {found}"
                )
            }
        }
    }
}
