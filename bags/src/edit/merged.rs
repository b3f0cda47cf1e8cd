//! Several bags as one stream of messages.

use std::collections::VecDeque;

use crate::reader::{BagMessage, Messages, Reader, ReaderError, RecordedTopic, Selection};
use crate::topic::{TopicId, TopicInfo};

/// The messages of several bags sorted by time, or by bag if times are equal. Created by
/// [`MergedBags::messages`].
pub struct Merged {
    streams: Vec<Stream>,
    /// Returned before further messages.
    errors: VecDeque<ReaderError>,
}

/// Maps the position of each topic in one bag to its id in the merged bags.
type TopicMap = Vec<Option<TopicId>>;

struct Stream {
    messages: Messages,
    next: Option<BagMessage>,
    /// From the bag's topics to the merged topics.
    topics: TopicMap,
}

/// Two bags contain different topics with the same name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("topic {topic} is of type {first} in one bag and {second} in another; leave it out")]
pub struct TypeConflict {
    /// The topic.
    pub topic: String,
    /// Its type and serialisation in one bag.
    pub first: String,
    /// Its type and serialisation in the other bag.
    pub second: String,
}

/// Several bags as one: a selection of their topics, each name once.
pub struct MergedBags<'a> {
    bags: &'a [Reader],
    topics: Vec<RecordedTopic>,
    maps: Vec<TopicMap>,
}

impl<'a> MergedBags<'a> {
    /// Merges the selected topics; other topics cannot conflict.
    ///
    /// # Errors
    /// If a topic has several types or serialisations.
    pub fn new(bags: &'a [Reader], is_wanted: impl Fn(&TopicInfo) -> bool) -> Result<Self, TypeConflict> {
        let mut merged = Self { bags, topics: Vec::new(), maps: Vec::new() };
        for bag in bags {
            let topics = bag.topics().iter();
            let map = topics.map(|topic| is_wanted(&topic.info).then(|| merged.add(topic)).transpose());
            let map = map.collect::<Result<Vec<_>, _>>()?;
            merged.maps.push(map.into_iter().map(Option::flatten).collect());
        }
        Ok(merged)
    }

    /// The topics, with the counts of all bags; messages refer to them by position.
    #[must_use]
    pub fn topics(&self) -> &[RecordedTopic] {
        &self.topics
    }

    /// The messages of all bags sorted by time, for topics for which `is_meant` returns true.
    ///
    /// # Errors
    /// If a bag can no longer be opened.
    pub fn messages(
        &self,
        selection: &Selection,
        is_meant: impl Fn(&RecordedTopic) -> bool,
    ) -> Result<Merged, ReaderError> {
        let stream = |(bag, map): (&Reader, &TopicMap)| -> Result<Stream, ReaderError> {
            let meant = map.iter().enumerate().filter_map(|(index, merged)| {
                is_meant(&self.topics[(*merged)?.index()]).then(|| TopicId::from_index(index)).flatten()
            });
            let messages = bag.messages(selection.clone().topics(meant))?;
            Ok(Stream { messages, next: None, topics: map.clone() })
        };
        let streams = self.bags.iter().zip(&self.maps).map(stream).collect::<Result<_, _>>()?;
        Ok(Merged { streams, errors: VecDeque::new() })
    }

    /// Returns the messages of latched (transient local) topics that a subscriber would receive after
    /// `messages`, sorted by time like these.
    pub(crate) fn last_latched(&self, messages: impl Iterator<Item = BagMessage>) -> Vec<BagMessage> {
        let mut last: Vec<VecDeque<BagMessage>> = vec![VecDeque::new(); self.topics.len()];
        for message in messages {
            let topic = message.topic.index();
            last[topic].push_back(message);
            if last[topic].len() > self.topics[topic].info.latched_depth() {
                last[topic].pop_front();
            }
        }
        let mut kept: Vec<BagMessage> = last.into_iter().flatten().collect();
        kept.sort_by_key(|message| message.log_time);
        kept
    }

    fn add(&mut self, topic: &RecordedTopic) -> Result<Option<TopicId>, TypeConflict> {
        let known = self.topics.iter().position(|known| known.info.name == topic.info.name);
        let index = known.unwrap_or_else(|| {
            self.topics.push(RecordedTopic { message_count: 0, ..topic.clone() });
            self.topics.len() - 1
        });
        let merged = &mut self.topics[index];
        let kind =
            |topic: &RecordedTopic| format!("{} as {}", topic.info.type_name, topic.serialization_format);
        if kind(merged) != kind(topic) {
            let (first, second) = (kind(merged), kind(topic));
            return Err(TypeConflict { topic: topic.info.name.clone(), first, second });
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
        Ok(TopicId::from_index(index))
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
