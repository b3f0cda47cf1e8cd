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
    topics_with_message_count: Vec<Topic>,
    #[serde(default)]
    compression_format: String,
    #[serde(default)]
    compression_mode: String,
    relative_file_paths: Vec<String>,
    #[serde(default)]
    files: Vec<File>,
    #[serde(default)]
    custom_data: Option<BTreeMap<String, AnyScalar>>,
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

#[derive(Deserialize)]
struct Topic {
    topic_metadata: TopicBody,
    message_count: u64,
}

#[derive(Deserialize)]
struct TopicBody {
    name: String,
    #[serde(rename = "type")]
    type_name: String,
    serialization_format: String,
    #[serde(default)]
    offered_qos_profiles: QosList,
    #[serde(default)]
    type_description_hash: String,
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
        // What Fast DDS and Connext wrote for infinite in Foxy (rosbag2_storage/qos.cpp); Cyclone's equals INFINITE.
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
        use serde_norway::Value;
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
        Self {
            version: read.version,
            storage_identifier: read.storage_identifier,
            duration: Duration::from_nanos(read.duration.nanoseconds),
            starting_time: read.starting_time.nanoseconds_since_epoch,
            message_count: read.message_count,
            topics: read.topics_with_message_count.into_iter().map(TopicMetadata::from).collect(),
            compression_format: read.compression_format,
            compression_mode: read.compression_mode,
            relative_file_paths: read.relative_file_paths,
            files: read.files.into_iter().map(FileMetadata::from).collect(),
            custom_data: read
                .custom_data
                .unwrap_or_default()
                .into_iter()
                .map(|(key, value)| (key, value.0))
                .collect(),
            ros_distro: read.ros_distro,
        }
    }
}

impl From<Topic> for TopicMetadata {
    fn from(read: Topic) -> Self {
        Self {
            name: read.topic_metadata.name,
            type_name: read.topic_metadata.type_name,
            serialization_format: read.topic_metadata.serialization_format,
            offered_qos: read.topic_metadata.offered_qos_profiles.0,
            type_hash: read.topic_metadata.type_description_hash,
            message_count: read.message_count,
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
