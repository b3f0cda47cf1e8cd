//! The schemas and channels of a file: written before the first message of each, and again in the summary.
//!
//! Like the MCAP C++ library, so that a topic without messages takes space only in the summary.

use std::collections::BTreeMap;
use std::io;

use downbeat_msgs::encoding::Schema;

use super::records;
use crate::metadata::recorded_qos_to_yaml;
use crate::topic::TopicInfo;

#[derive(Default)]
pub(super) struct Channels {
    schemas: Vec<Described>,
    channels: Vec<Channel>,
}

/// A record, and whether it is already in the file.
struct Described {
    schema: Schema,
    record: Vec<u8>,
    told: Told,
}

struct Channel {
    /// The index of its schema.
    schema: usize,
    record: Vec<u8>,
    told: Told,
}

/// Where a record has been written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Told {
    No,
    /// In the open chunk, which may never be written.
    InChunk,
    InFile,
}

impl Channels {
    /// Returns the channel of the topic, numbered from 1 like in the C++ library.
    pub(super) fn add(&mut self, topic: &TopicInfo) -> io::Result<u16> {
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
        let known = self.schemas.iter().position(|described| described.schema == schema);
        let schema_index = known.unwrap_or(self.schemas.len());
        let schema_id = u16::try_from(schema_index + 1).map_err(too_many)?;
        let id = u16::try_from(self.channels.len() + 1).map_err(too_many)?;
        let mut record = Vec::new();
        records::channel(&mut record, id, schema_id, topic, &metadata)?;
        if known.is_none() {
            let mut record = Vec::new();
            records::schema(&mut record, schema_id, &schema)?;
            self.schemas.push(Described { schema, record, told: Told::No });
        }
        self.channels.push(Channel { schema: schema_index, record, told: Told::No });
        Ok(id)
    }

    /// Appends the schema and channel records that must precede a message of that channel to the open chunk.
    pub(super) fn tell(&mut self, channel: u16, out: &mut Vec<u8>) {
        let Some(channel) = usize::from(channel).checked_sub(1).and_then(|at| self.channels.get_mut(at))
        else {
            return;
        };
        if channel.told != Told::No {
            return;
        }
        if let Some(schema) = self.schemas.get_mut(channel.schema).filter(|schema| schema.told == Told::No) {
            out.extend_from_slice(&schema.record);
            schema.told = Told::InChunk;
        }
        out.extend_from_slice(&channel.record);
        channel.told = Told::InChunk;
    }

    /// Called when the open chunk has been written.
    pub(super) fn keep(&mut self) {
        self.settle(Told::InFile);
    }

    /// Called when the open chunk is dropped.
    pub(super) fn forget(&mut self) {
        self.settle(Told::No);
    }

    fn settle(&mut self, becomes: Told) {
        let schemas = self.schemas.iter_mut().map(|schema| &mut schema.told);
        let channels = self.channels.iter_mut().map(|channel| &mut channel.told);
        for told in schemas.chain(channels).filter(|told| **told == Told::InChunk) {
            *told = becomes;
        }
    }

    /// The number of schemas in the file.
    pub(super) fn schema_count(&self) -> usize {
        self.schemas.iter().filter(|schema| schema.told == Told::InFile).count()
    }

    /// The number of channels in the file.
    pub(super) fn channel_count(&self) -> usize {
        self.channels.iter().filter(|channel| channel.told == Told::InFile).count()
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
