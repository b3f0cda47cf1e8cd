//! Conversion of messages to and from the encoding of a bag.
//!
//! A bag contains CDR unless another [`Encoding`] is requested; then each topic has a [`Codec`] for its type.
//! When a bag is read, its own description of a topic determines the conversion to CDR, so that playback and
//! replay need no options.

use bytes::Bytes;
use downbeat_bags::metadata::RecordedQos;
use downbeat_bags::{MessageFormat, RecordedTopic, TopicDescription};
use downbeat_edge::{Interfaces, KnownType, UnknownType};
use downbeat_msgs::dynamic::{Definitions, RecordedDefinition, Schemas, TypeLookupError};
use downbeat_msgs::encoding::{self, Codec, Encoding};
use downbeat_msgs::foxglove;

/// Returns the description of a topic with this type and encoding in a bag, and the codec for its messages;
/// `None` for CDR.
///
/// # Errors
/// Returns an error if the encoding cannot represent the type, or this build lacks the encoding.
pub fn topic_info(
    name: String,
    message_type: KnownType,
    offered_qos: Vec<RecordedQos>,
    encoding: Encoding,
) -> Result<(TopicDescription, Option<Codec>), encoding::Error> {
    let info = TopicDescription {
        name,
        type_name: message_type.name().into(),
        definition: message_type.definition().into(),
        type_hash: message_type.hash().into(),
        offered_qos,
        format: None,
    };
    described_topic_info(info, encoding)
}

/// Like [`topic_info`], for a type that is given by its definition.
///
/// # Errors
/// Returns an error if the encoding cannot represent the type, the definition is invalid, or this build lacks
/// the encoding.
pub fn described_topic_info(
    mut info: TopicDescription,
    encoding: Encoding,
) -> Result<(TopicDescription, Option<Codec>), encoding::Error> {
    let codec = match encoding {
        Encoding::Cdr => None,
        other => Some(other.codec_of_text(&info.type_name, &info.definition)?),
    };
    info.format = codec.as_ref().map(|codec| MessageFormat {
        message_encoding: codec.message_encoding().into(),
        schema: codec.schema().clone(),
    });
    Ok((info, codec))
}

/// The definition of a topic's messages in CDR, completed from what this program knows.
///
/// # Errors
/// If there is no definition that agrees with what is recorded.
pub fn recorded_definition(
    topic: &TopicDescription,
    interfaces: &Interfaces,
) -> Result<RecordedDefinition, TypeLookupError> {
    // Usually a bag says it all.
    let found = topic.definition_with(&Definitions::new().with_carried());
    found.or_else(|_| topic.definition_with(&interfaces.definitions()))
}

/// The type of a topic in a bag, which converts its messages to CDR.
#[derive(Clone, Debug)]
pub struct RecordedType {
    message_type: KnownType,
    codec: Option<Codec>,
}

/// Error while determining how to convert the messages of a topic to CDR.
#[derive(Debug, thiserror::Error)]
pub enum RecordedTypeError {
    /// The type is not registered.
    #[error(transparent)]
    Unknown(#[from] UnknownType),
    /// The encoding is not supported.
    #[error("topic \"{topic}\" holds messages in \"{message_encoding}\", which is not supported")]
    Encoding {
        /// The topic.
        topic: String,
        /// The name of the encoding in the bag.
        message_encoding: String,
    },
    /// The schema is no ROS 2 type, as that of other programs.
    #[error(
        "topic \"{topic}\" holds messages in \"{message_encoding}\" of the schema \"{schema}\", which is no ROS 2 type, so they cannot be \
         published; {remedy}"
    )]
    Foreign {
        /// The topic.
        topic: String,
        /// The name of the encoding in the bag.
        message_encoding: String,
        /// The name of the schema.
        schema: String,
        /// What can be done with them.
        remedy: &'static str,
    },
    /// The messages were encoded with another definition than the registered one.
    #[error("topic \"{topic}\" was recorded with another definition of {type_name} than the registered one")]
    Definition {
        /// The topic.
        topic: String,
        /// Its type.
        type_name: String,
    },
    /// The encoding cannot represent the type.
    #[error(transparent)]
    Codec(#[from] encoding::Error),
}

impl RecordedType {
    /// Determines the type of a topic from its description in the bag.
    ///
    /// # Errors
    /// Returns an error if the type is not registered or has another definition in the bag, or the encoding
    /// is not supported.
    pub fn of(topic: &RecordedTopic, interfaces: &Interfaces) -> Result<Self, RecordedTypeError> {
        let Some(format) = topic.info.format.as_ref().filter(|_| !topic.info.is_cdr()) else {
            let message_type = interfaces.find_message(&topic.info.type_name)?;
            // Messages that pass through as bytes are those of the recorded definition.
            let is_other = || recorded_hash(&topic.info).is_some_and(|hash| hash != message_type.hash());
            if message_type.is_raw() && is_other() {
                return Err(RecordedTypeError::Definition {
                    topic: topic.info.name.clone(),
                    type_name: message_type.name().into(),
                });
            }
            return Ok(Self { message_type, codec: None });
        };
        let schema = &format.schema;
        let Some(encoding) = Encoding::of_channel(&format.message_encoding, &schema.name) else {
            return Err(RecordedTypeError::Encoding {
                topic: topic.info.name.clone(),
                message_encoding: format.message_encoding.clone(),
            });
        };
        // Other programs that write Foxglove's schemas do not use ROS 2 types. In JSON, their messages have
        // Foxglove's fields.
        let is_foxglove = matches!(encoding, Encoding::FoxgloveProtobuf | Encoding::FoxgloveFlatBuffers);
        let foreign = foxglove::types().find(|(_, name)| is_foxglove && *name == topic.info.type_name);
        let found = interfaces.find_message(foreign.map_or(&topic.info.type_name, |(ros, _)| ros));
        let message_type = found.map_err(|error| match topic.info.type_name.contains('/') {
            // It may be one that this program does not know.
            true => RecordedTypeError::Unknown(error),
            false => RecordedTypeError::Foreign {
                topic: topic.info.name.clone(),
                message_encoding: format.message_encoding.clone(),
                schema: topic.info.type_name.clone(),
                remedy: match encoding {
                    Encoding::Json => "`downbeat bag export` writes them as JSON lines, and Foxglove shows them in the bag itself",
                    _ => "show the bag itself in Foxglove, or leave the topic out with --exclude-topics",
                },
            },
        })?;
        let codec = encoding.codec_of_text(message_type.name(), message_type.definition())?;
        // Foxglove's schemas are the same in all programs, and are only extended.
        let is_same = topic.info.type_hash == message_type.hash()
            || (topic.info.type_hash.is_empty() && schema.data == codec.schema().data);
        if !is_foxglove && !is_same {
            return Err(RecordedTypeError::Definition {
                topic: topic.info.name.clone(),
                type_name: message_type.name().into(),
            });
        }
        Ok(Self { message_type, codec: Some(codec) })
    }

    /// The type.
    #[must_use]
    pub fn message_type(&self) -> KnownType {
        self.message_type
    }

    /// Converts a message to CDR.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a message of the type. CDR is not checked.
    pub fn to_cdr(&self, data: Bytes) -> Result<Bytes, encoding::Error> {
        match &self.codec {
            Some(codec) => codec.decode(&data).map(Bytes::from),
            None => Ok(data),
        }
    }
}

/// The hash of the definition in a bag; many recorders write the text alone.
fn recorded_hash(info: &TopicDescription) -> Option<String> {
    if !info.type_hash.is_empty() {
        return Some(info.type_hash.clone());
    }
    let mut schemas = Schemas::new("the bag");
    schemas.add(&info.type_name, "ros2msg", &info.definition).ok()?;
    Definitions::new().with(schemas).find_text(&info.type_name).ok().map(|(_, hash)| hash)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use downbeat_bags::Reader;

    #[test]
    fn another_definition_is_refused_also_where_a_bag_has_no_hash() {
        let bag =
            Reader::open(concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/data/bags/idl_simple.mcap")).unwrap();
        let of = |fields: &str| {
            let interfaces = Interfaces::carried();
            let rule = "=".repeat(80);
            interfaces
                .learn("my_msgs/msg/Simple", &format!("{rule}\nMSG: my_msgs/msg/Simple\n{fields}"))
                .unwrap();
            RecordedType::of(&bag.topics()[0], &interfaces)
        };
        assert!(bag.topics()[0].info.type_hash.is_empty());
        assert!(of("int32 a\nfloat64 b\n").is_ok());
        assert!(matches!(of("int64 a\nfloat64 b\n"), Err(RecordedTypeError::Definition { .. })));
    }
}
