//! What one MCAP file holds and where: from its summary, or from a walk through the whole file where there is none.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use mcap::MAGIC;
use mcap::records::{self, ChunkIndex, Footer, MetadataIndex, Record, Statistics, op};

use tempfile::TempPath;

use super::error::{ReaderError, Truncation, TruncationCause};
use super::packed;
use super::records::{Next, Place, RECORD_HEADER, RecordFile, has_plausible_length};
use super::segment::{Content, Segment, decode};
use super::walk::walk;
use crate::storage::Storage;

/// A footer record and the end mark: 9 + 20 + 8 bytes.
const ENDING: u64 = RECORD_HEADER + 20 + 8;

/// What one file holds.
#[derive(Debug)]
pub(super) struct BagFile {
    pub(super) path: PathBuf,
    pub(super) storage: Storage,
    /// What came out of a file that is compressed as a whole; deleted with this.
    pub(super) unpacked: Option<TempPath>,
    pub(super) length: u64,
    pub(super) schemas: HashMap<u16, Schema>,
    pub(super) channels: BTreeMap<u16, records::Channel>,
    /// Messages of each channel.
    pub(super) counts: BTreeMap<u16, u64>,
    /// In file order.
    pub(super) segments: Vec<Segment>,
    pub(super) truncations: Vec<Truncation>,
    /// The text of the last metadata record of rosbag2.
    pub(super) metadata: Option<String>,
}

#[derive(Debug)]
pub(super) struct Schema {
    pub(super) name: String,
    pub(super) encoding: String,
    pub(super) data: Vec<u8>,
}

impl BagFile {
    /// Opens a file by what it begins with: MCAP, SQLite, or either compressed as a whole.
    pub(super) fn open(path: &Path) -> Result<Self, ReaderError> {
        let read = |source| ReaderError::Read { path: path.to_owned(), source };
        let mut start = Vec::new();
        File::open(path).and_then(|file| file.take(16).read_to_end(&mut start)).map_err(read)?;
        if !start.starts_with(packed::MAGIC) {
            return Self::open_content(path, path, &start);
        }
        let (unpacked, problem) = packed::unpack(path)?;
        let mut start = Vec::new();
        File::open(&unpacked).and_then(|file| file.take(16).read_to_end(&mut start)).map_err(read)?;
        let mut file = Self::open_content(path, &unpacked, &start)?;
        if let Some((length, found)) = problem {
            file.miss(length, 0, TruncationCause::Packed(found));
        }
        file.unpacked = Some(unpacked);
        Ok(file)
    }

    /// `path` is for errors; the content is that of `data`.
    fn open_content(path: &Path, data: &Path, start: &[u8]) -> Result<Self, ReaderError> {
        if start.starts_with(SQLITE_MAGIC) {
            return open_sqlite(path, data);
        }
        let read = |source| ReaderError::Read { path: path.to_owned(), source };
        let mut input = File::open(data).and_then(RecordFile::new).map_err(read)?;
        let start = &start[..start.len().min(MAGIC.len())];
        // A file that ends within the first mark is one whose recording was interrupted at once.
        if !MAGIC.starts_with(start) {
            return Err(ReaderError::NotMcap { path: path.to_owned(), found: start.to_vec() });
        }
        let mut file = Self::empty(path, input.length());
        let summary = file.read_summary(&mut input).map_err(read)?;
        if summary != SummaryState::Used {
            file = Self::empty(path, input.length());
            walk(&mut file, &mut input, summary).map_err(read)?;
        }
        Ok(file)
    }

    /// Where its content is to be read.
    pub(super) fn data_path(&self) -> &Path {
        self.unpacked.as_deref().unwrap_or(&self.path)
    }

    pub(super) fn empty(path: &Path, length: u64) -> Self {
        Self {
            path: path.to_owned(),
            storage: Storage::Mcap,
            unpacked: None,
            length,
            schemas: HashMap::new(),
            channels: BTreeMap::new(),
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
                Next::Torn { .. } => return Ok(SummaryState::Damaged),
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
        let is_consistent = chunks.len() as u64 == u64::from(statistics.chunk_count)
            && statistics.channel_message_counts.values().fold(0_u64, |sum, n| sum.saturating_add(*n))
                == statistics.message_count
            && chunks.iter().all(|chunk| {
                let end = chunk.chunk_start_offset.checked_add(chunk.chunk_length);
                end.is_some_and(|end| end <= footer.summary_start)
            });
        if !is_consistent {
            return Ok(SummaryState::Damaged);
        }
        self.counts = statistics.channel_message_counts;
        self.segments = chunks
            .iter()
            // A chunk that holds only topics has no messages to index, and times of 0.
            .filter(|chunk| chunk.message_end_time != 0 || !chunk.message_index_offsets.is_empty())
            .map(|chunk| Segment {
                offset: chunk.chunk_start_offset,
                length: chunk.chunk_length,
                first: chunk.message_start_time,
                last: chunk.message_end_time,
            })
            .collect();
        if let Some(index) = summary.metadata
            && let Next::Record(place) = input.place_at(index.offset, footer.summary_start)?
        {
            self.add_metadata(&input.read_record(&place)?);
        }
        Ok(SummaryState::Used)
    }

    /// `false` if the record is not as it should be.
    fn add_summary_record(
        &mut self,
        input: &mut RecordFile,
        place: &Place,
        summary: &mut Summary,
    ) -> io::Result<bool> {
        if !has_plausible_length(place.opcode, place.body_length) {
            return Ok(false);
        }
        let record = input.read_record(place)?;
        match mcap::parse_record(place.opcode, &record[RECORD_HEADER as usize..]) {
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

    /// Takes over what a segment holds, if it can be read as a whole; returns the first and last log time.
    pub(super) fn look_into(&mut self, bytes: &[u8]) -> Result<Option<(u64, u64)>, String> {
        let mut found = Self::empty(&self.path, 0);
        let mut times: Option<(u64, u64)> = None;
        decode(bytes, |content| match content {
            Content::Schema { header, data } => found.add_schema(header, data),
            Content::Channel(channel) => found.add_channel(channel),
            Content::Message { header, .. } => {
                *found.counts.entry(header.channel_id).or_default() += 1;
                let time = header.log_time;
                times = Some(times.map_or((time, time), |(first, last)| (first.min(time), last.max(time))));
            }
        })?;
        for (id, schema) in found.schemas {
            self.schemas.entry(id).or_insert(schema);
        }
        for (id, channel) in found.channels {
            self.channels.entry(id).or_insert(channel);
        }
        for (id, count) in found.counts {
            *self.counts.entry(id).or_default() += count;
        }
        Ok(times)
    }

    fn add_schema(&mut self, header: records::SchemaHeader, data: &[u8]) {
        self.schemas.entry(header.id).or_insert_with(|| Schema {
            name: header.name,
            encoding: header.encoding,
            data: data.to_vec(),
        });
    }

    fn add_channel(&mut self, channel: records::Channel) {
        self.channels.entry(channel.id).or_insert(channel);
    }

    /// Keeps the text if the record is that of rosbag2: the last one in the file is the one that was written at the end.
    pub(super) fn add_metadata(&mut self, record: &[u8]) {
        let Some(body) = record.get(RECORD_HEADER as usize..) else { return };
        if let Ok(Record::Metadata(mut metadata)) = mcap::parse_record(op::METADATA, body)
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

/// What an SQLite file begins with.
const SQLITE_MAGIC: &[u8] = b"SQLite format 3\0";

#[cfg(feature = "sqlite")]
fn open_sqlite(path: &Path, data: &Path) -> Result<BagFile, ReaderError> {
    super::sqlite::open(path, data)
}

#[cfg(not(feature = "sqlite"))]
fn open_sqlite(path: &Path, _data: &Path) -> Result<BagFile, ReaderError> {
    let found = "it is an SQLite file, which this build does not read; build with `--features sqlite`, which needs a C \
                 compiler"
        .to_owned();
    Err(ReaderError::Unsupported { path: path.to_owned(), found })
}

/// What the summary of a file is good for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum SummaryState {
    /// It told everything.
    Used,
    /// The file has none, or one without an index of its messages, and is whole nevertheless.
    Absent,
    /// It should be there and is not, or contradicts itself.
    Damaged,
}

#[derive(Default)]
struct Summary {
    statistics: Option<Statistics>,
    chunks: Vec<ChunkIndex>,
    metadata: Option<MetadataIndex>,
}

/// The footer, if the file ends as it should.
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
    match mcap::parse_record(op::FOOTER, &footer[RECORD_HEADER as usize..]) {
        Ok(Record::Footer(footer)) => Ok(Some(footer)),
        _ => Ok(None),
    }
}
