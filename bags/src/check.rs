//! Checks the integrity of a bag.

use std::collections::HashMap;
use std::fmt;

use downbeat_msgs::dynamic::{Definitions, DynamicType};
use downbeat_msgs::printable;

use crate::reader::{BagMessage, Reader, ReaderError, RecordedTopic, Selection, Truncation};
use crate::topic::TopicId;

/// A problem found in a bag.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Problem {
    /// A file is incomplete.
    Truncated(Truncation),
    /// A part of it cannot be read.
    Unreadable(String),
    /// metadata.yaml, or the record in the file, declares a different number of messages.
    Count {
        /// The topic; `None` for the whole bag.
        topic: Option<String>,
        /// The declared number.
        declared: u64,
        /// The actual number.
        found: u64,
    },
    /// There is no metadata.yaml.
    NoMetadata,
    /// A topic has no definition of its type, and none is known.
    NoDefinition {
        /// The topic.
        topic: String,
        /// Its type.
        type_name: String,
    },
    /// The definition of a type is invalid.
    Definition {
        /// The topic.
        topic: String,
        /// The problem.
        found: String,
    },
    /// Messages cannot be decoded as their type.
    Message {
        /// The topic.
        topic: String,
        /// The number of such messages.
        count: u64,
        /// The problem with the first one.
        first: String,
    },
    /// The recorder noted that messages were lost.
    Lost(String),
}

/// The result of a check.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Check {
    /// The number of messages read.
    pub messages: u64,
    /// The number of messages decoded by the definition of their type.
    pub decoded: u64,
    /// The problems found.
    pub problems: Vec<Problem>,
    /// What the check took from elsewhere to decode messages, as sentences: definitions that the bag lacks.
    pub notes: Vec<String>,
}

/// Reads a whole bag: checksums, counts, definitions and every message. `progress` is called with the number
/// of messages read. Definitions that the bag lacks are looked up in the built-in interfaces; see
/// [`check_with`].
///
/// # Errors
/// Returns an error if a file can no longer be opened.
pub fn check(reader: &Reader, progress: impl FnMut(u64)) -> Result<Check, ReaderError> {
    check_with(reader, &Definitions::new().with_carried(), progress)
}

/// Like [`check`], with these definitions.
///
/// # Errors
/// Returns an error if a file can no longer be opened.
pub fn check_with(
    reader: &Reader,
    known: &Definitions,
    mut progress: impl FnMut(u64),
) -> Result<Check, ReaderError> {
    let mut check = Check { messages: 0, decoded: 0, problems: Vec::new(), notes: Vec::new() };
    check.problems.extend(reader.truncation().cloned().map(Problem::Truncated));
    let mut decoding = Decoding::new(known);
    for topic in reader.topics() {
        decoding.add(topic, &mut check.problems, &mut check.notes);
    }
    let mut counts = vec![0; reader.topics().len()];
    for message in reader.messages(Selection::all().with_repeated())? {
        let message = match message {
            Ok(message) => message,
            Err(error) => {
                check.problems.push(Problem::Unreadable(error.to_string()));
                continue;
            }
        };
        counts[message.topic.index()] += 1;
        check.messages += 1;
        check.decoded += u64::from(decoding.decodes(&message));
        if check.messages.is_multiple_of(256) {
            progress(check.messages);
        }
    }
    progress(check.messages);
    check.problems.extend(decoding.problems(reader.topics()));
    check.compare_counts(reader, &counts);
    Ok(check)
}

/// Decodes messages by the definitions of their types, and counts those that cannot be decoded.
pub(crate) struct Decoding<'a> {
    known: &'a Definitions,
    /// By topic.
    types: Vec<Option<DynamicType>>,
    /// Topics may share them.
    found: HashMap<DefinitionKey, Found>,
    /// The number of messages that cannot be decoded, and the problem with the first one.
    refused: Vec<(u64, String)>,
}

/// Type, definition, hash, and the encoding and data of the schema.
type DefinitionKey = (String, String, String, Option<(String, Vec<u8>)>);
/// A type, and what was taken from elsewhere; or why there is none.
type Found = Result<(DynamicType, Option<String>), String>;

impl<'a> Decoding<'a> {
    /// Looks up in `known` what the bag lacks.
    pub(crate) fn new(known: &'a Definitions) -> Self {
        Self { known, types: Vec::new(), found: HashMap::new(), refused: Vec::new() }
    }

    /// Adds a topic, with problems of its definition and notes about it.
    pub(crate) fn add(
        &mut self,
        topic: &RecordedTopic,
        problems: &mut Vec<Problem>,
        notes: &mut Vec<String>,
    ) {
        let of = self.definition(topic, problems, notes);
        self.types.push(of);
        self.refused.push((0, String::new()));
    }

    /// Returns whether the definition of the message's type is known and matches it.
    pub(crate) fn decodes(&mut self, message: &BagMessage) -> bool {
        let topic = message.topic.index();
        let Some(Some(of)) = self.types.get(topic) else { return false };
        match of.validate_cdr(&message.data) {
            Ok(()) => true,
            Err(error) => {
                let (count, first) = &mut self.refused[topic];
                if *count == 0 {
                    *first = error.to_string();
                }
                *count += 1;
                false
            }
        }
    }

    /// The topics with messages that cannot be decoded.
    pub(crate) fn problems(self, topics: &[RecordedTopic]) -> impl Iterator<Item = Problem> {
        let refused = topics.iter().zip(self.refused).filter(|(_, (count, _))| *count > 0);
        refused.map(|(topic, (count, first))| Problem::Message {
            topic: topic.info.name.clone(),
            count,
            first,
        })
    }

    /// The type of a topic's messages, if they are CDR and its definition is known.
    fn definition(
        &mut self,
        topic: &RecordedTopic,
        problems: &mut Vec<Problem>,
        notes: &mut Vec<String>,
    ) -> Option<DynamicType> {
        let info = &topic.info;
        if !info.is_cdr() {
            return None;
        }
        let schema = info.format.as_ref().map(|format| &format.schema);
        let schema = schema.map(|schema| (schema.encoding.clone(), schema.data.clone()));
        let key = (info.type_name.clone(), info.definition.clone(), info.type_hash.clone(), schema);
        let found = self.found.entry(key).or_insert_with(|| {
            let found = info.definition_with(self.known).map_err(|error| error.to_string())?;
            Ok((found.definition.message_type, found.taken))
        });
        match found {
            Ok((of, taken)) => {
                notes.extend(taken.as_ref().map(|taken| format!("{}: {taken}", info.name)));
                return Some(of.clone());
            }
            Err(_) if info.definition.is_empty() && info.schema().encoding.is_empty() => {
                // rosbag2 has no definitions of service events either.
                if topic.message_count > 0 && !info.type_name.contains("/srv/") {
                    let (topic, type_name) = (info.name.clone(), info.type_name.clone());
                    problems.push(Problem::NoDefinition { topic, type_name });
                }
            }
            Err(found) => {
                let (topic, found) = (info.name.clone(), found.clone());
                problems.push(Problem::Definition { topic, found });
            }
        }
        None
    }
}

impl Check {
    fn compare_counts(&mut self, reader: &Reader, counts: &[u64]) {
        let Some(metadata) = reader.metadata() else {
            if reader.path().is_dir() {
                self.problems.push(Problem::NoMetadata);
            }
            return;
        };
        if let Some(lost) = metadata.custom_data.get("lost_messages") {
            self.problems.push(Problem::Lost(lost.clone()));
        }
        let mut compare = |topic: Option<&str>, declared: u64, found: u64| {
            if declared != found {
                self.problems.push(Problem::Count { topic: topic.map(str::to_owned), declared, found });
            }
        };
        compare(None, metadata.message_count, counts.iter().sum());
        for topic in &metadata.topics {
            let found = reader.topic(&topic.name).map(TopicId::index);
            let found = found.and_then(|index| counts.get(index)).copied().unwrap_or(0);
            compare(Some(&topic.name), topic.message_count, found);
        }
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Truncated(truncation) => truncation.fmt(f),
            Self::Unreadable(found) => f.write_str(&printable(found)),
            Self::Count { topic: None, declared, found } => {
                write!(f, "the metadata declares {declared} messages, found {found}")
            }
            Self::Count { topic: Some(topic), declared, found } => {
                let topic = printable(topic);
                write!(f, "{topic}: the metadata declares {declared} messages, found {found}")
            }
            Self::NoMetadata => f.write_str("there is no metadata.yaml; `downbeat bag reindex` creates it"),
            Self::NoDefinition { topic, type_name } => {
                let (topic, type_name) = (printable(topic), printable(type_name));
                write!(f, "{topic}: the bag has no definition of {type_name}, and none is known")
            }
            Self::Definition { topic, found } => {
                let (topic, found) = (printable(topic), printable(found));
                write!(f, "{topic}: the definition of its type cannot be read: {found}")
            }
            Self::Message { topic, count, first } => {
                let (topic, first) = (printable(topic), printable(first));
                write!(f, "{topic}: {count} messages cannot be decoded; the first: {first}")
            }
            Self::Lost(lost) => write!(f, "messages were lost when it was recorded: {lost}"),
        }
    }
}
