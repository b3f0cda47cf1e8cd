//! Messages of a topic as rows of a table, for spreadsheets, data frames and plots.
//!
//! Each number, boolean and text has its own column, which is named by its path: `header.stamp.sec`,
//! `position[3]`. A sequence has as many columns as its longest has elements; bytes, and arrays of more than
//! [`MOST_ELEMENTS`], have one.
//!
//! ```
//! use downbeat_robot::table::{Cell, Survey};
//! use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
//!
//! let legs = DynamicType::from_definition_text("my_msgs/msg/Legs", "ros2msg", "string name\nfloat64[] angles\n")?;
//! let mut left = DynamicMessage::new(&legs);
//! left.set("angles", vec![0.5, 0.25])?;
//! let right = DynamicMessage::new(&legs);
//!
//! let mut survey = Survey::default();
//! survey.see(&left);
//! survey.see(&right);
//! let columns = survey.columns();
//! let names: Vec<_> = columns.iter().map(|column| column.name.as_str()).collect();
//! assert_eq!(names, ["name", "angles[0]", "angles[1]"]);
//! assert_eq!(columns.row(&left)[2], Cell::Float64(0.25));
//! assert_eq!(columns.row(&right)[2], Cell::Nothing);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod columns;
mod numbers;
#[cfg(feature = "tables")]
mod parquet;
mod series;

use std::fmt::Write as _;

use bytes::Bytes;
use downbeat_bags::RecordedTopic;
use downbeat_edge::Interfaces;
use downbeat_msgs::cdr;
use downbeat_msgs::dynamic::{Array, DynamicMessage, DynamicType, MessageRef, TypeError, ValueRef};
use downbeat_msgs::encoding::{self, Codec, Encoding};

use crate::encoding::{RecordedType, RecordedTypeError, recorded_definition};
pub use columns::{Cell, Column, ColumnKind, Columns, Survey};
pub use numbers::{ELEMENT_NAMES, NumberField};
pub(crate) use numbers::{check_number, number, number_at, numbers_of};
#[cfg(feature = "tables")]
pub use parquet::ParquetTable;
pub use series::{MOST_POINTS, Series, SeriesError, series};

/// Decodes the messages of a topic, in any encoding, with the definition in the bag.
#[derive(Debug)]
pub struct Decoder {
    message_type: DynamicType,
    json: Codec,
    /// Set if the messages are not CDR.
    recorded: Option<RecordedType>,
}

/// Error while decoding messages.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// Neither the bag nor the registry has a definition of the type.
    #[error("the bag has no definition of {type_name}, and {problem}")]
    Unknown {
        /// The type.
        type_name: String,
        /// Why the registry has no definition.
        problem: String,
    },
    /// The definition in the bag cannot be used, and no other one agrees with it.
    #[error("the bag's definition of {type_name} cannot be used: {problem}")]
    Definition {
        /// The type.
        type_name: String,
        /// The problem.
        problem: String,
    },
    /// The encoding is not supported.
    #[error(transparent)]
    Encoding(#[from] RecordedTypeError),
    /// The definition cannot be parsed.
    #[error(transparent)]
    Type(#[from] TypeError),
    /// A message is not JSON.
    #[error("it is not JSON: {0}")]
    Json(serde_json::Error),
    /// A message is not valid in its encoding.
    #[error(transparent)]
    Message(#[from] encoding::Error),
    /// A message is not valid CDR of its type.
    #[error(transparent)]
    Cdr(#[from] cdr::Error),
}

impl Decoder {
    /// Creates a decoder for the messages of a topic.
    ///
    /// # Errors
    /// Returns an error if there is no definition of the type.
    pub fn of(topic: &RecordedTopic, interfaces: &Interfaces) -> Result<Self, DecodeError> {
        let info = &topic.info;
        if info.is_cdr() {
            let found = recorded_definition(info, interfaces).map_err(|error| {
                let (type_name, problem) = (info.type_name.clone(), error.to_string());
                match info.definition.as_str() {
                    "" => DecodeError::Unknown { type_name, problem },
                    _ => DecodeError::Definition { type_name, problem },
                }
            })?;
            if let Some(taken) = found.taken {
                tracing::warn!("{}: {taken}", info.name);
            }
            let json = Encoding::Json.codec_of_text(&info.type_name, &found.definition.text)?;
            return Ok(Self { message_type: found.definition.message_type, json, recorded: None });
        }
        let recorded = RecordedType::of(topic, interfaces)?;
        let known = recorded.message_type();
        let message_type = DynamicType::from_definition_text(known.name(), "ros2msg", known.definition())?;
        let json = Encoding::Json.codec_of_text(known.name(), known.definition())?;
        Ok(Self { message_type, json, recorded: Some(recorded) })
    }

    /// The type of the messages.
    #[must_use]
    pub fn message_type(&self) -> &DynamicType {
        &self.message_type
    }

    /// Returns a message as JSON, in the form of a bag with the encoding JSON.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a message of the type.
    pub fn to_json(&self, data: Bytes) -> Result<Vec<u8>, DecodeError> {
        Ok(self.json.encode(&self.to_cdr(data)?)?)
    }

    /// Decodes a message.
    ///
    /// # Errors
    /// Returns an error if the bytes are not a message of the type.
    pub fn decode(&self, data: Bytes) -> Result<DynamicMessage, DecodeError> {
        Ok(DynamicMessage::from_cdr(&self.message_type, &self.to_cdr(data)?)?)
    }

    /// Converts a message to CDR.
    ///
    /// # Errors
    /// If the bytes are not a message of the type. CDR is not checked.
    pub fn to_cdr(&self, data: Bytes) -> Result<Bytes, encoding::Error> {
        match &self.recorded {
            Some(recorded) => recorded.to_cdr(data),
            None => Ok(data),
        }
    }
}

/// The most elements of an array that have a column each.
pub const MOST_ELEMENTS: usize = 1000;

/// The place of a leaf: the index of the field, of the element, of the field in the element, and so on.
type Place = Vec<usize>;

/// Visitor of leaves: scalars, and arrays that are not split into elements.
trait Visit {
    fn leaf(&mut self, place: &[usize], path: &str, value: ValueRef<'_>);

    /// Returns whether the array at `place` has a single column.
    fn is_whole(&mut self, place: &[usize], array: &Array) -> bool;
}

/// Visits all leaves of a message in the order of its fields.
fn visit(message: MessageRef<'_>, visitor: &mut impl Visit) {
    Walk { place: Vec::new(), path: String::new(), visitor }.message(message);
}

struct Walk<'a, V> {
    place: Place,
    path: String,
    visitor: &'a mut V,
}

impl<V: Visit> Walk<'_, V> {
    fn message(&mut self, message: MessageRef<'_>) {
        let parent = self.path.len();
        for (index, (name, value)) in message.fields().enumerate() {
            if parent > 0 {
                self.path.push('.');
            }
            self.path.push_str(name);
            self.place.push(index);
            self.value(value);
            self.place.pop();
            self.path.truncate(parent);
        }
    }

    fn value(&mut self, value: ValueRef<'_>) {
        match value {
            ValueRef::Message(message) => self.message(message),
            ValueRef::Array(array) if !self.visitor.is_whole(&self.place, array) => {
                let parent = self.path.len();
                for (index, element) in array.iter().enumerate() {
                    // Writing to a string does not fail.
                    let _ = write!(self.path, "[{index}]");
                    self.place.push(index);
                    self.value(element);
                    self.place.pop();
                    self.path.truncate(parent);
                }
            }
            value => self.visitor.leaf(&self.place, &self.path, value),
        }
    }
}
