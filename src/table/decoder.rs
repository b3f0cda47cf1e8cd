//! Messages of a bag, field by field.

use std::borrow::Cow;

use bytes::Bytes;
use downbeat_bags::RecordedTopic;
use downbeat_edge::Interfaces;
use downbeat_msgs::cdr;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, TypeError};
use downbeat_msgs::encoding::{self, Codec, Encoding};

use crate::encoding::{RecordedType, RecordedTypeError};
use crate::ros_recorder::definition_at_hand;

/// Reads the messages of a topic, in whatever encoding, by the definition that the bag has of them.
#[derive(Debug)]
pub struct Decoder {
    message_type: DynamicType,
    json: Codec,
    /// Where the messages are no CDR.
    recorded: Option<RecordedType>,
}

/// Why messages cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The bag has no definition of the type, and there is none at hand.
    #[error("the bag has no definition of {type_name}, and {problem}")]
    Unknown {
        /// The type.
        type_name: String,
        /// Where else it was looked for.
        problem: String,
    },
    /// The encoding is not read here.
    #[error(transparent)]
    Encoding(#[from] RecordedTypeError),
    /// The definition is not understood.
    #[error(transparent)]
    Type(#[from] TypeError),
    /// A message is not in its encoding.
    #[error(transparent)]
    Message(#[from] encoding::Error),
    /// A message is no CDR of its type.
    #[error(transparent)]
    Cdr(#[from] cdr::Error),
}

impl Decoder {
    /// For the messages of a topic.
    ///
    /// # Errors
    /// If nothing says what they look like.
    pub fn of(topic: &RecordedTopic, interfaces: &Interfaces) -> Result<Self, DecodeError> {
        let info = &topic.info;
        let is_cdr = info.format.is_none();
        let (name, definition, recorded) = if is_cdr {
            let unknown = |problem| DecodeError::Unknown { type_name: info.type_name.clone(), problem };
            let definition = match info.definition.as_str() {
                "" => {
                    Cow::Owned(definition_at_hand(interfaces, &info.type_name, None).map_err(unknown)?.text)
                }
                recorded => Cow::Borrowed(recorded),
            };
            (info.type_name.as_str(), definition, None)
        } else {
            let recorded = RecordedType::of(topic, interfaces)?;
            let known = recorded.message_type();
            (known.name(), Cow::Borrowed(known.definition()), Some(recorded))
        };
        let message_type = DynamicType::from_definition_text(name, "ros2msg", &definition)?;
        let json = Encoding::Json.codec_of_text(name, &definition)?;
        Ok(Self { message_type, json, recorded })
    }

    /// The type of the messages.
    #[must_use]
    pub fn message_type(&self) -> &DynamicType {
        &self.message_type
    }

    /// A message as JSON, as in a bag of that encoding.
    ///
    /// # Errors
    /// If the bytes are no such message.
    pub fn to_json(&self, data: Bytes) -> Result<Vec<u8>, DecodeError> {
        Ok(self.json.encode(&self.to_cdr(data)?)?)
    }

    /// A message.
    ///
    /// # Errors
    /// If the bytes are no such message.
    pub fn decode(&self, data: Bytes) -> Result<DynamicMessage, DecodeError> {
        Ok(DynamicMessage::from_cdr(&self.message_type, &self.to_cdr(data)?)?)
    }

    fn to_cdr(&self, data: Bytes) -> Result<Bytes, encoding::Error> {
        match &self.recorded {
            Some(recorded) => recorded.to_cdr(data),
            None => Ok(data),
        }
    }
}
