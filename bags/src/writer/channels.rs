//! The schemas and channels of a file: written before the first message of each, and again in the summary.
//!
//! Like the MCAP C++ library, so that a topic without messages takes space only in the summary.

use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, HashMap};
use std::hash::{Hash, Hasher};
use std::io;

use downbeat_msgs::encoding::Schema;

use super::split::WrittenFile;
use super::summary::Times;
use super::{Topic, Writer, records};
use crate::metadata::{self, FileMetadata, Metadata, TopicMetadata, recorded_qos_to_yaml};
use crate::topic::{RecordingSummary, TopicCount, TopicDescription};

#[derive(Default)]
pub(super) struct Channels {
    schemas: Vec<Described>,
    /// The positions of schemas by a hash of their contents.
    by_hash: HashMap<u64, Vec<usize>>,
    channels: Vec<Channel>,
}

/// A record, and whether it is already in the file.
struct Described {
    schema: Schema,
    record: Vec<u8>,
    written: Written,
}

struct Channel {
    /// The index of its schema.
    schema: usize,
    record: Vec<u8>,
    written: Written,
}

/// Where a record has been written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Written {
    No,
    /// In the open chunk, which may never be written.
    InChunk,
    InFile,
}

impl Channels {
    /// Returns the channel of the topic, numbered from 1 like in the C++ library.
    pub(super) fn add(&mut self, topic: &TopicDescription) -> io::Result<u16> {
        let mut metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), recorded_qos_to_yaml(&topic.offered_qos)),
            ("topic_type_hash".to_owned(), topic.type_hash.clone()),
        ]);
        if topic.format.is_some() {
            // The name of the schema may differ.
            metadata.insert("topic_type".to_owned(), topic.type_name.clone());
        }
        let too_many = |_| io::Error::other("MCAP does not support more types and topics");
        let schema = topic.schema();
        let mut hasher = DefaultHasher::new();
        (&schema.name, &schema.encoding, &schema.data).hash(&mut hasher);
        let alike = self.by_hash.entry(hasher.finish()).or_default();
        let known = alike.iter().copied().find(|at| self.schemas[*at].schema == schema);
        let schema_index = known.unwrap_or(self.schemas.len());
        let schema_id = u16::try_from(schema_index + 1).map_err(too_many)?;
        let id = u16::try_from(self.channels.len() + 1).map_err(too_many)?;
        let mut record = Vec::new();
        records::channel(&mut record, id, schema_id, topic, &metadata)?;
        if known.is_none() {
            let mut record = Vec::new();
            records::schema(&mut record, schema_id, &schema)?;
            alike.push(schema_index);
            self.schemas.push(Described { schema, record, written: Written::No });
        }
        self.channels.push(Channel { schema: schema_index, record, written: Written::No });
        Ok(id)
    }

    /// Appends the schema and channel records that must precede a message of that channel to the open chunk.
    pub(super) fn write_records(&mut self, channel: u16, out: &mut Vec<u8>) {
        let Some(channel) = usize::from(channel).checked_sub(1).and_then(|at| self.channels.get_mut(at))
        else {
            return;
        };
        if channel.written != Written::No {
            return;
        }
        if let Some(schema) =
            self.schemas.get_mut(channel.schema).filter(|schema| schema.written == Written::No)
        {
            out.extend_from_slice(&schema.record);
            schema.written = Written::InChunk;
        }
        out.extend_from_slice(&channel.record);
        channel.written = Written::InChunk;
    }

    /// Called when the open chunk has been written.
    pub(super) fn keep(&mut self) {
        self.settle(Written::InFile);
    }

    /// Called when the open chunk is dropped.
    pub(super) fn forget(&mut self) {
        self.settle(Written::No);
    }

    fn settle(&mut self, becomes: Written) {
        let schemas = self.schemas.iter_mut().map(|schema| &mut schema.written);
        let channels = self.channels.iter_mut().map(|channel| &mut channel.written);
        for written in schemas.chain(channels).filter(|written| **written == Written::InChunk) {
            *written = becomes;
        }
    }

    /// The number of schemas in the file.
    pub(super) fn schema_count(&self) -> usize {
        self.schemas.iter().filter(|schema| schema.written == Written::InFile).count()
    }

    /// The number of channels in the file.
    pub(super) fn channel_count(&self) -> usize {
        self.channels.iter().filter(|channel| channel.written == Written::InFile).count()
    }

    /// Appends all schema records.
    pub(super) fn repeat_schemas(&self, out: &mut Vec<u8>) {
        self.schemas.iter().for_each(|schema| out.extend_from_slice(&schema.record));
    }

    /// Appends all channel records.
    pub(super) fn repeat_channels(&self, out: &mut Vec<u8>) {
        self.channels.iter().for_each(|channel| out.extend_from_slice(&channel.record));
    }
}

/// The key of `custom_data` for the numbers of lost messages: `/camera: 12, /imu: 1`.
const LOST_MESSAGES: &str = "lost_messages";
/// The key of `custom_data` for the number of messages in deleted files.
const DELETED_MESSAGES: &str = "deleted_messages";

impl Writer {
    /// The messages passed to the operating system so far, without the open chunk.
    #[must_use]
    pub fn summary(&self) -> RecordingSummary {
        let times = self.times();
        RecordingSummary {
            path: self.directory.clone(),
            bytes: self.file.kept() + self.files.iter().map(|file| file.bytes).sum::<u64>(),
            files: self.files.len(),
            deleted: self.deleted,
            starting_time: times.first(),
            duration: times.duration(),
            topics: self
                .topics
                .iter()
                .map(|topic| TopicCount {
                    name: topic.info.name.clone(),
                    type_name: topic.info.type_name.clone(),
                    written: topic.written,
                    lost: topic.lost,
                })
                .collect(),
        }
    }

    /// The number of changes of [`summary`](Self::summary).
    pub(crate) fn changes(&self) -> u64 {
        self.changes
    }

    pub(super) fn metadata(&self) -> Metadata {
        let times = self.times();
        Metadata {
            version: metadata::FORMAT_VERSION,
            storage_identifier: self.storage().identifier().to_owned(),
            duration: times.duration(),
            starting_time: times.first().unwrap_or(metadata::NEVER),
            message_count: self.topics.iter().map(|topic| topic.written).sum(),
            topics: self.topics.iter().map(topic_metadata).collect(),
            compression_format: String::new(),
            compression_mode: String::new(),
            relative_file_paths: self.files.iter().map(|file| file.name.clone()).collect(),
            files: self.files.iter().map(file_metadata).collect(),
            custom_data: self.custom_data(),
            oddities: Vec::new(),
            ros_distro: metadata::ROS_DISTRO.to_owned(),
        }
    }

    fn custom_data(&self) -> BTreeMap<String, String> {
        let mut custom_data = self.options.custom_data.clone();
        let counted = self.options.counted_data.iter().map(|(key, value)| (key.clone(), (value.0)()));
        custom_data.extend(counted);
        let lost = |topic: &Topic| {
            let lost = topic.lost + topic.refused;
            (lost > 0).then(|| format!("{}: {lost}", topic.info.name))
        };
        let losses: Vec<String> = self.topics.iter().filter_map(lost).collect();
        if !losses.is_empty() {
            custom_data.insert(LOST_MESSAGES.to_owned(), losses.join(", "));
        }
        if self.deleted > 0 {
            custom_data.insert(DELETED_MESSAGES.to_owned(), self.deleted.to_string());
        }
        custom_data
    }

    fn times(&self) -> Times {
        self.files.iter().fold(Times::default(), |mut times, file| {
            times.merge(file.times);
            times
        })
    }
}

fn topic_metadata(topic: &Topic) -> TopicMetadata {
    TopicMetadata {
        name: topic.info.name.clone(),
        type_name: topic.info.type_name.clone(),
        serialization_format: topic.info.message_encoding().to_owned(),
        offered_qos: topic.info.offered_qos.clone(),
        type_hash: topic.info.type_hash.clone(),
        message_count: topic.written,
    }
}

fn file_metadata(file: &WrittenFile) -> FileMetadata {
    let first = file.times.first();
    FileMetadata {
        path: file.name.clone(),
        starting_time: first.unwrap_or(metadata::NEVER),
        duration: file.times.duration(),
        message_count: file.message_count(),
    }
}
