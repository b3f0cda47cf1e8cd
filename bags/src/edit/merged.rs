//! Several bags as one stream of messages.

use std::collections::VecDeque;

use crate::reader::{BagMessage, Messages, ReaderError, RecordedTopic};
use crate::topic::TopicId;

/// The topics of several bags, each once, and the messages of all of them by time; where times are equal, in the order of
/// the bags.
pub struct Merged {
    streams: Vec<Stream>,
    /// Told before further messages.
    errors: VecDeque<ReaderError>,
}

/// What each topic of one bag, by position, is among those of several.
pub type TopicMap = Vec<Option<TopicId>>;

struct Stream {
    messages: Messages,
    next: Option<BagMessage>,
    /// From the bag's topics to those of all.
    topics: TopicMap,
}

/// Two bags have a topic of one name that is not the same.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("topic {topic} is of type {first} in one bag and {second} in another; leave it out")]
pub struct TypeConflict {
    /// The topic.
    pub topic: String,
    /// Its type, and how it is serialised.
    pub first: String,
    /// The other.
    pub second: String,
}

/// The topics of several bags, each name once, with the counts of all, and for each bag which of them its topics are.
///
/// # Errors
/// If one name has several types or serialisations.
pub fn merge_topics(bags: &[&[RecordedTopic]]) -> Result<(Vec<RecordedTopic>, Vec<TopicMap>), TypeConflict> {
    let mut all: Vec<RecordedTopic> = Vec::new();
    let mut ids = Vec::new();
    for topics in bags {
        let mut of_bag = Vec::new();
        for topic in *topics {
            let known = all.iter().position(|known| known.info.name == topic.info.name);
            let index = known.unwrap_or_else(|| {
                all.push(RecordedTopic { message_count: 0, ..topic.clone() });
                all.len() - 1
            });
            let merged = &mut all[index];
            let kind =
                |topic: &RecordedTopic| format!("{} as {}", topic.info.type_name, topic.serialization_format);
            if kind(merged) != kind(topic) {
                return Err(TypeConflict {
                    topic: topic.info.name.clone(),
                    first: kind(merged),
                    second: kind(topic),
                });
            }
            merged.message_count = merged.message_count.saturating_add(topic.message_count);
            for qos in &topic.info.offered_qos {
                if !merged.info.offered_qos.contains(qos) {
                    merged.info.offered_qos.push(*qos);
                }
            }
            if merged.info.definition.is_empty() {
                merged.info.definition.clone_from(&topic.info.definition);
            }
            of_bag.push(TopicId::from_index(index));
        }
        ids.push(of_bag);
    }
    Ok((all, ids))
}

impl Merged {
    /// Merges these messages; beside each the topics that its own stand for, as [`merge_topics`] tells.
    #[must_use]
    pub fn new(streams: Vec<(Messages, TopicMap)>) -> Self {
        let streams = streams.into_iter();
        let streams = streams.map(|(messages, topics)| Stream { messages, next: None, topics });
        Self { streams: streams.collect(), errors: VecDeque::new() }
    }
}

impl Iterator for Merged {
    type Item = Result<BagMessage, ReaderError>;

    fn next(&mut self) -> Option<Self::Item> {
        for stream in &mut self.streams {
            while stream.next.is_none() {
                match stream.messages.next() {
                    None => break,
                    Some(Err(error)) => self.errors.push_back(error),
                    Some(Ok(message)) => {
                        let topic = stream.topics.get(message.topic.index()).copied().flatten();
                        stream.next = topic.map(|topic| BagMessage { topic, ..message });
                    }
                }
            }
        }
        if let Some(error) = self.errors.pop_front() {
            return Some(Err(error));
        }
        let time = |stream: &&mut Stream| stream.next.as_ref().map_or(i64::MAX, |message| message.log_time);
        let waiting = self.streams.iter_mut().filter(|stream| stream.next.is_some());
        waiting.min_by_key(time)?.next.take().map(Ok)
    }
}
