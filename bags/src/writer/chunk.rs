//! The open chunk: records collected in memory and written together.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::{self, Write};

use lz4_flex::frame::{BlockSize, FrameEncoder, FrameInfo};
use mcap::records::{ChunkHeader, ChunkIndex, MessageHeader, MessageIndexEntry};

use super::output::Part;
use super::{Compression, CompressionLevel, McapOptions, records};
use crate::zstd;

#[derive(Default)]
pub(super) struct Chunk {
    content: Vec<u8>,
    /// The positions of each channel's messages in `content`; may be empty for channels of earlier chunks.
    messages: BTreeMap<u16, Vec<MessageIndexEntry>>,
    /// Earliest and latest log time.
    times: Option<(u64, u64)>,
}

impl Chunk {
    pub(super) fn is_empty(&self) -> bool {
        self.content.is_empty()
    }

    /// Its size before compression.
    pub(super) fn bytes(&self) -> u64 {
        self.content.len() as u64
    }

    /// The number of messages of each channel.
    pub(super) fn counts(&self) -> impl Iterator<Item = (u16, u64)> {
        self.indices().map(|(channel, entries)| (channel, entries.len() as u64))
    }

    fn indices(&self) -> impl Iterator<Item = (u16, &Vec<MessageIndexEntry>)> {
        let channels = self.messages.iter().map(|(channel, entries)| (*channel, entries));
        channels.filter(|(_, entries)| !entries.is_empty())
    }

    /// Earliest and latest log time.
    pub(super) fn times(&self) -> Option<(u64, u64)> {
        self.times
    }

    /// The buffer for schema and channel records.
    pub(super) fn records(&mut self) -> &mut Vec<u8> {
        &mut self.content
    }

    pub(super) fn add_message(&mut self, header: &MessageHeader, data: &[u8]) -> io::Result<()> {
        let offset = self.content.len() as u64;
        records::message(&mut self.content, header, data)?;
        let time = header.log_time;
        let entry = MessageIndexEntry { log_time: time, offset };
        self.messages.entry(header.channel_id).or_default().push(entry);
        self.times = Some(self.times.map_or((time, time), |(first, last)| (first.min(time), last.max(time))));
        Ok(())
    }

    /// Clears it and keeps its memory.
    pub(super) fn clear(&mut self) {
        self.content.clear();
        self.messages.values_mut().for_each(Vec::clear);
        self.times = None;
    }

    /// The raw records, for files without chunks.
    pub(super) fn content(&self) -> &[u8] {
        &self.content
    }

    /// Builds the record for the file, which will start at `position`. The bytes around the content are
    /// written to `frame`.
    pub(super) fn emit(
        &self,
        frame: &mut Vec<u8>,
        position: u64,
        options: &McapOptions,
    ) -> io::Result<Emitted<'_>> {
        let (compression, compressed) = compress(&self.content, options)?;
        let crc = options.has_chunk_crc.then(|| crc32fast::hash(&self.content));
        let content_crc = crc.filter(|_| compressed.is_none());
        let content = compressed.map_or(Cow::Borrowed(self.content.as_slice()), Cow::Owned);
        let (first, last) = self.times.unwrap_or((0, 0));
        let header = ChunkHeader {
            message_start_time: first,
            message_end_time: last,
            uncompressed_size: self.content.len() as u64,
            // 0 means none.
            uncompressed_crc: crc.unwrap_or(0),
            compression: compression.to_owned(),
            compressed_size: content.len() as u64,
        };
        records::chunk_without_content(frame, &header)?;
        let content_at = frame.len();
        let chunk_length = (content_at + content.len()) as u64;
        let mut message_index_offsets = BTreeMap::new();
        if options.has_message_index {
            for (channel, entries) in self.indices() {
                let offset = position + (frame.len() + content.len()) as u64;
                message_index_offsets.insert(channel, offset);
                records::message_index(frame, channel, entries)?;
            }
        }
        let index = ChunkIndex {
            message_start_time: first,
            message_end_time: last,
            chunk_start_offset: position,
            chunk_length,
            message_index_offsets,
            message_index_length: (frame.len() - content_at) as u64,
            compression: header.compression,
            compressed_size: header.compressed_size,
            uncompressed_size: header.uncompressed_size,
        };
        Ok(Emitted { content, content_crc, content_at, index })
    }
}

/// A chunk ready for the file, with its content separate from the bytes around it.
pub(super) struct Emitted<'a> {
    content: Cow<'a, [u8]>,
    content_crc: Option<u32>,
    /// The offset of the content in the frame.
    pub(super) content_at: usize,
    pub(super) index: ChunkIndex,
}

impl Emitted<'_> {
    pub(super) fn content(&self) -> Part<'_> {
        Part { bytes: &self.content, crc: self.content_crc }
    }
}

/// Smaller content is not compressed, nor content that shrinks by less: the limits of the MCAP C++ library
/// (`McapWriter::writeChunk`).
const SMALLEST: usize = 1024;
const LEAST_RATIO: f64 = 1.02;

/// Returns the name of the compression, empty for none, and the compressed content, if any.
pub(super) fn compress(content: &[u8], options: &McapOptions) -> io::Result<(&'static str, Option<Vec<u8>>)> {
    if content.len() < SMALLEST && !options.is_compression_forced {
        return Ok(("", None));
    }
    let (name, compressed) = match options.compression {
        Compression::None => return Ok(("", None)),
        Compression::Lz4 => ("lz4", lz4(content)?),
        Compression::Zstd => ("zstd", zstd(content, options.level)),
    };
    let ratio = content.len() as f64 / compressed.len().max(1) as f64;
    if ratio < LEAST_RATIO && !options.is_compression_forced {
        return Ok(("", None));
    }
    Ok((name, Some(compressed)))
}

fn lz4(content: &[u8]) -> io::Result<Vec<u8>> {
    // Readers allocate two blocks for each chunk. With those of 4 MB, which the library chooses for larger
    // chunks, fresh memory costs more than the decompression.
    let block = if content.len() <= 64 * 1024 { BlockSize::Max64KB } else { BlockSize::Max256KB };
    let frame = FrameInfo::new().block_size(block).content_size(Some(content.len() as u64));
    let mut encoder = FrameEncoder::with_frame_info(frame, Vec::with_capacity(content.len() / 2));
    encoder.write_all(content)?;
    encoder.finish().map_err(io::Error::other)
}

fn zstd(content: &[u8], level: CompressionLevel) -> Vec<u8> {
    match level {
        CompressionLevel::Fastest | CompressionLevel::Fast => zstd::compress_fast(content),
        CompressionLevel::Default => zstd::compress(content),
        // One has better coding and the other a larger window: which is better depends on the content.
        CompressionLevel::Slow | CompressionLevel::Slowest => {
            let (coded, repeated) = (zstd::compress(content), zstd::compress_fast(content));
            if repeated.len() < coded.len() { repeated } else { coded }
        }
    }
}
