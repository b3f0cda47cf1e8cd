//! Reads what a file contains from the summary at its end.

use std::io;

use mcap::MAGIC;
use mcap::records::{ChunkIndex, Footer, MetadataIndex, Record, Statistics, op};

use super::file::BagFile;
use super::message_index::declared_by_length;
use super::records::{Next, Place, RECORD_HEADER, RecordFile, parse};
use super::segment::{Segment, SegmentKind};

/// A footer record and the end mark: 9 + 20 + 8 bytes.
const ENDING: u64 = RECORD_HEADER + 20 + 8;

/// The state of the summary of a file.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum SummaryState {
    /// The summary is complete.
    Used,
    /// The file has none, or one without a message index, and is complete nevertheless.
    Absent,
    /// It is missing or inconsistent.
    Damaged,
}

#[derive(Default)]
struct Summary {
    statistics: Option<Statistics>,
    chunks: Vec<ChunkIndex>,
    metadata: Option<MetadataIndex>,
}

/// Adds the contents to `file` as its summary lists them, if it has a usable one.
pub(super) fn read_summary(file: &mut BagFile, input: &mut RecordFile) -> io::Result<SummaryState> {
    let Some(footer) = footer(input)? else { return Ok(SummaryState::Damaged) };
    if footer.summary_start == 0 {
        return Ok(SummaryState::Absent);
    }
    let end = input.length() - ENDING;
    if footer.summary_start < MAGIC.len() as u64 || footer.summary_start > end {
        return Ok(SummaryState::Damaged);
    }
    let mut summary = Summary::default();
    let mut offset = footer.summary_start;
    loop {
        match input.place_at(offset, end)? {
            Next::End => break,
            Next::Torn => return Ok(SummaryState::Damaged),
            Next::Record(place) => {
                if !add_record(file, input, &place, &mut summary)? {
                    return Ok(SummaryState::Damaged);
                }
                offset = place.end();
            }
        }
    }
    let Some(statistics) = summary.statistics else { return Ok(SummaryState::Absent) };
    let chunks = summary.chunks;
    if statistics.message_count > 0 && chunks.is_empty() {
        return Ok(SummaryState::Absent);
    }
    if !statistics.channel_message_counts.keys().all(|channel| describes(file, *channel)) {
        return Ok(SummaryState::Absent);
    }
    let declared = |chunk: &ChunkIndex| {
        declared_by_length(chunk.message_index_length, chunk.message_index_offsets.len() as u64)
    };
    let is_empty =
        |chunk: &&ChunkIndex| chunk.message_end_time == 0 && chunk.message_index_offsets.is_empty();
    let indexed = chunks.iter().filter(|chunk| !is_empty(chunk)).map(declared);
    let indexed = indexed.sum::<Option<u64>>();
    match indexed {
        // There are messages outside of chunks, or chunks that are not indexed.
        Some(indexed) if indexed < statistics.message_count => return Ok(SummaryState::Absent),
        Some(indexed) if indexed > statistics.message_count => return Ok(SummaryState::Damaged),
        _ => {}
    }
    let is_consistent = chunks.len() as u64 == u64::from(statistics.chunk_count)
        && statistics.channel_message_counts.values().fold(0_u64, |sum, n| sum.saturating_add(*n))
            == statistics.message_count
        && lie_apart(&chunks, footer.summary_start)
        && match footer.summary_crc {
            0 => are_chunks(input, &chunks)?,
            // It is right, whatever happened to the chunks.
            _ => is_checksum_right(input, &footer)?,
        };
    if !is_consistent {
        return Ok(SummaryState::Damaged);
    }
    file.counts = statistics.channel_message_counts;
    file.segments = chunks
        .iter()
        // A chunk with topics only has no messages to index, and times of 0.
        .filter(|chunk| chunk.message_end_time != 0 || !chunk.message_index_offsets.is_empty())
        .map(|chunk| {
            let channels = &chunk.message_index_offsets;
            Segment {
                offset: chunk.chunk_start_offset,
                length: chunk.chunk_length,
                first: chunk.message_start_time,
                last: chunk.message_end_time,
                // `None` means a chunk whose messages have no index.
                channels: (!channels.is_empty()).then(|| channels.keys().copied().collect()),
                kind: SegmentKind::Chunk,
                declared: declared(chunk),
                is_reported: false,
            }
        })
        .collect();
    if let Some(index) = summary.metadata
        && let Next::Record(place) = input.place_at(index.offset, footer.summary_start)?
    {
        file.add_metadata(&input.read_record(&place)?);
    }
    Ok(SummaryState::Used)
}

/// The footer, if the file ends correctly.
fn footer(input: &mut RecordFile) -> io::Result<Option<Footer>> {
    let length = input.length();
    if length < MAGIC.len() as u64 + ENDING {
        return Ok(None);
    }
    input.seek(length - ENDING)?;
    let ending = input.read(ENDING)?;
    let (footer, mark) = ending.split_at((RECORD_HEADER + 20) as usize);
    let is_footer = footer[0] == op::FOOTER && footer[1..9] == 20_u64.to_le_bytes();
    if mark != MAGIC || !is_footer {
        return Ok(None);
    }
    match parse(op::FOOTER, &footer[RECORD_HEADER as usize..]) {
        Ok(Record::Footer(footer)) => Ok(Some(footer)),
        _ => Ok(None),
    }
}

/// Returns `false` if the record is invalid.
fn add_record(
    file: &mut BagFile,
    input: &mut RecordFile,
    place: &Place,
    summary: &mut Summary,
) -> io::Result<bool> {
    let record = input.read_record(place)?;
    match parse(place.opcode, &record[RECORD_HEADER as usize..]) {
        Ok(Record::Schema { header, data }) => file.add_schema(header, &data),
        Ok(Record::Channel(channel)) => file.add_channel(channel),
        Ok(Record::Statistics(statistics)) => summary.statistics = Some(statistics),
        Ok(Record::ChunkIndex(chunk)) => summary.chunks.push(chunk),
        Ok(Record::MetadataIndex(index)) if index.name == "rosbag2" => summary.metadata = Some(index),
        Ok(_) => {}
        Err(_) => return Ok(false),
    }
    Ok(true)
}

/// Returns whether a channel and its schema, if it has one, are known: a summary need not repeat them.
fn describes(file: &BagFile, channel: u16) -> bool {
    let schema = file.channels.get(&channel).map(|channel| channel.schema_id);
    schema.is_some_and(|schema| schema == 0 || file.schemas.contains_key(&schema))
}

/// Whether the checksum of the summary is right.
fn is_checksum_right(input: &mut RecordFile, footer: &Footer) -> io::Result<bool> {
    // Up to the checksum itself, which is the last field of the footer.
    let end = input.length() - MAGIC.len() as u64 - 4;
    input.seek(footer.summary_start)?;
    let mut hasher = crc32fast::Hasher::new();
    let mut left = end.saturating_sub(footer.summary_start);
    while left > 0 {
        let bytes = input.read(left.min(1024 * 1024))?;
        hasher.update(&bytes);
        left -= bytes.len() as u64;
    }
    Ok(hasher.finalize() == footer.summary_crc)
}

/// Returns whether the chunks are before `end` and do not overlap.
fn lie_apart(chunks: &[ChunkIndex], end: u64) -> bool {
    let mut places: Vec<_> =
        chunks.iter().map(|chunk| (chunk.chunk_start_offset, chunk.chunk_length)).collect();
    places.sort_unstable();
    let ends = places.iter().map(|(start, length)| start.checked_add(*length));
    let limits = places.iter().skip(1).map(|(start, _)| *start).chain([end]);
    ends.zip(limits).all(|(end, limit)| end.is_some_and(|end| end <= limit))
}

/// Returns whether a chunk starts at each of the places: an index may point elsewhere.
fn are_chunks(input: &mut RecordFile, chunks: &[ChunkIndex]) -> io::Result<bool> {
    for chunk in chunks {
        let length = chunk.chunk_length;
        match input.place_at(chunk.chunk_start_offset, chunk.chunk_start_offset.saturating_add(length))? {
            Next::Record(place)
                if place.opcode == op::CHUNK && RECORD_HEADER + place.body_length == length => {}
            _ => return Ok(false),
        }
    }
    Ok(true)
}
