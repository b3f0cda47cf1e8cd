//! The summary at the end of an MCAP file.

use std::collections::BTreeMap;
use std::io;

use mcap::records::{ChunkIndex, MetadataIndex, Statistics, op};

use super::channels::Channels;
use super::chunk::Chunk;
use super::{McapOptions, records};

#[derive(Default)]
pub(super) struct Summary {
    /// The number of written messages by channel.
    counts: BTreeMap<u16, u64>,
    /// Their earliest and latest log time.
    times: Option<(u64, u64)>,
    chunks: Vec<ChunkIndex>,
    metadata: Vec<MetadataIndex>,
    metadata_count: u32,
}

impl Summary {
    /// Adds a written chunk.
    pub(super) fn add(&mut self, chunk: &Chunk, index: Option<ChunkIndex>) {
        self.chunks.extend(index);
        for (channel, count) in chunk.counts() {
            *self.counts.entry(channel).or_default() += count;
        }
        self.times = match (self.times, chunk.times()) {
            (Some(a), Some(b)) => Some((a.0.min(b.0), a.1.max(b.1))),
            (one, other) => one.or(other),
        };
    }

    pub(super) fn add_metadata(&mut self, index: MetadataIndex) {
        self.metadata.push(index);
        self.metadata_count = self.metadata_count.saturating_add(1);
    }

    /// Appends summary, footer and end mark to `out`, which will be written at `position` in the file.
    pub(super) fn emit(
        &self,
        out: &mut Vec<u8>,
        position: u64,
        channels: &Channels,
        options: &McapOptions,
    ) -> io::Result<()> {
        if !options.has_summary {
            Self::emit_none(out);
            return Ok(());
        }
        let begin = out.len();
        let mut groups = Vec::new();
        let mut group =
            |opcode, wanted: bool, out: &mut Vec<u8>, write: &dyn Fn(&mut Vec<u8>) -> io::Result<()>| {
                let start = out.len();
                if wanted {
                    write(out)?;
                }
                if out.len() > start {
                    groups.push((opcode, position + start as u64, (out.len() - start) as u64));
                }
                io::Result::Ok(())
            };
        group(op::SCHEMA, options.repeats_schemas, out, &|out| {
            channels.repeat_schemas(out);
            Ok(())
        })?;
        group(op::CHANNEL, options.repeats_channels, out, &|out| {
            channels.repeat_channels(out);
            Ok(())
        })?;
        group(op::STATISTICS, options.has_statistics, out, &|out| {
            records::statistics(out, &self.statistics(channels))
        })?;
        group(op::CHUNK_INDEX, options.has_chunk_index, out, &|out| {
            self.chunks.iter().try_for_each(|index| records::chunk_index(out, index))
        })?;
        group(op::METADATA_INDEX, options.has_metadata_index, out, &|out| {
            self.metadata.iter().try_for_each(|index| records::metadata_index(out, index))
        })?;
        let offsets = out.len();
        let mut offsets_start = 0;
        if options.has_summary_offsets && !groups.is_empty() {
            offsets_start = position + offsets as u64;
            for (opcode, start, length) in groups {
                records::summary_offset(out, opcode, start, length)?;
            }
        }
        // An empty summary is omitted.
        let summary_start = if out.len() > begin { position + begin as u64 } else { 0 };
        // The checksum covers the summary and the footer up to the checksum.
        let checksum = |out: &[u8]| {
            let summary = out.get(begin..).unwrap_or_default();
            if options.has_summary_crc { crc32fast::hash(summary) } else { 0 }
        };
        footer(out, summary_start, offsets_start, checksum);
        Ok(())
    }

    /// Appends the end of a file without a summary.
    pub(super) fn emit_none(out: &mut Vec<u8>) {
        footer(out, 0, 0, |_| 0);
    }

    fn statistics(&self, channels: &Channels) -> Statistics {
        let (message_start_time, message_end_time) = self.times.unwrap_or((0, 0));
        Statistics {
            message_count: self.counts.values().sum(),
            schema_count: u16::try_from(channels.schema_count()).unwrap_or(u16::MAX),
            channel_count: u32::try_from(channels.channel_count()).unwrap_or(u32::MAX),
            attachment_count: 0,
            metadata_count: self.metadata_count,
            chunk_count: u32::try_from(self.chunks.len()).unwrap_or(u32::MAX),
            message_start_time,
            message_end_time,
            channel_message_counts: self.counts.clone(),
        }
    }
}

fn footer(out: &mut Vec<u8>, summary: u64, offsets: u64, checksum: impl FnOnce(&[u8]) -> u32) {
    out.push(op::FOOTER);
    out.extend_from_slice(&20_u64.to_le_bytes());
    out.extend_from_slice(&summary.to_le_bytes());
    out.extend_from_slice(&offsets.to_le_bytes());
    let crc = checksum(out);
    out.extend_from_slice(&crc.to_le_bytes());
    out.extend_from_slice(mcap::MAGIC);
}
