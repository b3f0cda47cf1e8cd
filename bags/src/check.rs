//! Checks the integrity of a bag.

use std::fmt;

use downbeat_msgs::dynamic::{Definitions, DynamicMessage, DynamicType};
use downbeat_msgs::printable;

use crate::reader::{Reader, ReaderError, RecordedTopic, Selection, Truncation};
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
/// of messages read. Definitions that the bag lacks are looked up in the built-in interfaces; see [`check_with`].
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
    let mut types = Vec::new();
    for topic in reader.topics() {
        types.push(check.definition(topic, known));
    }
    let mut counts = vec![0; types.len()];
    let mut refused: Vec<(u64, String)> = vec![(0, String::new()); types.len()];
    for message in reader.messages(Selection::all())? {
        let message = match message {
            Ok(message) => message,
            Err(error) => {
                check.problems.push(Problem::Unreadable(error.to_string()));
                continue;
            }
        };
        let topic = message.topic.index();
        counts[topic] += 1;
        check.messages += 1;
        if let Some(of) = &types[topic] {
            match DynamicMessage::from_cdr(of, &message.data) {
                Ok(_) => check.decoded += 1,
                Err(error) => {
                    let (count, first) = &mut refused[topic];
                    if *count == 0 {
                        *first = error.to_string();
                    }
                    *count += 1;
                }
            }
        }
        if check.messages.is_multiple_of(256) {
            progress(check.messages);
        }
    }
    progress(check.messages);
    for (topic, (count, first)) in reader.topics().iter().zip(refused) {
        if count > 0 {
            check.problems.push(Problem::Message { topic: topic.info.name.clone(), count, first });
        }
    }
    check.compare_counts(reader, &counts);
    Ok(check)
}

impl Check {
    /// The type of a topic's messages, if they are CDR and its definition is known.
    fn definition(&mut self, topic: &RecordedTopic, known: &Definitions) -> Option<DynamicType> {
        let info = &topic.info;
        if !info.is_cdr() {
            return None;
        }
        match info.definition_with(known) {
            Ok(found) => {
                self.notes.extend(found.taken.map(|taken| format!("{}: {taken}", info.name)));
                return Some(found.definition.message_type);
            }
            Err(_) if info.definition.is_empty() && info.schema().encoding.is_empty() => {
                // rosbag2 has no definitions of service events either.
                if topic.message_count > 0 && !info.type_name.contains("/srv/") {
                    let (topic, type_name) = (info.name.clone(), info.type_name.clone());
                    self.problems.push(Problem::NoDefinition { topic, type_name });
                }
            }
            Err(error) => {
                let (topic, found) = (info.name.clone(), error.to_string());
                self.problems.push(Problem::Definition { topic, found });
            }
        }
        None
    }

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
