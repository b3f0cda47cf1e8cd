//! Messages in the encoding of a bag, and back.
//!
//! A bag holds CDR unless asked for another [`Encoding`]; then each topic has a [`Codec`] of its type. What is read from a
//! bag becomes CDR by what the bag itself says of a topic, so that playback and replay need not be told.

use bytes::Bytes;
use downbeat_bags::metadata::RecordedQos;
use downbeat_bags::{MessageFormat, RecordedTopic, TopicDescription};
use downbeat_edge::{Interfaces, KnownType, UnknownType};
use downbeat_msgs::encoding::{self, Codec, Encoding};
use downbeat_msgs::foxglove;

/// How a bag describes a topic of that type in that encoding, and what encodes its messages; nothing does if that is CDR.
///
/// # Errors
/// If the type cannot be in the encoding, or this build lacks the encoding.
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

/// The same of a topic whose type is told by its definition alone.
///
/// # Errors
/// If the type cannot be in the encoding, its definition is none, or this build lacks the encoding.
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

/// A topic of a bag whose messages can become CDR.
#[derive(Clone, Debug)]
pub struct RecordedType {
    message_type: KnownType,
    codec: Option<Codec>,
}

/// Why the messages of a topic cannot become CDR.
#[derive(Debug, thiserror::Error)]
pub enum RecordedTypeError {
    /// The type is not registered.
    #[error(transparent)]
    Unknown(#[from] UnknownType),
    /// The encoding is not one that is read here.
    #[error("topic \"{topic}\" holds messages in \"{message_encoding}\", which is not read here")]
    Encoding {
        /// The topic.
        topic: String,
        /// What the bag calls it.
        message_encoding: String,
    },
    /// The messages were encoded by another definition than the one registered.
    #[error(
        "topic \"{topic}\" was recorded by another definition of {type_name} than the one registered here"
    )]
    Definition {
        /// The topic.
        topic: String,
        /// Its type.
        type_name: String,
    },
    /// The type cannot be in the encoding.
    #[error(transparent)]
    Codec(#[from] encoding::Error),
}

impl RecordedType {
    /// Of a topic, by what the bag says of it.
    ///
    /// # Errors
    /// If the type is not registered or was another one then, or the encoding is not read here.
    pub fn of(topic: &RecordedTopic, interfaces: &Interfaces) -> Result<Self, RecordedTypeError> {
        let Some(format) = topic.info.format.as_ref().filter(|format| format.message_encoding != "cdr")
        else {
            return Ok(Self { message_type: interfaces.message(&topic.info.type_name)?, codec: None });
        };
        let schema = &format.schema;
        let Some(encoding) = Encoding::of_channel(&format.message_encoding, &schema.name) else {
            return Err(RecordedTypeError::Encoding {
                topic: topic.info.name.clone(),
                message_encoding: format.message_encoding.clone(),
            });
        };
        // Others who write Foxglove's schemas know no type of ROS 2.
        let foreign = foxglove::types().find(|(_, foxglove)| *foxglove == topic.info.type_name);
        let message_type = interfaces.message(foreign.map_or(&topic.info.type_name, |(ros, _)| ros))?;
        let codec = encoding.codec_of_text(message_type.name(), message_type.definition())?;
        // Foxglove's schemas are the same for everyone, and only grow.
        let is_foxglove = schema.name.starts_with("foxglove.");
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

    /// A message as CDR.
    ///
    /// # Errors
    /// If the bytes are no such message. CDR itself is not looked at.
    pub fn to_cdr(&self, data: Bytes) -> Result<Bytes, encoding::Error> {
        match &self.codec {
            Some(codec) => codec.decode(&data).map(Bytes::from),
            None => Ok(data),
        }
    }
}
