//! Collects the topics of a bag from its files and its metadata.

use std::collections::HashMap;
use std::path::Path;
use std::sync::Arc;

use downbeat_msgs::encoding::Schema;
use mcap::records::Channel;

use super::RecordedTopic;
use super::file::{BagFile, MOST_DESCRIBED, Schema as FileSchema};
use crate::metadata::{Metadata, RecordedQos, TopicMetadata, qos_from_yaml};
use crate::topic::{MessageFormat, TopicDescription, TopicId};

/// The maximum total size of the definitions of topics, against files in which thousands of channels share a
/// huge schema. Further topics have no definition.
const MOST_DEFINED: usize = 4 * MOST_DESCRIBED;

/// The topics of a bag.
pub(super) struct Collected {
    pub(super) topics: Vec<RecordedTopic>,
    /// For each file, the topics of its channels.
    pub(super) topics_of_channels: Vec<Arc<HashMap<u16, TopicId>>>,
    /// What could not be understood.
    pub(super) oddities: Vec<String>,
}

/// Returns the topics, in the order of the metadata if it contains them, and for each file the topic of each
/// channel.
///
/// Counts are those of the files, since metadata.yaml may be older.
pub(super) fn collect(files: &[BagFile], metadata: Option<&Metadata>) -> Collected {
    let mut topics: Vec<RecordedTopic> =
        metadata.into_iter().flat_map(|metadata| &metadata.topics).map(from_metadata).collect();
    let mut known = HashMap::new();
    for (index, topic) in topics.iter().enumerate() {
        known.entry((topic.info.name.clone(), topic.info.type_name.clone())).or_insert(index);
    }
    let mut profiles = Profiles::default();
    let mut ids = Vec::new();
    let mut defined = 0;
    for file in files {
        let mut ids_of_file = HashMap::new();
        for (channel_id, channel) in file.channels.iter() {
            let schema = file.schemas.get(&channel.schema_id).filter(|_| defined <= MOST_DEFINED);
            let seen = from_channel(file, channel, schema, &mut profiles);
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
        ids.push(Arc::new(ids_of_file));
    }
    Collected { topics, topics_of_channels: ids, oddities: profiles.oddities }
}

/// The QoS profiles of channels: most have one of few texts.
#[derive(Default)]
struct Profiles {
    read: HashMap<String, Result<Vec<RecordedQos>, String>>,
    oddities: Vec<String>,
}

impl Profiles {
    /// The profiles in the text; none if it is invalid, which is noted, since they are only needed for
    /// playing.
    fn of(&mut self, text: &str, topic: &str, path: &Path) -> Vec<RecordedQos> {
        let read = self.read.entry(text.to_owned());
        let read = read.or_insert_with(|| qos_from_yaml(text, path).map_err(|error| error.to_string()));
        match read {
            Ok(profiles) => profiles.clone(),
            Err(found) => {
                self.oddities
                    .push(format!("{topic}: its channel has no valid QoS, the default is taken: {found}"));
                Vec::new()
            }
        }
    }
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

fn from_channel(
    file: &BagFile,
    channel: &Channel,
    schema: Option<&FileSchema>,
    profiles: &mut Profiles,
) -> RecordedTopic {
    let text = |key: &str| channel.metadata.get(key).map_or("", String::as_str);
    let offered_qos = profiles.of(text("offered_qos_profiles"), &channel.topic, &file.path);
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
