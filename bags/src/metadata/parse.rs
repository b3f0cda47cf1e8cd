//! Reads metadata.yaml: version 9 and older ones.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;
use std::time::Duration;

use downbeat_msgs::yaml;
use serde::Deserialize;
use serde::de::{
    DeserializeOwned, Deserializer, Error as _, SeqAccess, Visitor, value::SeqAccessDeserializer,
};
use serde_norway::Value;

use super::emit::INFINITE;
use super::{
    FileMetadata, Metadata, RecordedDurability, RecordedHistory, RecordedLiveliness, RecordedQos,
    RecordedReliability, TopicMetadata,
};

/// metadata.yaml, which has a root key.
#[derive(Deserialize)]
pub(super) struct Root {
    rosbag2_bagfile_information: Information,
}

/// The content below the root key, which is also that of the metadata record in an MCAP file.
#[derive(Deserialize)]
pub(super) struct Information {
    version: u32,
    storage_identifier: String,
    duration: Nanoseconds,
    starting_time: SinceEpoch,
    message_count: u64,
    topics_with_message_count: Vec<TopicEntry>,
    #[serde(default)]
    compression_format: String,
    #[serde(default)]
    compression_mode: String,
    relative_file_paths: Vec<String>,
    #[serde(default)]
    files: Vec<Lenient<File>>,
    #[serde(default)]
    custom_data: Option<BTreeMap<String, Lenient<AnyScalar>>>,
    #[serde(default)]
    ros_distro: String,
}

#[derive(Deserialize)]
struct Nanoseconds {
    nanoseconds: u64,
}

#[derive(Deserialize)]
struct SinceEpoch {
    nanoseconds_since_epoch: i64,
}

/// A value, or why it is not what it should be: an odd entry of one topic does not make a bag unreadable.
struct Lenient<T>(Result<T, String>);

impl<'de, T: DeserializeOwned> Deserialize<'de> for Lenient<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let value = Value::deserialize(deserializer)?;
        Ok(Self(T::deserialize(value).map_err(|error| error.to_string())))
    }
}

/// The entry of a topic, if it has a name, and what is odd in it.
struct TopicEntry {
    topic: Option<TopicMetadata>,
    oddities: Vec<String>,
}

impl<'de> Deserialize<'de> for TopicEntry {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self::of(&Value::deserialize(deserializer)?))
    }
}

impl TopicEntry {
    fn of(entry: &Value) -> Self {
        let body = entry.get("topic_metadata").unwrap_or(&Value::Null);
        let mut oddities = Vec::new();
        let Some(name) = body.get("name").and_then(Value::as_str) else {
            oddities.push("the entry of a topic without a name is left out".to_owned());
            return Self { topic: None, oddities };
        };
        let mut odd = |key: &str, found: &str, taken: &str| {
            oddities.push(format!("{name}: its {key} is odd, {taken}: {found}"));
        };
        let mut text = |key: &str, default: &str, is_required: bool| match body.get(key) {
            Some(Value::String(text)) => text.clone(),
            None | Some(Value::Null) if !is_required => default.to_owned(),
            _ => {
                odd(key, "it is not a text", &format!("{default:?} is taken"));
                default.to_owned()
            }
        };
        let type_name = text("type", "", true);
        let serialization_format = text("serialization_format", "cdr", true);
        let type_hash = text("type_description_hash", "", false);
        let qos = body.get("offered_qos_profiles").cloned().unwrap_or_default();
        let offered_qos = QosList::deserialize(qos).map_or_else(
            |error| {
                odd("offered_qos_profiles", &error.to_string(), "the default QoS is taken");
                Vec::new()
            },
            |list| list.0,
        );
        let message_count = entry.get("message_count").and_then(Value::as_u64).unwrap_or_else(|| {
            odd("message_count", "it is not a number", "0 is taken");
            0
        });
        let topic = TopicMetadata {
            name: name.to_owned(),
            type_name,
            serialization_format,
            offered_qos,
            type_hash,
            message_count,
        };
        Self { topic: Some(topic), oddities }
    }
}

#[derive(Deserialize)]
struct File {
    path: String,
    starting_time: SinceEpoch,
    duration: Nanoseconds,
    message_count: u64,
}

#[derive(Deserialize)]
struct Qos {
    history: RecordedHistory,
    #[serde(default)]
    depth: u64,
    reliability: RecordedReliability,
    durability: RecordedDurability,
    #[serde(default)]
    deadline: Time,
    #[serde(default)]
    lifespan: Time,
    #[serde(default = "liveliness_of_old_bags")]
    liveliness: RecordedLiveliness,
    #[serde(default)]
    liveliness_lease_duration: Time,
    #[serde(default)]
    avoid_ros_namespace_conventions: bool,
}

fn liveliness_of_old_bags() -> RecordedLiveliness {
    RecordedLiveliness::Unknown
}

#[derive(Deserialize)]
struct Time {
    sec: u64,
    nsec: u64,
}

impl Default for Time {
    fn default() -> Self {
        Self { sec: INFINITE.0, nsec: INFINITE.1 }
    }
}

impl From<Time> for Option<Duration> {
    fn from(time: Time) -> Self {
        // What Fast DDS and Connext wrote for infinite in Foxy (rosbag2_storage/qos.cpp); Cyclone's equals
        // INFINITE.
        const FAST_DDS_FOXY: (u64, u64) = (0x7FFF_FFFF, 0xFFFF_FFFF);
        const CONNEXT_FOXY: (u64, u64) = (0x7FFF_FFFF, 0x7FFF_FFFF);
        let pair = (time.sec, time.nsec);
        if [INFINITE, FAST_DDS_FOXY, CONNEXT_FOXY].contains(&pair) {
            return None;
        }
        Some(Duration::from_secs(time.sec).saturating_add(Duration::from_nanos(time.nsec)))
    }
}

/// The list of QoS profiles: a sequence (version 9), or a text that contains the sequence (older versions).
#[derive(Default)]
pub(super) struct QosList(pub(super) Vec<RecordedQos>);

impl<'de> Deserialize<'de> for QosList {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let list: TextOrSequence<Qos> = Deserialize::deserialize(deserializer)?;
        Ok(Self(list.0.into_iter().map(RecordedQos::from).collect()))
    }
}

struct TextOrSequence<T>(Vec<T>);

impl<'de, T: DeserializeOwned> Deserialize<'de> for TextOrSequence<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Either<T>(PhantomData<T>);
        impl<'de, T: DeserializeOwned> Visitor<'de> for Either<T> {
            type Value = TextOrSequence<T>;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a sequence of quality of service profiles, or a text that holds one")
            }

            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Self::Value, E> {
                if text.trim().is_empty() {
                    return Ok(TextOrSequence(Vec::new()));
                }
                yaml::from_str(text)
                    .map(TextOrSequence)
                    .map_err(|error| E::custom(format_args!("in the text of offered_qos_profiles: {error}")))
            }

            fn visit_seq<A: SeqAccess<'de>>(self, sequence: A) -> Result<Self::Value, A::Error> {
                Deserialize::deserialize(SeqAccessDeserializer::new(sequence)).map(TextOrSequence)
            }

            fn visit_unit<E>(self) -> Result<Self::Value, E> {
                Ok(TextOrSequence(Vec::new()))
            }
        }
        deserializer.deserialize_any(Either(PhantomData))
    }
}

/// A value of `custom_data`: rosbag2 writes strings without quotes, so `true` and `3` are strings too.
struct AnyScalar(String);

impl<'de> Deserialize<'de> for AnyScalar {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(Self(match Value::deserialize(deserializer)? {
            Value::String(text) => text,
            Value::Bool(value) => value.to_string(),
            Value::Number(number) => number.to_string(),
            Value::Null => String::new(),
            Value::Sequence(_) | Value::Mapping(_) | Value::Tagged(_) => {
                return Err(D::Error::custom("a value of custom_data must be a text"));
            }
        }))
    }
}

impl From<Root> for Metadata {
    fn from(root: Root) -> Self {
        root.rosbag2_bagfile_information.into()
    }
}

impl From<Information> for Metadata {
    fn from(read: Information) -> Self {
        let mut oddities = Vec::new();
        let mut topics = Vec::new();
        for entry in read.topics_with_message_count {
            oddities.extend(entry.oddities);
            topics.extend(entry.topic);
        }
        let mut files = Vec::new();
        for (file, number) in read.files.into_iter().zip(1..) {
            match file.0 {
                Ok(file) => files.push(FileMetadata::from(file)),
                Err(found) => oddities.push(format!("the entry of file {number} is left out: {found}")),
            }
        }
        let mut custom_data = BTreeMap::new();
        for (key, value) in read.custom_data.unwrap_or_default() {
            match value.0 {
                Ok(value) => drop(custom_data.insert(key, value.0)),
                Err(found) => oddities.push(format!("custom_data {key:?} is left out: {found}")),
            }
        }
        Self {
            version: read.version,
            storage_identifier: read.storage_identifier,
            duration: Duration::from_nanos(read.duration.nanoseconds),
            starting_time: read.starting_time.nanoseconds_since_epoch,
            message_count: read.message_count,
            topics,
            compression_format: read.compression_format,
            compression_mode: read.compression_mode,
            relative_file_paths: read.relative_file_paths,
            files,
            custom_data,
            ros_distro: read.ros_distro,
            oddities,
        }
    }
}

impl From<File> for FileMetadata {
    fn from(read: File) -> Self {
        Self {
            path: read.path,
            starting_time: read.starting_time.nanoseconds_since_epoch,
            duration: Duration::from_nanos(read.duration.nanoseconds),
            message_count: read.message_count,
        }
    }
}

impl From<Qos> for RecordedQos {
    fn from(read: Qos) -> Self {
        Self {
            history: read.history,
            depth: u32::try_from(read.depth).unwrap_or(u32::MAX),
            reliability: read.reliability,
            durability: read.durability,
            deadline: read.deadline.into(),
            lifespan: read.lifespan.into(),
            liveliness: read.liveliness,
            liveliness_lease_duration: read.liveliness_lease_duration.into(),
            avoid_ros_namespace_conventions: read.avoid_ros_namespace_conventions,
        }
    }
}
