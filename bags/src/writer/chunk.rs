//! The open chunk: records that are collected in memory until they are written as one.

use std::collections::BTreeMap;
use std::io;

use mcap::records::{ChunkHeader, ChunkIndex, MessageHeader, MessageIndexEntry};

use super::{Compression, records};
use crate::zstd;

#[derive(Default)]
pub(super) struct Chunk {
    content: Vec<u8>,
    /// Where the messages of each channel are in `content`.
    messages: BTreeMap<u16, Vec<MessageIndexEntry>>,
    /// Earliest and latest log time.
    times: Option<(u64, u64)>,
    /// Size of the message records.
    message_bytes: u64,
}

impl Chunk {
    pub(super) fn is_empty(&self) -> bool {
        self.content.is_empty()
    }

    pub(super) fn message_bytes(&self) -> u64 {
        self.message_bytes
    }

    /// The number of messages of each channel.
    pub(super) fn counts(&self) -> impl Iterator<Item = (u16, u64)> {
        self.messages.iter().map(|(channel, entries)| (*channel, entries.len() as u64))
    }

    /// Adds the schema or channel records in `bytes`.
    pub(super) fn add_records(&mut self, bytes: &[u8]) {
        self.content.extend_from_slice(bytes);
    }

    pub(super) fn add_message(&mut self, header: &MessageHeader, data: &[u8]) -> io::Result<()> {
        let offset = self.content.len() as u64;
        records::message(&mut self.content, header, data)?;
        self.message_bytes += self.content.len() as u64 - offset;
        let time = header.log_time;
        let entry = MessageIndexEntry { log_time: time, offset };
        self.messages.entry(header.channel_id).or_default().push(entry);
        self.times = Some(self.times.map_or((time, time), |(first, last)| (first.min(time), last.max(time))));
        Ok(())
    }

    /// Appends the chunk and the index of its messages to `out`, which will be written at `position` in the file.
    pub(super) fn emit(
        &self,
        out: &mut Vec<u8>,
        position: u64,
        compression: Compression,
    ) -> io::Result<ChunkIndex> {
        let compressed;
        let (name, data) = match compression {
            Compression::None => ("", &self.content),
            Compression::Zstd => {
                compressed = zstd::compress(&self.content);
                ("zstd", &compressed)
            }
        };
        let (first, last) = self.times.unwrap_or((0, 0));
        let header = ChunkHeader {
            message_start_time: first,
            message_end_time: last,
            uncompressed_size: self.content.len() as u64,
            uncompressed_crc: crc32fast::hash(&self.content),
            compression: name.to_owned(),
            compressed_size: data.len() as u64,
        };
        let start = out.len();
        records::chunk(out, &header, data)?;
        let indexes = out.len();
        let mut message_index_offsets = BTreeMap::new();
        for (channel, entries) in &self.messages {
            message_index_offsets.insert(*channel, position + (out.len() - start) as u64);
            records::message_index(out, *channel, entries)?;
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
