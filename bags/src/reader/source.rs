//! The source of a bag file's bytes: on disk, or in memory.

use std::borrow::Cow::{self, Borrowed};
use std::fs::File;
use std::io::{self, BufReader, BufWriter, Cursor, Read, Seek, Write};
use std::path::PathBuf;
use std::sync::Arc;

use bytes::Bytes;
use mcap::records::{self, MessageHeader, Record, op};
use tempfile::{NamedTempFile, TempPath};

use super::records::{RECORD_HEADER, parse};
use crate::{lz4, zstd};

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
        Ok(Box::new(BufReader::new(file)))
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

/// The position of messages in the file, and their receive times.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Segment {
    pub(super) offset: u64,
    /// Including the headers of its records.
    pub(super) length: u64,
    /// The earliest and latest log time.
    pub(super) first: u64,
    pub(super) last: u64,
    /// The channels with messages in it, if known from the file.
    pub(super) channels: Option<Arc<[u16]>>,
}

/// A record of a segment.
pub(super) enum Content<'a> {
    Schema { header: records::SchemaHeader, data: &'a [u8] },
    Channel(records::Channel),
    Message { header: MessageHeader, data: &'a [u8] },
}

/// Calls `each` with every schema, channel and message in the bytes of a segment, in file order. Checksums of
/// chunks are verified first.
pub(super) fn decode(bytes: &[u8], mut each: impl FnMut(Content<'_>)) -> Result<(), String> {
    let bytes = unpack(bytes)?;
    let mut rest = &*bytes;
    while !rest.is_empty() {
        let ends_early = || "it ends within a record".to_owned();
        let (header, behind) = rest.split_first_chunk::<9>().ok_or_else(ends_early)?;
        let [opcode, length @ ..] = *header;
        let length = usize::try_from(u64::from_le_bytes(length)).map_err(|_| ends_early())?;
        let (body, behind) = behind.split_at_checked(length).ok_or_else(ends_early)?;
        if let Some(content) = content(opcode, body)? {
            each(content);
        }
        rest = behind;
    }
    Ok(())
}

/// The records in a segment: those in a chunk are decompressed and verified.
fn unpack(bytes: &[u8]) -> Result<Cow<'_, [u8]>, String> {
    if bytes.first() != Some(&op::CHUNK) {
        return Ok(Borrowed(bytes));
    }
    let body = bytes.get(RECORD_HEADER as usize..).unwrap_or_default();
    let Record::Chunk { header, data: Borrowed(data) } = parse(op::CHUNK, body)? else {
        return Err("it is not a chunk".to_owned());
    };
    let content_length = body.len() - (40 + header.compression.len());
    if data.len() != content_length {
        return Err(format!(
            "its header declares {} bytes of content, found {content_length}",
            header.compressed_size
        ));
    }
    let most = zstd::most_from(data.len() as u64);
    if !header.compression.is_empty() && header.uncompressed_size > most {
        return Err(format!(
            "its header declares {} bytes of content, too many for {} compressed bytes: at most {most} are decompressed",
            header.uncompressed_size,
            data.len()
        ));
    }
    let content = match header.compression.as_str() {
        "" if header.uncompressed_size == data.len() as u64 => Borrowed(data),
        "" => {
            return Err(format!(
                "its header declares {} bytes of uncompressed content, found {}",
                header.uncompressed_size,
                data.len()
            ));
        }
        "zstd" => Cow::Owned(zstd::decompress(data, header.uncompressed_size)?),
        "lz4" => Cow::Owned(lz4::decompress(data, header.uncompressed_size)?),
        other => return Err(format!("it is compressed with {other:?}; supported are lz4, zstd and none")),
    };
    // 0 means no checksum, as written by the real recorder.
    if header.uncompressed_crc != 0 && crc32fast::hash(&content) != header.uncompressed_crc {
        return Err("its content does not match its checksum".to_owned());
    }
    Ok(content)
}

fn content(opcode: u8, body: &[u8]) -> Result<Option<Content<'_>>, String> {
    if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
        return Ok(None);
    }
    if let (op::MESSAGE, Some(message)) = (opcode, message(body)) {
        return Ok(Some(message));
    }
    match parse(opcode, body)? {
        Record::Schema { header, data: Borrowed(data) } => Ok(Some(Content::Schema { header, data })),
        Record::Channel(channel) => Ok(Some(Content::Channel(channel))),
        _ => Ok(None),
    }
}

/// Parses a message without the general parser, since most records are messages.
fn message(body: &[u8]) -> Option<Content<'_>> {
    let (channel_id, rest) = body.split_first_chunk()?;
    let (sequence, rest) = rest.split_first_chunk()?;
    let (log_time, rest) = rest.split_first_chunk()?;
    let (publish_time, data) = rest.split_first_chunk()?;
    let header = MessageHeader {
        channel_id: u16::from_le_bytes(*channel_id),
        sequence: u32::from_le_bytes(*sequence),
        log_time: u64::from_le_bytes(*log_time),
        publish_time: u64::from_le_bytes(*publish_time),
    };
    Some(Content::Message { header, data })
}

/// The magic number of a Zstandard frame (RFC 8878 section 3.1.1).
pub(super) const PACKED_MAGIC: &[u8] = &[0x28, 0xb5, 0x2f, 0xfd];

/// No file of messages decompresses to more than this times its length.
const LARGEST_RATIO: u64 = 10_000;
/// The limit for files that decompress to more than `ALWAYS` bytes, before they fill the disk.
const LARGEST_RATIO_OF_LARGE: u64 = 100;
const ALWAYS: u64 = 1 << 30;

/// Decompresses a file that rosbag2 compressed as a whole (`--compression-mode file`). If it is damaged, keeps the data
/// before the error, and returns its length and the problem.
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
