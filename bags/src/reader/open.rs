//! Opens a file of a bag by its first bytes.

use std::path::Path;

use mcap::MAGIC;

use super::error::{ReaderError, TruncationCause};
use super::file::BagFile;
use super::records::RecordFile;
use super::source::{self, Source};
use super::summary::{SummaryState, read_summary};
use super::walk::walk;

/// The first bytes of an SQLite file.
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

impl BagFile {
    /// Opens a file by its first bytes: MCAP, SQLite, or either compressed as a whole. `path` is for errors;
    /// the bytes are those of `source`.
    pub(super) fn open(path: &Path, source: Source) -> Result<Self, ReaderError> {
        let read = |source| ReaderError::Read { path: path.to_owned(), source };
        let start = source.start(16).map_err(read)?;
        if !start.starts_with(source::PACKED_MAGIC) {
            return Self::open_content(path, source, &start);
        }
        let (content, problem) = source::unpack_file(&source).map_err(read)?;
        let start = content.start(16).map_err(read)?;
        let mut file = Self::open_content(path, content, &start)?;
        if let Some((length, found)) = problem {
            file.miss(length, 0, TruncationCause::Packed(found));
        }
        Ok(file)
    }

    fn open_content(path: &Path, source: Source, start: &[u8]) -> Result<Self, ReaderError> {
        if start.starts_with(SQLITE_MAGIC) {
            return open_sqlite(path, source);
        }
        let read = |source| ReaderError::Read { path: path.to_owned(), source };
        let start = &start[..start.len().min(MAGIC.len())];
        // A file that ends within the first mark: recording was interrupted at once.
        if !MAGIC.starts_with(start) {
            return Err(ReaderError::NotMcap { path: path.to_owned(), found: start.to_vec() });
        }
        let mut input = RecordFile::open(&source).map_err(read)?;
        let mut file = Self::empty(path, source.clone(), input.length());
        let summary = read_summary(&mut file, &mut input).map_err(read)?;
        if summary != SummaryState::Used {
            file = Self::empty(path, source, input.length());
            walk(&mut file, &mut input, summary).map_err(read)?;
        }
        Ok(file)
    }
}

#[cfg(feature = "sqlite")]
fn open_sqlite(path: &Path, source: Source) -> Result<BagFile, ReaderError> {
    super::sqlite::open(path, source)
}

#[cfg(not(feature = "sqlite"))]
fn open_sqlite(path: &Path, _source: Source) -> Result<BagFile, ReaderError> {
    let found = "it is an SQLite file, and this program is built without \"sqlite\": build with --features sqlite, which needs a \
                 C compiler"
        .to_owned();
    Err(ReaderError::Unsupported { path: path.to_owned(), found })
}
