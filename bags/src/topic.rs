//! The description of a topic in a bag.

use std::borrow::Cow;
use std::path::PathBuf;
use std::time::Duration;

use downbeat_msgs::definitions::{Catalog, DefinitionEncoding, Kind, TypeName, portable_definition_text};
use downbeat_msgs::dynamic::{Definitions, RecordedDefinition, TypeLookupError};
use downbeat_msgs::encoding::Schema;
use downbeat_msgs::qos::{Durability, History, QosProfile};

use crate::metadata::RecordedQos;

/// The description of a topic in a bag. This crate does not know message types; they are described by
/// strings.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct TopicDescription {
    /// Absolute topic name, `/joint_states`.
    pub name: String,
    /// ROS type name, `sensor_msgs/msg/JointState`.
    pub type_name: String,
    /// The `ros2msg` text of the type, including its dependencies.
    ///
    /// Empty if unknown. A reader converts definitions in IDL and texts of services, and leaves it empty for
    /// messages that are not CDR. A writer writes its portable form ([`portable_definition_text`]; IDL for
    /// types of services), or nothing of it if [`TopicDescription::format`] has a schema.
    pub definition: String,
    /// Type hash as in REP-2016, `RIHS01_…`; empty if unknown.
    pub type_hash: String,
    /// The QoS offered by each publisher of the topic, as far as known: discovery does not include the
    /// history.
    pub offered_qos: Vec<RecordedQos>,
    /// The serialisation of its messages, if it is not CDR described by a `ros2msg` text.
    pub format: Option<MessageFormat>,
}

impl TopicDescription {
    /// The number of latest messages that a publisher keeps for late subscribers (transient local), or 0.
    #[must_use]
    pub fn latched_depth(&self) -> usize {
        let depth = |qos: QosProfile| match (qos.durability, qos.history) {
            (Durability::Volatile, _) => 0,
            (Durability::TransientLocal, History::KeepLast(depth)) => depth as usize,
            (Durability::TransientLocal, History::KeepAll) => usize::MAX,
        };
        self.offered_qos.iter().map(RecordedQos::to_profile).map(depth).max().unwrap_or(0)
    }

    /// Whether its messages are CDR.
    #[must_use]
    pub fn is_cdr(&self) -> bool {
        self.message_encoding() == "cdr"
    }

    /// Whether its messages are JSON, of whatever schema.
    #[must_use]
    pub fn is_json(&self) -> bool {
        self.message_encoding() == "json"
    }

    /// The definition of its messages in CDR: the recorded one, completed from `known` where it is damaged or
    /// incomplete.
    ///
    /// # Errors
    /// Returns an error if there is no definition that agrees with the recorded text and hash.
    pub fn definition_with(&self, known: &Definitions) -> Result<RecordedDefinition, TypeLookupError> {
        if !self.definition.is_empty() {
            return known.recorded(&self.type_name, "ros2msg", &self.definition, &self.type_hash);
        }
        let schema = self.schema();
        let text = String::from_utf8_lossy(&schema.data);
        known.recorded(&self.type_name, &schema.encoding, &text, &self.type_hash)
    }

    /// The same topic with its definition completed from `known`, if the recorded text is damaged or
    /// incomplete, and what was taken from where.
    pub(crate) fn completed(&self, known: &Definitions) -> Option<(Self, String)> {
        if !self.is_cdr() || self.schema().data.is_empty() {
            return None;
        }
        let RecordedDefinition { definition, taken } = self.definition_with(known).ok()?;
        Some((Self { definition: definition.text, format: None, ..self.clone() }, taken?))
    }

    /// Takes the schema of messages in CDR from a bag.
    pub(crate) fn take_schema(&mut self, name: &str, encoding: &str, data: &[u8]) {
        let text = String::from_utf8_lossy(data);
        if encoding == "ros2msg" && !text.starts_with(RULE) && (!text.is_empty() || self.has_no_fields()) {
            self.definition = text.into_owned();
            return;
        }
        let keep = |of: &mut Self| {
            of.format = Some(MessageFormat {
                message_encoding: "cdr".to_owned(),
                schema: Schema { name: name.to_owned(), encoding: encoding.to_owned(), data: data.to_vec() },
            });
        };
        // The hash does not say that the message is empty, but the text does.
        if encoding == "ros2msg" && data.is_empty() {
            keep(self);
            return;
        }
        // The real recorder writes the encoding `unknown` without a text for parts of actions.
        if encoding.is_empty() || data.is_empty() {
            return;
        }
        let converted = self.converted(encoding, &text);
        let is_known = converted.is_some();
        self.definition = converted.unwrap_or_default();
        // The text of a service stands for the text of its events, which contains as much; IDL may contain
        // more. A text that could not be read is kept as it is.
        if !is_known || (encoding == "ros2idl" && self.schema().data != data) {
            keep(self);
        }
    }

    /// The `ros2msg` text of the type in a text with headers, or in IDL.
    fn converted(&self, encoding: &str, text: &str) -> Option<String> {
        let name: TypeName = self.type_name.parse().ok()?;
        let encoding =
            if encoding == "ros2idl" { DefinitionEncoding::Ros2Idl } else { DefinitionEncoding::Ros2Msg };
        let mut catalog = Catalog::new();
        catalog.add_definition_text(&name, encoding, text, &self.name).ok()?;
        catalog.check_type(&name).ok()?;
        catalog.definition_text(&name).ok()
    }

    /// The name of the serialisation in a channel and in the metadata of a bag.
    pub(crate) fn message_encoding(&self) -> &str {
        self.format.as_ref().map_or("cdr", |format| &format.message_encoding)
    }

    /// The schema for reading the messages.
    pub(crate) fn schema(&self) -> Schema {
        if let Some(format) = &self.format {
            return format.schema.clone();
        }
        let (encoding, text) = self.schema_text();
        Schema {
            name: self.type_name.clone(),
            encoding: encoding.to_owned(),
            data: text.into_owned().into_bytes(),
        }
    }

    /// Encoding and text of the schema that describes its messages in CDR.
    fn schema_text(&self) -> (&'static str, Cow<'_, str>) {
        let definition = Cow::Borrowed(self.definition.as_str());
        if definition.is_empty() {
            // The format requires an empty encoding if there is no text.
            return (if self.has_no_fields() { "ros2msg" } else { "" }, definition);
        }
        let Ok(name) = self.type_name.parse::<TypeName>() else {
            return (encoding_of(&definition), definition);
        };
        if name.kind == Kind::Service || definition.starts_with(RULE) {
            let mut catalog = Catalog::new();
            let added =
                catalog.add_definition_text(&name, DefinitionEncoding::Ros2Msg, &definition, &self.name);
            if let Some((encoding, text)) = added.ok().and_then(|()| catalog.schema_text(&name).ok()) {
                return (encoding.as_str(), Cow::Owned(text));
            }
            return (encoding_of(&definition), definition);
        }
        ("ros2msg", portable_definition_text(&name, &self.definition))
    }

    /// Returns whether the definition is known and empty, as for `std_msgs/msg/Empty`: the hash distinguishes
    /// it from an unknown one.
    fn has_no_fields(&self) -> bool {
        let hash = || {
            let name: TypeName = self.type_name.parse().ok()?;
            let mut catalog = Catalog::new();
            catalog.add_message(name.clone(), "", &self.type_name).ok()?;
            catalog.type_hash(&name).ok()
        };
        self.definition.is_empty() && !self.type_hash.is_empty() && hash().as_ref() == Some(&self.type_hash)
    }
}

/// A serialisation other than CDR, or CDR whose type is described by something other than a `ros2msg` text
/// (`ros2idl`), as an MCAP file describes it.
///
/// The type of the topic is still that of ROS 2; a channel stores it as `topic_type` with the
/// `topic_type_hash`.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct MessageFormat {
    /// `json`, `protobuf`, …
    pub message_encoding: String,
    /// The schema for reading the messages; its name need not be a ROS 2 type.
    pub schema: Schema,
}

/// A topic of one [`Writer`](crate::Writer), one [`Recording`](crate::Recording) or one
/// [`Reader`](crate::Reader): its position in the list of topics there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct TopicId(u16);

impl TopicId {
    pub(crate) fn from_index(index: usize) -> Option<Self> {
        u16::try_from(index).ok().map(Self)
    }

    /// The topic at that position, if it is at most 65 535.
    #[must_use]
    pub fn at(position: usize) -> Option<Self> {
        Self::from_index(position)
    }

    /// The position in the list of topics.
    #[must_use]
    pub fn index(self) -> usize {
        usize::from(self.0)
    }
}

/// The encoding of a definition text, named as in rosbag2 (`local_message_definition_source.cpp`).
fn encoding_of(definition: &str) -> &'static str {
    let headed = definition.strip_prefix(RULE).and_then(|rest| rest.strip_prefix('\n'));
    match headed {
        // The format requires an empty encoding if there is no text.
        None if definition.is_empty() => "",
        None => "ros2msg",
        Some(headed) if headed.starts_with("IDL: ") => "ros2idl",
        // A service without references: rosbag2 decides the encoding by the references.
        Some(headed) if headed.starts_with("SRV: ") && !headed.contains(RULE) => "unknown",
        Some(_) => "ros2msg",
    }
}

/// The line between definitions.
const RULE: &str = "================================================================================";

/// Returns whether a topic carries the events of a service (service introspection), which `ros2 bag info`
/// lists separately.
///
/// The rule is that of `rosbag2_cpp/service_utils.cpp`.
pub(crate) fn is_service_event(name: &str, type_name: &str) -> bool {
    name.strip_suffix(SERVICE_EVENT_TOPIC).is_some_and(|service| !service.is_empty())
        && type_name.contains("/srv/")
        && type_name.ends_with(SERVICE_EVENT_TYPE)
}

pub(crate) const SERVICE_EVENT_TOPIC: &str = "/_service_event";
pub(crate) const SERVICE_EVENT_TYPE: &str = "_Event";

/// The summary of a recording.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RecordingSummary {
    /// The bag directory.
    pub path: PathBuf,
    /// Size of the bag files in bytes.
    pub bytes: u64,
    /// The number of files.
    pub files: usize,
    /// The number of messages in files that were deleted to keep the maximum number of files.
    pub deleted: u64,
    /// The receive time of the first message, in nanoseconds since the epoch; `None` without messages.
    pub starting_time: Option<i64>,
    /// From the first to the last message.
    pub duration: Duration,
    /// Every topic in the order in which they were added.
    pub topics: Vec<TopicCount>,
}

/// The summary of one topic.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicCount {
    /// Topic name.
    pub name: String,
    /// ROS type name.
    pub type_name: String,
    /// The number of messages in the bag.
    pub written: u64,
    /// The number of messages that were not recorded.
    pub lost: u64,
}

impl RecordingSummary {
    /// The number of messages in the bag.
    #[must_use]
    pub fn message_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.written).sum()
    }

    /// The number of messages that were not recorded.
    #[must_use]
    pub fn lost_count(&self) -> u64 {
        self.topics.iter().map(|topic| topic.lost).sum()
    }
}
