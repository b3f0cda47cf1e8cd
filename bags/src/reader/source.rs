//! The source of a bag file's bytes: on disk, or in memory.

use std::fs::File;
use std::io::{self, BufReader, BufWriter, Cursor, Read, Seek, SeekFrom, Write};
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use tempfile::{NamedTempFile, TempPath};

use crate::zstd;

/// Bytes that can be read repeatedly.
#[derive(Clone, Debug)]
pub(super) enum Source {
    File(PathBuf),
    /// Deleted when the last reference is dropped.
    Temporary(Arc<TempPath>),
    Memory(Bytes),
}

/// A reader of a source.
pub(super) trait Input: Read + Seek + Send {}

impl<T: Read + Seek + Send> Input for T {}

impl Source {
    pub(super) fn open(&self) -> io::Result<Box<dyn Input>> {
        let file = match self {
            Self::File(path) => File::open(path)?,
            Self::Temporary(path) => File::open(&**path)?,
            Self::Memory(bytes) => return Ok(Box::new(Cursor::new(bytes.clone()))),
        };
        Ok(Box::new(BufReader::new(At { file, position: 0 })))
    }

    pub(super) fn length(&self) -> io::Result<u64> {
        match self {
            Self::File(path) => Ok(path.metadata()?.len()),
            Self::Temporary(path) => Ok(path.metadata()?.len()),
            Self::Memory(bytes) => Ok(bytes.len() as u64),
        }
    }

    /// Its first bytes, at most `length`.
    pub(super) fn start(&self, length: u64) -> io::Result<Vec<u8>> {
        let mut start = Vec::new();
        self.open()?.take(length).read_to_end(&mut start)?;
        Ok(start)
    }

    /// Returns it as a file, in a temporary file if necessary.
    #[cfg(feature = "sqlite")]
    pub(super) fn into_file(self) -> io::Result<Self> {
        let Self::Memory(bytes) = &self else { return Ok(self) };
        let mut file = NamedTempFile::new()?;
        file.write_all(bytes)?;
        Ok(Self::Temporary(Arc::new(file.into_temp_path())))
    }

    #[cfg(feature = "sqlite")]
    pub(super) fn path(&self) -> Option<&std::path::Path> {
        match self {
            Self::File(path) => Some(path),
            Self::Temporary(path) => Some(path),
            Self::Memory(_) => None,
        }
    }
}

/// A file with a position of its own. That of the system is shared by the processes that a process forks, as
/// a debugger does.
struct At {
    file: File,
    position: u64,
}

impl Read for At {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = read_at(&self.file, bytes, self.position)?;
        self.position += count as u64;
        Ok(count)
    }
}

impl Seek for At {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        let position = match to {
            SeekFrom::Start(position) => Some(position),
            SeekFrom::End(by) => self.file.metadata()?.len().checked_add_signed(by),
            SeekFrom::Current(by) => self.position.checked_add_signed(by),
        };
        self.position = position.ok_or_else(|| io::Error::from(io::ErrorKind::InvalidInput))?;
        Ok(self.position)
    }
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], position: u64) -> io::Result<usize> {
    std::os::unix::fs::FileExt::read_at(file, bytes, position)
}

#[cfg(windows)]
fn read_at(file: &File, bytes: &mut [u8], position: u64) -> io::Result<usize> {
    std::os::windows::fs::FileExt::seek_read(file, bytes, position)
}

/// Stores bytes to be read later: in memory while they are few, else in a temporary file.
pub(super) enum Spool {
    Memory(Vec<u8>),
    File(BufWriter<NamedTempFile>),
}

/// The maximum size of a [`Spool`] in memory.
const MOST_IN_MEMORY: usize = 1024 * 1024;

impl Spool {
    pub(super) fn new() -> Self {
        Self::Memory(Vec::new())
    }

    pub(super) fn into_source(self) -> io::Result<Source> {
        match self {
            Self::Memory(bytes) => Ok(Source::Memory(bytes.into())),
            Self::File(file) => {
                let file = file.into_inner().map_err(io::IntoInnerError::into_error)?;
                Ok(Source::Temporary(Arc::new(file.into_temp_path())))
            }
        }
    }
}

impl Write for Spool {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if let Self::Memory(kept) = self
            && kept.len() + bytes.len() > MOST_IN_MEMORY
        {
            let mut file = BufWriter::new(NamedTempFile::new()?);
            file.write_all(kept)?;
            *self = Self::File(file);
        }
        match self {
            Self::Memory(kept) => kept.write(bytes),
            Self::File(file) => file.write(bytes),
        }
    }

    fn flush(&mut self) -> io::Result<()> {
        match self {
            Self::Memory(_) => Ok(()),
            Self::File(file) => file.flush(),
        }
    }
}

/// The magic number of a Zstandard frame (RFC 8878 section 3.1.1).
pub(super) const PACKED_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// No file of messages decompresses to more than this times its length.
const LARGEST_RATIO: u64 = 10_000;
/// The limit for files that decompress to more than `ALWAYS` bytes, before they fill the disk.
const LARGEST_RATIO_OF_LARGE: u64 = 100;
const ALWAYS: u64 = 1 << 30;

/// Decompresses a file that rosbag2 compressed as a whole (`--compression-mode file`). If it is damaged,
/// keeps the data before the error, and returns its length and the problem.
pub(super) fn unpack_file(packed: &Source) -> io::Result<(Source, Option<(u64, String)>)> {
    let length = packed.length()?;
    let of_large = length.saturating_mul(LARGEST_RATIO_OF_LARGE).max(ALWAYS);
    let limit = length.saturating_mul(LARGEST_RATIO).min(of_large);
    let mut content = Spool::new();
    let too_many = || format!("it decompresses to more than {} times its length", limit / length.max(1));
    let unpacked = zstd::unpack(&mut BufReader::new(packed.open()?), &mut content, limit, too_many);
    let content = content.into_source()?;
    let length = content.length()?;
    Ok((content, unpacked.err().map(|found| (length, found))))
}
