//! The contents of one file of a bag: its topics, and where its messages are.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use mcap::records::{self, Record, op};

use super::error::{Truncation, TruncationCause};
use super::message_index::MessageIndex;
use super::records::{RECORD_HEADER, are_ros_times, parse};
use super::segment::{Content, Damage, Segment, SegmentKind, decode};
use super::source::Source;
use crate::storage::Storage;

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

    pub(super) fn add_schema(&mut self, header: records::SchemaHeader, data: &[u8]) {
        self.schemas.entry(header.id).or_insert_with(|| Schema {
            name: header.name,
            encoding: header.encoding,
            data: data.to_vec(),
        });
    }

    pub(super) fn add_channel(&mut self, channel: records::Channel) {
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

/// The approximate memory of a channel.
fn length_of(channel: &records::Channel) -> usize {
    let entry = |(key, value): (&String, &String)| key.len() + value.len() + 64;
    channel.topic.len() + channel.message_encoding.len() + channel.metadata.iter().map(entry).sum::<usize>()
}
