//! The schemas and channels of a file: written before the first message of each, and again in the summary.
//!
//! Like the MCAP C++ library, so that a topic without messages takes space only in the summary.

use std::collections::hash_map::DefaultHasher;
use std::collections::{BTreeMap, HashMap};
use std::hash::{Hash, Hasher};
use std::io;

use downbeat_msgs::encoding::Schema;

use super::records;
use crate::metadata::recorded_qos_to_yaml;
use crate::topic::TopicDescription;

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
    pub(super) fn add(&mut self, topic: &TopicDescription, metadata_version: u32) -> io::Result<u16> {
        let mut metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), recorded_qos_to_yaml(&topic.offered_qos, metadata_version)),
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
