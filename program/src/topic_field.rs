//! `TOPIC:FIELD` on the command line.

use std::fmt;
use std::str::FromStr;

/// A field of a topic: `joint_states:position[3]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TopicField {
    pub(crate) topic: String,
    pub(crate) field: String,
}

impl FromStr for TopicField {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.rsplit_once(':') {
            Some((topic, field)) if !topic.is_empty() && !field.is_empty() => {
                Ok(Self { topic: topic.to_owned(), field: field.to_owned() })
            }
            _ => Err("write TOPIC:FIELD, such as joint_states:position[3]".to_owned()),
        }
    }
}

impl fmt::Display for TopicField {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}:{}", self.topic, self.field)
    }
}
