//! MCAP records as bytes. The `mcap` crate can only write compressed chunks with a compressor in C, so the
//! records are written here, with the types of that crate.
//!
//! # References
//! <https://mcap.dev/spec>: little-endian, each record an opcode, a length of 8 bytes, and a body.

use std::collections::BTreeMap;
use std::io;

use downbeat_msgs::encoding::Schema;
use mcap::records::{
    ChunkHeader, ChunkIndex, MessageHeader, MessageIndexEntry, MetadataIndex, Statistics, op,
};

use crate::topic::TopicDescription;

/// Appends a record; `write` appends its body.
fn record(
    out: &mut Vec<u8>,
    opcode: u8,
    write: impl FnOnce(&mut Vec<u8>) -> io::Result<()>,
) -> io::Result<()> {
    record_before(out, opcode, 0, write)
}

/// Appends a record without the last `missing` bytes of its body, which are written separately.
fn record_before(
    out: &mut Vec<u8>,
    opcode: u8,
    missing: u64,
    write: impl FnOnce(&mut Vec<u8>) -> io::Result<()>,
) -> io::Result<()> {
    out.push(opcode);
    let start = out.len() + 8;
    out.extend_from_slice(&[0; 8]);
    write(out)?;
    let length = (out.len() - start) as u64 + missing;
    out[start - 8..start].copy_from_slice(&length.to_le_bytes());
    Ok(())
}

pub(super) fn header(out: &mut Vec<u8>, profile: &str, library: &str) -> io::Result<()> {
    record(out, op::HEADER, |out| {
        text(out, profile)?;
        text(out, library)
    })
}

pub(super) fn schema(out: &mut Vec<u8>, id: u16, schema: &Schema) -> io::Result<()> {
    record(out, op::SCHEMA, |out| {
        out.extend_from_slice(&id.to_le_bytes());
        text(out, &schema.name)?;
        text(out, &schema.encoding)?;
        with_length(out, |out| {
            out.extend_from_slice(&schema.data);
            Ok(())
        })
    })
}

pub(super) fn channel(
    out: &mut Vec<u8>,
    id: u16,
    schema: u16,
    topic: &TopicDescription,
    metadata: &BTreeMap<String, String>,
) -> io::Result<()> {
    record(out, op::CHANNEL, |out| {
        out.extend_from_slice(&id.to_le_bytes());
        out.extend_from_slice(&schema.to_le_bytes());
        text(out, &topic.name)?;
        text(out, topic.message_encoding())?;
        texts(out, metadata)
    })
}

pub(super) fn message(out: &mut Vec<u8>, header: &MessageHeader, data: &[u8]) -> io::Result<()> {
    record(out, op::MESSAGE, |out| {
        out.extend_from_slice(&header.channel_id.to_le_bytes());
        out.extend_from_slice(&header.sequence.to_le_bytes());
        out.extend_from_slice(&header.log_time.to_le_bytes());
        out.extend_from_slice(&header.publish_time.to_le_bytes());
        out.extend_from_slice(data);
        Ok(())
    })
}

/// The part of a chunk record before its content.
pub(super) fn chunk_without_content(out: &mut Vec<u8>, header: &ChunkHeader) -> io::Result<()> {
    record_before(out, op::CHUNK, header.compressed_size, |out| {
        out.extend_from_slice(&header.message_start_time.to_le_bytes());
        out.extend_from_slice(&header.message_end_time.to_le_bytes());
        out.extend_from_slice(&header.uncompressed_size.to_le_bytes());
        out.extend_from_slice(&header.uncompressed_crc.to_le_bytes());
        text(out, &header.compression)?;
        out.extend_from_slice(&header.compressed_size.to_le_bytes());
        Ok(())
    })
}

pub(super) fn message_index(
    out: &mut Vec<u8>,
    channel: u16,
    entries: &[MessageIndexEntry],
) -> io::Result<()> {
    record(out, op::MESSAGE_INDEX, |out| {
        out.extend_from_slice(&channel.to_le_bytes());
        with_length(out, |out| {
            for entry in entries {
                out.extend_from_slice(&entry.log_time.to_le_bytes());
                out.extend_from_slice(&entry.offset.to_le_bytes());
            }
            Ok(())
        })
    })
}

pub(super) fn metadata(out: &mut Vec<u8>, name: &str, entries: &BTreeMap<String, String>) -> io::Result<()> {
    record(out, op::METADATA, |out| {
        text(out, name)?;
        texts(out, entries)
    })
}

pub(super) fn data_end(out: &mut Vec<u8>, data_crc: u32) -> io::Result<()> {
    record(out, op::DATA_END, |out| {
        out.extend_from_slice(&data_crc.to_le_bytes());
        Ok(())
    })
}

pub(super) fn statistics(out: &mut Vec<u8>, statistics: &Statistics) -> io::Result<()> {
    record(out, op::STATISTICS, |out| {
        out.extend_from_slice(&statistics.message_count.to_le_bytes());
        out.extend_from_slice(&statistics.schema_count.to_le_bytes());
        out.extend_from_slice(&statistics.channel_count.to_le_bytes());
        out.extend_from_slice(&statistics.attachment_count.to_le_bytes());
        out.extend_from_slice(&statistics.metadata_count.to_le_bytes());
        out.extend_from_slice(&statistics.chunk_count.to_le_bytes());
        out.extend_from_slice(&statistics.message_start_time.to_le_bytes());
        out.extend_from_slice(&statistics.message_end_time.to_le_bytes());
        by_channel(out, &statistics.channel_message_counts)
    })
}

pub(super) fn chunk_index(out: &mut Vec<u8>, index: &ChunkIndex) -> io::Result<()> {
    record(out, op::CHUNK_INDEX, |out| {
        out.extend_from_slice(&index.message_start_time.to_le_bytes());
        out.extend_from_slice(&index.message_end_time.to_le_bytes());
        out.extend_from_slice(&index.chunk_start_offset.to_le_bytes());
        out.extend_from_slice(&index.chunk_length.to_le_bytes());
        by_channel(out, &index.message_index_offsets)?;
        out.extend_from_slice(&index.message_index_length.to_le_bytes());
        text(out, &index.compression)?;
        out.extend_from_slice(&index.compressed_size.to_le_bytes());
        out.extend_from_slice(&index.uncompressed_size.to_le_bytes());
        Ok(())
    })
}

pub(super) fn metadata_index(out: &mut Vec<u8>, index: &MetadataIndex) -> io::Result<()> {
    record(out, op::METADATA_INDEX, |out| {
        out.extend_from_slice(&index.offset.to_le_bytes());
        out.extend_from_slice(&index.length.to_le_bytes());
        text(out, &index.name)
    })
}

pub(super) fn summary_offset(out: &mut Vec<u8>, opcode: u8, start: u64, length: u64) -> io::Result<()> {
    record(out, op::SUMMARY_OFFSET, |out| {
        out.push(opcode);
        out.extend_from_slice(&start.to_le_bytes());
        out.extend_from_slice(&length.to_le_bytes());
        Ok(())
    })
}

fn text(out: &mut Vec<u8>, text: &str) -> io::Result<()> {
    with_length(out, |out| {
        out.extend_from_slice(text.as_bytes());
        Ok(())
    })
}

fn texts(out: &mut Vec<u8>, entries: &BTreeMap<String, String>) -> io::Result<()> {
    with_length(out, |out| {
        entries.iter().try_for_each(|(key, value)| text(out, key).and_then(|()| text(out, value)))
    })
}

fn by_channel(out: &mut Vec<u8>, entries: &BTreeMap<u16, u64>) -> io::Result<()> {
    with_length(out, |out| {
        for (channel, value) in entries {
            out.extend_from_slice(&channel.to_le_bytes());
            out.extend_from_slice(&value.to_le_bytes());
        }
        Ok(())
    })
}

/// Appends the output of `write`, preceded by its length in 4 bytes.
fn with_length(out: &mut Vec<u8>, write: impl FnOnce(&mut Vec<u8>) -> io::Result<()>) -> io::Result<()> {
    let start = out.len() + 4;
    out.extend_from_slice(&[0; 4]);
    write(out)?;
    let length = u32::try_from(out.len() - start)
        .map_err(|_| io::Error::other("MCAP does not support strings and indexes of 4 GiB and more"))?;
    out[start - 4..start].copy_from_slice(&length.to_le_bytes());
    Ok(())
}
