//! A segment of a file with messages: a chunk, or a run of messages outside of chunks.

use std::borrow::Cow::{self, Borrowed};
use std::sync::Arc;

use mcap::records::{self, MessageHeader, Record, op};

use super::parse::parse;
use super::records::RECORD_HEADER;
use crate::{lz4, zstd};

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
