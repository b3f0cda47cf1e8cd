//! Collects the topics of a bag from its files and its metadata.

use std::collections::HashMap;

use downbeat_msgs::encoding::Schema;
use mcap::records::Channel;

use super::RecordedTopic;
use super::file::{BagFile, MOST_DESCRIBED, Schema as FileSchema};
use crate::metadata::{Metadata, TopicMetadata, qos_from_yaml};
use crate::topic::{MessageFormat, TopicDescription, TopicId};

/// The maximum total size of the definitions of topics, against files in which thousands of channels share a
/// huge schema. Further topics have no definition.
const MOST_DEFINED: usize = 4 * MOST_DESCRIBED;

/// Returns the topics, in the order of the metadata if it contains them, and for each file the topic of each
/// channel.
///
/// Counts are those of the files, since metadata.yaml may be older.
pub(super) fn collect(
    files: &[BagFile],
    metadata: Option<&Metadata>,
) -> (Vec<RecordedTopic>, Vec<HashMap<u16, TopicId>>) {
    let mut topics: Vec<RecordedTopic> =
        metadata.into_iter().flat_map(|metadata| &metadata.topics).map(from_metadata).collect();
    let mut known = HashMap::new();
    for (index, topic) in topics.iter().enumerate() {
        known.entry((topic.info.name.clone(), topic.info.type_name.clone())).or_insert(index);
    }
    let mut ids = Vec::new();
    let mut defined = 0;
    for file in files {
        let mut ids_of_file = HashMap::new();
        for (channel_id, channel) in &file.channels {
            let schema = file.schemas.get(&channel.schema_id).filter(|_| defined <= MOST_DEFINED);
            let seen = from_channel(file, channel, schema);
            let name = (seen.info.name.clone(), seen.info.type_name.clone());
            let index = *known.entry(name).or_insert_with(|| {
                let info = TopicDescription { definition: String::new(), format: None, ..seen.info.clone() };
                topics.push(RecordedTopic { info, message_count: 0, ..seen.clone() });
                topics.len() - 1
            });
            let Some(id) = TopicId::from_index(index) else { continue };
            let topic = &mut topics[index];
            topic.message_count =
                topic.message_count.saturating_add(file.counts.get(channel_id).copied().unwrap_or(0));
            defined -= definition_length(&topic.info);
            complete(&mut topic.info, seen.info);
            defined += definition_length(&topic.info);
            ids_of_file.insert(*channel_id, id);
        }
        ids.push(ids_of_file);
    }
    (topics, ids)
}

fn from_metadata(topic: &TopicMetadata) -> RecordedTopic {
    RecordedTopic {
        info: TopicDescription {
            name: topic.name.clone(),
            type_name: topic.type_name.clone(),
            definition: String::new(),
            type_hash: topic.type_hash.clone(),
            offered_qos: topic.offered_qos.clone(),
            format: None,
        },
        serialization_format: topic.serialization_format.clone(),
        message_count: 0,
    }
}

fn from_channel(file: &BagFile, channel: &Channel, schema: Option<&FileSchema>) -> RecordedTopic {
    let text = |key: &str| channel.metadata.get(key).map_or("", String::as_str);
    // An invalid profile is treated like a missing one: it is only needed for playing.
    let offered_qos = qos_from_yaml(text("offered_qos_profiles"), &file.path).unwrap_or_default();
    let mut info = TopicDescription {
        name: channel.topic.clone(),
        type_name: match text("topic_type") {
            "" => schema.map_or_else(String::new, |schema| schema.name.clone()),
            type_name => type_name.to_owned(),
        },
        definition: String::new(),
        type_hash: text("topic_type_hash").to_owned(),
        offered_qos,
        format: None,
    };
    match schema {
        Some(schema) if channel.message_encoding == "cdr" => {
            info.take_schema(&schema.name, &schema.encoding, &schema.data)
        }
        None if channel.message_encoding == "cdr" => {}
        _ => {
            info.format = Some(MessageFormat {
                message_encoding: channel.message_encoding.clone(),
                schema: schema.map_or_else(Schema::default, |schema| Schema {
                    name: schema.name.clone(),
                    encoding: schema.encoding.clone(),
                    data: schema.data.to_vec(),
                }),
            });
        }
    }
    RecordedTopic { info, serialization_format: channel.message_encoding.clone(), message_count: 0 }
}

fn definition_length(info: &TopicDescription) -> usize {
    info.definition.len() + info.format.as_ref().map_or(0, |format| format.schema.data.len())
}

/// Fills in fields that are still unknown.
fn complete(info: &mut TopicDescription, seen: TopicDescription) {
    if info.definition.is_empty() {
        info.definition = seen.definition;
    }
    if info.type_hash.is_empty() {
        info.type_hash = seen.type_hash;
    }
    if info.offered_qos.is_empty() {
        info.offered_qos = seen.offered_qos;
    }
    if info.format.is_none() {
        info.format = seen.format;
    }
}
