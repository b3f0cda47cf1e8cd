//! Compares two bags.

use std::collections::{BTreeMap, VecDeque};
use std::fmt;

use downbeat_msgs::printable;

use crate::compare::{Comparer, FieldDifference, FieldRule};
use crate::reader::{BagMessage, Reader, ReaderError, Selection};

/// The comparison of two bags, topic by topic.
#[derive(Clone, Debug, PartialEq)]
pub struct BagDiff {
    /// Every topic of either bag, by name.
    pub topics: Vec<TopicDiff>,
    /// The parts of either bag that could not be read.
    pub unreadable: Vec<String>,
}

/// The comparison of a topic: the n-th message of one bag with the n-th message of the other.
#[derive(Clone, Debug, PartialEq)]
pub struct TopicDiff {
    /// The topic.
    pub topic: String,
    /// Its type and number of messages in the first bag, if present.
    pub first: Option<(String, u64)>,
    /// Its type and number of messages in the second bag, if present.
    pub second: Option<(String, u64)>,
    /// The number of compared pairs of messages.
    pub compared: u64,
    /// The number of pairs that differ.
    pub different: u64,
    /// The first pair that differs.
    pub difference: Option<MessageDiff>,
}

/// Two messages that differ.
#[derive(Clone, Debug, PartialEq)]
pub struct MessageDiff {
    /// The index of the message in its topic, from 0.
    pub number: u64,
    /// The receive time in the first bag, in nanoseconds since the epoch.
    pub time: i64,
    /// How they differ.
    pub what: MessageDiffKind,
}

/// How two messages differ.
#[derive(Clone, Debug, PartialEq)]
pub enum MessageDiffKind {
    /// In a field.
    Field(FieldDifference),
    /// In the receive time: that of the second bag, in nanoseconds since the epoch.
    Time(i64),
}

/// How to compare two bags.
#[derive(Clone, Debug, Default)]
pub struct DiffOptions {
    /// How exactly fields are compared: bit for bit unless a rule applies.
    pub rules: Vec<FieldRule>,
    /// Whether the receive times of messages must also be equal.
    pub compares_times: bool,
}

struct Side {
    topic: TopicDiff,
    comparer: Option<Comparer>,
    waiting: [VecDeque<BagMessage>; 2],
}

/// Compares two bags. `progress` is called with the number of messages read from both.
///
/// # Errors
/// Returns an error if a file can no longer be opened.
pub fn diff(
    first: &Reader,
    second: &Reader,
    options: &DiffOptions,
    mut progress: impl FnMut(u64),
) -> Result<BagDiff, ReaderError> {
    let mut sides: BTreeMap<String, Side> = BTreeMap::new();
    for (reader, is_first) in [(first, true), (second, false)] {
        for topic in reader.topics() {
            let side = sides.entry(topic.info.name.clone()).or_insert_with(|| Side {
                topic: TopicDiff::new(&topic.info.name),
                comparer: None,
                waiting: [VecDeque::new(), VecDeque::new()],
            });
            let entry = Some((topic.info.type_name.clone(), topic.message_count));
            if is_first {
                side.topic.first = entry;
            } else {
                side.topic.second = entry;
            }
            side.comparer.get_or_insert_with(|| Comparer::new(&topic.info, &options.rules));
        }
    }
    let mut unreadable = Vec::new();
    let mut read = 0;
    let mut streams = [first.messages(Selection::all())?, second.messages(Selection::all())?];
    let mut is_open = [true, true];
    while is_open.contains(&true) {
        // Alternates, so that few messages wait for their counterpart.
        for (index, reader) in [first, second].into_iter().enumerate() {
            match streams[index].next() {
                None => is_open[index] = false,
                Some(Err(error)) => unreadable.push(error.to_string()),
                Some(Ok(message)) => {
                    read += 1;
                    let name = &reader.topics()[message.topic.index()].info.name;
                    if let Some(side) = sides.get_mut(name) {
                        side.waiting[index].push_back(message);
                        side.compare(options);
                    }
                }
            }
        }
        if read % 256 < 2 {
            progress(read);
        }
    }
    progress(read);
    Ok(BagDiff { topics: sides.into_values().map(|side| side.topic).collect(), unreadable })
}

impl BagDiff {
    /// Returns whether there is no difference.
    #[must_use]
    pub fn is_same(&self) -> bool {
        self.unreadable.is_empty() && self.topics.iter().all(TopicDiff::is_same)
    }

    /// The earliest pair of messages that differs, with its topic.
    #[must_use]
    pub fn first_difference(&self) -> Option<(&TopicDiff, &MessageDiff)> {
        let differences = self.topics.iter().filter_map(|topic| Some((topic, topic.difference.as_ref()?)));
        differences.min_by_key(|(_, difference)| difference.time)
    }
}

impl TopicDiff {
    fn new(topic: &str) -> Self {
        Self {
            topic: topic.to_owned(),
            first: None,
            second: None,
            compared: 0,
            different: 0,
            difference: None,
        }
    }

    /// Returns whether both bags contain it with the same messages.
    #[must_use]
    pub fn is_same(&self) -> bool {
        self.first == self.second && self.different == 0
    }
}

impl Side {
    fn compare(&mut self, options: &DiffOptions) {
        let [first, second] = &mut self.waiting;
        if first.is_empty() || second.is_empty() {
            return;
        }
        let (Some(first), Some(second)) = (first.pop_front(), second.pop_front()) else { return };
        let field = self.comparer.as_ref().and_then(|comparer| comparer.compare(&first.data, &second.data));
        let is_late = options.compares_times && first.log_time != second.log_time;
        let what = match field {
            Some(field) => Some(MessageDiffKind::Field(field)),
            None => is_late.then_some(MessageDiffKind::Time(second.log_time)),
        };
        let number = self.topic.compared;
        self.topic.compared += 1;
        if let Some(what) = what {
            self.topic.different += 1;
            self.topic.difference.get_or_insert(MessageDiff { number, time: first.log_time, what });
        }
    }
}

impl fmt::Display for TopicDiff {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let topic = printable(&self.topic);
        match (&self.first, &self.second) {
            (Some(_), None) => write!(f, "{topic}: only in the first bag"),
            (None, Some(_)) => write!(f, "{topic}: only in the second bag"),
            (Some((one, _)), Some((other, _))) if one != other => {
                write!(f, "{topic}: {} in the first bag, {} in the second", printable(one), printable(other))
            }
            (Some((_, one)), Some((_, other))) if one != other => {
                write!(f, "{topic}: {one} messages in the first bag, {other} in the second")?;
                if self.different > 0 {
                    write!(f, "; {} of {} pairs differ", self.different, self.compared)
                } else {
                    Ok(())
                }
            }
            _ => write!(f, "{topic}: {} of {} messages differ", self.different, self.compared),
        }
    }
}
