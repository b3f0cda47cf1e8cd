//! The open chunk: records that are collected in memory until they are written as one.

use std::collections::BTreeMap;
use std::io;

use mcap::records::{ChunkHeader, ChunkIndex, MessageHeader, MessageIndexEntry};

use super::compress::compress;
use super::{McapOptions, records};

#[derive(Default)]
pub(super) struct Chunk {
    content: Vec<u8>,
    /// Where the messages of each channel are in `content`.
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
        self.messages.iter().map(|(channel, entries)| (*channel, entries.len() as u64))
    }

    /// Earliest and latest log time.
    pub(super) fn times(&self) -> Option<(u64, u64)> {
        self.times
    }

    /// Where schema and channel records go.
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

    /// Makes it empty and keeps its room.
    pub(super) fn clear(&mut self) {
        self.content.clear();
        self.messages.clear();
        self.times = None;
    }

    /// Appends the records as they are to `out`: a file without chunks.
    pub(super) fn emit_records(&self, out: &mut Vec<u8>) {
        out.extend_from_slice(&self.content);
    }

    /// Appends the chunk and the index of its messages to `out`, which will be written at `position` in the file.
    pub(super) fn emit(
        &self,
        out: &mut Vec<u8>,
        position: u64,
        options: &McapOptions,
    ) -> io::Result<ChunkIndex> {
        let (compression, compressed) = compress(&self.content, options)?;
        let data = compressed.as_ref().unwrap_or(&self.content);
        let (first, last) = self.times.unwrap_or((0, 0));
        let header = ChunkHeader {
            message_start_time: first,
            message_end_time: last,
            uncompressed_size: self.content.len() as u64,
            // 0 stands for none.
            uncompressed_crc: if options.has_chunk_crc { crc32fast::hash(&self.content) } else { 0 },
            compression: compression.to_owned(),
            compressed_size: data.len() as u64,
        };
        let start = out.len();
        records::chunk(out, &header, data)?;
        let indexes = out.len();
        let mut message_index_offsets = BTreeMap::new();
        if options.has_message_index {
            for (channel, entries) in &self.messages {
                message_index_offsets.insert(*channel, position + (out.len() - start) as u64);
                records::message_index(out, *channel, entries)?;
            }
        }
        Ok(ChunkIndex {
            message_start_time: first,
            message_end_time: last,
            chunk_start_offset: position,
            chunk_length: (indexes - start) as u64,
            message_index_offsets,
            message_index_length: (out.len() - indexes) as u64,
            compression: header.compression,
            compressed_size: header.compressed_size,
            uncompressed_size: header.uncompressed_size,
        })
    }
}
