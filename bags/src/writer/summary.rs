//! The end of an MCAP file: what it holds and where.

use std::collections::BTreeMap;
use std::io;

use downbeat_msgs::encoding::Schema;
use mcap::records::{ChunkIndex, MetadataIndex, Statistics, op};

use super::records;
use crate::topic::TopicInfo;

#[derive(Default)]
pub(super) struct Summary {
    /// The id of a schema is its position, counted from 1: 0 means none.
    schemas: Vec<Schema>,
    /// The records of all schemas, and of all channels.
    schema_records: Vec<u8>,
    channel_records: Vec<u8>,
    channels: u16,
    /// Messages in finished chunks.
    counts: BTreeMap<u16, u64>,
    chunks: Vec<ChunkIndex>,
    metadata: Vec<MetadataIndex>,
}

impl Summary {
    /// Returns the channel of the topic, and appends to `out` the records that tell of it.
    pub(super) fn add_topic(
        &mut self,
        topic: &TopicInfo,
        metadata: &BTreeMap<String, String>,
        out: &mut Vec<u8>,
    ) -> io::Result<u16> {
        let too_many = |_| io::Error::other("MCAP has no place for more types");
        let of_topic = topic.schema();
        let known = self.schemas.iter().position(|schema| *schema == of_topic);
        let schema = u16::try_from(known.unwrap_or(self.schemas.len()) + 1).map_err(too_many)?;
        let mut of_schema = Vec::new();
        if known.is_none() {
            records::schema(&mut of_schema, schema, &of_topic)?;
        }
        let channel = self.channels;
        let mut of_channel = Vec::new();
        records::channel(&mut of_channel, channel, schema, topic, metadata)?;

        if known.is_none() {
            self.schemas.push(of_topic);
        }
        self.channels += 1;
        self.schema_records.extend_from_slice(&of_schema);
        self.channel_records.extend_from_slice(&of_channel);
        out.extend_from_slice(&of_schema);
        out.extend_from_slice(&of_channel);
        Ok(channel)
    }

    pub(super) fn add_chunk(&mut self, index: ChunkIndex, counts: impl Iterator<Item = (u16, u64)>) {
        self.chunks.push(index);
        for (channel, count) in counts {
            *self.counts.entry(channel).or_default() += count;
        }
    }

    pub(super) fn add_metadata(&mut self, index: MetadataIndex) {
        self.metadata.push(index);
    }

    /// Appends summary, footer and end mark to `out`, which will be written at `position` in the file.
    pub(super) fn emit(&self, out: &mut Vec<u8>, position: u64) -> io::Result<()> {
        let begin = out.len();
        let mut groups = Vec::new();
        let mut group = |opcode, out: &mut Vec<u8>, write: &dyn Fn(&mut Vec<u8>) -> io::Result<()>| {
            let start = out.len();
            write(out)?;
            if out.len() > start {
                groups.push((opcode, position + start as u64, (out.len() - start) as u64));
            }
            io::Result::Ok(())
        };
        group(op::SCHEMA, out, &|out| io::Write::write_all(out, &self.schema_records))?;
        group(op::CHANNEL, out, &|out| io::Write::write_all(out, &self.channel_records))?;
        group(op::STATISTICS, out, &|out| records::statistics(out, &self.statistics()))?;
        group(op::CHUNK_INDEX, out, &|out| {
            self.chunks.iter().try_for_each(|index| records::chunk_index(out, index))
        })?;
        group(op::METADATA_INDEX, out, &|out| {
            self.metadata.iter().try_for_each(|index| records::metadata_index(out, index))
        })?;
        let offsets = out.len();
        for (opcode, start, length) in groups {
            records::summary_offset(out, opcode, start, length)?;
        }
        // The checksum covers the summary and the footer up to the checksum.
        footer(out, position + begin as u64, position + offsets as u64, |out| crc32fast::hash(&out[begin..]));
        Ok(())
    }

    /// Ends a file that has no summary.
    pub(super) fn emit_none(out: &mut Vec<u8>) {
        footer(out, 0, 0, |_| 0);
    }

    fn statistics(&self) -> Statistics {
        let with_messages = || self.chunks.iter().filter(|chunk| !chunk.message_index_offsets.is_empty());
        Statistics {
            message_count: self.counts.values().sum(),
            schema_count: u16::try_from(self.schemas.len()).unwrap_or(u16::MAX),
            channel_count: u32::from(self.channels),
            attachment_count: 0,
            metadata_count: u32::try_from(self.metadata.len()).unwrap_or(u32::MAX),
            chunk_count: u32::try_from(self.chunks.len()).unwrap_or(u32::MAX),
            message_start_time: with_messages().map(|chunk| chunk.message_start_time).min().unwrap_or(0),
            message_end_time: with_messages().map(|chunk| chunk.message_end_time).max().unwrap_or(0),
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
