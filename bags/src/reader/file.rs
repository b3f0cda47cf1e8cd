//! The contents of one MCAP file: from its summary, or from scanning the whole file if there is none.

use std::collections::{BTreeMap, HashMap};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::MAGIC;
use mcap::records::{self, ChunkIndex, Footer, MetadataIndex, Record, Statistics, op};

use super::error::{ReaderError, Truncation, TruncationCause};
use super::message_index::{MessageIndex, declared_by_length};
use super::records::{Next, Place, RECORD_HEADER, RecordFile, are_ros_times, parse};
use super::segment::{Content, Damage, Segment, SegmentKind, decode};
use super::source::{self, Source};
use super::walk::walk;
use crate::storage::Storage;

/// A footer record and the end mark: 9 + 20 + 8 bytes.
const ENDING: u64 = RECORD_HEADER + 20 + 8;

/// The maximum size of schemas and channels of a file in decompressed chunks, against files designed to
/// exhaust memory.
pub(super) const MOST_DESCRIBED: usize = 64 * 1024 * 1024;

/// The contents of one file.
#[derive(Debug)]
pub(super) struct BagFile {
    pub(super) path: PathBuf,
    pub(super) storage: Storage,
    /// The source of its content; the decompressed data if the file is compressed as a whole.
    pub(super) source: Source,
    pub(super) length: u64,
    pub(super) schemas: HashMap<u16, Schema>,
    pub(super) channels: Arc<BTreeMap<u16, records::Channel>>,
    /// Bytes of schemas and channels found in chunks.
    described: usize,
    /// Messages of each channel.
    pub(super) counts: BTreeMap<u16, u64>,
    /// In file order.
    pub(super) segments: Vec<Segment>,
    pub(super) truncations: Vec<Truncation>,
    /// The text of the last metadata record of rosbag2.
    pub(super) metadata: Option<String>,
}

/// What was found in a segment.
pub(super) struct Looked {
    /// The first and last log time.
    pub(super) times: Option<(u64, u64)>,
    pub(super) messages: u64,
    pub(super) read: Result<(), Damage>,
}

#[derive(Debug)]
pub(super) struct Schema {
    pub(super) name: String,
    pub(super) encoding: String,
    pub(super) data: Vec<u8>,
}

impl BagFile {
    /// Opens a file by its first bytes: MCAP, SQLite, or either compressed as a whole. `path` is for errors;
    /// the bytes are those of `source`.
    pub(super) fn open(path: &Path, source: Source) -> Result<Self, ReaderError> {
        let read = |source| ReaderError::Read { path: path.to_owned(), source };
        let start = source.start(16).map_err(read)?;
        if !start.starts_with(source::PACKED_MAGIC) {
            return Self::open_content(path, source, &start);
        }
        let (content, problem) = source::unpack_file(&source).map_err(read)?;
        let start = content.start(16).map_err(read)?;
        let mut file = Self::open_content(path, content, &start)?;
        if let Some((length, found)) = problem {
            file.miss(length, 0, TruncationCause::Packed(found));
        }
        Ok(file)
    }

    fn open_content(path: &Path, source: Source, start: &[u8]) -> Result<Self, ReaderError> {
        if start.starts_with(SQLITE_MAGIC) {
            return open_sqlite(path, source);
        }
        let read = |source| ReaderError::Read { path: path.to_owned(), source };
        let start = &start[..start.len().min(MAGIC.len())];
        // A file that ends within the first mark: recording was interrupted at once.
        if !MAGIC.starts_with(start) {
            return Err(ReaderError::NotMcap { path: path.to_owned(), found: start.to_vec() });
        }
        let mut input = RecordFile::open(&source).map_err(read)?;
        let mut file = Self::empty(path, source.clone(), input.length());
        let summary = file.read_summary(&mut input).map_err(read)?;
        if summary != SummaryState::Used {
            file = Self::empty(path, source, input.length());
            walk(&mut file, &mut input, summary).map_err(read)?;
        }
        Ok(file)
    }

    pub(super) fn empty(path: &Path, source: Source, length: u64) -> Self {
        Self {
            path: path.to_owned(),
            storage: Storage::Mcap,
            source,
            length,
            schemas: HashMap::new(),
            channels: Arc::default(),
            described: 0,
            counts: BTreeMap::new(),
            segments: Vec::new(),
            truncations: Vec::new(),
            metadata: None,
        }
    }

    fn read_summary(&mut self, input: &mut RecordFile) -> io::Result<SummaryState> {
        let Some(footer) = footer(input)? else { return Ok(SummaryState::Damaged) };
        if footer.summary_start == 0 {
            return Ok(SummaryState::Absent);
        }
        let end = self.length - ENDING;
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
                    if !self.add_summary_record(input, &place, &mut summary)? {
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
        if !statistics.channel_message_counts.keys().all(|channel| self.describes(*channel)) {
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
                _ => self.is_checksum_right(input, &footer)?,
            };
        if !is_consistent {
            return Ok(SummaryState::Damaged);
        }
        self.counts = statistics.channel_message_counts;
        self.segments = chunks
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
            self.add_metadata(&input.read_record(&place)?);
        }
        Ok(SummaryState::Used)
    }

    /// Whether the checksum of the summary is right.
    fn is_checksum_right(&self, input: &mut RecordFile, footer: &Footer) -> io::Result<bool> {
        // Up to the checksum itself, which is the last field of the footer.
        let end = self.length - MAGIC.len() as u64 - 4;
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

    /// Returns whether a channel and its schema, if it has one, are known: a summary need not repeat them.
    fn describes(&self, channel: u16) -> bool {
        let schema = self.channels.get(&channel).map(|channel| channel.schema_id);
        schema.is_some_and(|schema| schema == 0 || self.schemas.contains_key(&schema))
    }

    /// Returns `false` if the record is invalid.
    fn add_summary_record(
        &mut self,
        input: &mut RecordFile,
        place: &Place,
        summary: &mut Summary,
    ) -> io::Result<bool> {
        let record = input.read_record(place)?;
        match parse(place.opcode, &record[RECORD_HEADER as usize..]) {
            Ok(Record::Schema { header, data }) => self.add_schema(header, &data),
            Ok(Record::Channel(channel)) => self.add_channel(channel),
            Ok(Record::Statistics(statistics)) => summary.statistics = Some(statistics),
            Ok(Record::ChunkIndex(chunk)) => summary.chunks.push(chunk),
            Ok(Record::MetadataIndex(index)) if index.name == "rosbag2" => summary.metadata = Some(index),
            Ok(_) => {}
            Err(_) => return Ok(false),
        }
        Ok(true)
    }

    /// Adds the contents of a segment as far as it can be read.
    pub(super) fn look_into(
        &mut self,
        bytes: &[u8],
        segment: (SegmentKind, Option<u64>),
        index: impl FnOnce() -> MessageIndex,
    ) -> Looked {
        let mut times: Option<(u64, u64)> = None;
        let mut messages = 0;
        let mut is_described = true;
        let mut read = decode(bytes, segment, index, |content| match content {
            Content::Schema { header, .. } if self.schemas.contains_key(&header.id) => {}
            Content::Channel(channel) if self.channels.contains_key(&channel.id) => {}
            Content::Schema { header, data } => {
                if self.describe_more(data.len(), &mut is_described) {
                    self.add_schema(header, data);
                }
            }
            Content::Channel(channel) => {
                if self.describe_more(length_of(&channel), &mut is_described) {
                    self.add_channel(channel);
                }
            }
            Content::Message { header, .. } => {
                if are_ros_times(header.log_time, header.publish_time) {
                    *self.counts.entry(header.channel_id).or_default() += 1;
                }
                messages += 1;
                let time = header.log_time;
                times = Some(times.map_or((time, time), |(first, last)| (first.min(time), last.max(time))));
            }
        });
        if !is_described {
            let found = format!("it brings schemas and channels to more than {MOST_DESCRIBED} bytes");
            read = Err(Damage::undescribed(found));
        }
        Looked { times, messages, read }
    }

    /// Counts bytes of schemas and channels; returns false if they are too many.
    fn describe_more(&mut self, length: usize, is_described: &mut bool) -> bool {
        let described = self.described.saturating_add(length);
        if described > MOST_DESCRIBED {
            *is_described = false;
            return false;
        }
        self.described = described;
        true
    }

    /// The text about the damage of a segment.
    pub(super) fn describe(&self, damage: &Damage) -> String {
        damage.describe(|channel| self.channels.get(&channel).map(|channel| channel.topic.as_str()))
    }

    fn add_schema(&mut self, header: records::SchemaHeader, data: &[u8]) {
        self.schemas.entry(header.id).or_insert_with(|| Schema {
            name: header.name,
            encoding: header.encoding,
            data: data.to_vec(),
        });
    }

    fn add_channel(&mut self, channel: records::Channel) {
        Arc::make_mut(&mut self.channels).entry(channel.id).or_insert(channel);
    }

    /// Keeps the text if the record is that of rosbag2: the last one in the file was written at the end.
    pub(super) fn add_metadata(&mut self, record: &[u8]) {
        let Some(body) = record.get(RECORD_HEADER as usize..) else { return };
        if let Ok(Record::Metadata(mut metadata)) = parse(op::METADATA, body)
            && metadata.name == "rosbag2"
            && let Some(text) = metadata.metadata.remove("serialized_metadata")
        {
            self.metadata = Some(text);
        }
    }

    pub(super) fn miss(&mut self, offset: u64, lost_bytes: u64, cause: TruncationCause) {
        self.truncations.push(Truncation { path: self.path.clone(), offset, lost_bytes, cause });
    }
}

/// The first bytes of an SQLite file.
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

#[cfg(feature = "sqlite")]
fn open_sqlite(path: &Path, source: Source) -> Result<BagFile, ReaderError> {
    super::sqlite::open(path, source)
}

#[cfg(not(feature = "sqlite"))]
fn open_sqlite(path: &Path, _source: Source) -> Result<BagFile, ReaderError> {
    let found = "it is an SQLite file, and this program is built without \"sqlite\": build with --features sqlite, which needs a \
                 C compiler"
        .to_owned();
    Err(ReaderError::Unsupported { path: path.to_owned(), found })
}

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

/// The approximate memory of a channel.
fn length_of(channel: &records::Channel) -> usize {
    let entry = |(key, value): (&String, &String)| key.len() + value.len() + 64;
    channel.topic.len() + channel.message_encoding.len() + channel.metadata.iter().map(entry).sum::<usize>()
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
