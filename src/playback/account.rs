//! What a bag contains about the recorded run: its cycles and changed settings.

use std::collections::{BTreeMap, BTreeSet, VecDeque};

use bytes::Bytes;
use downbeat_bags::{Reader, Selection, TopicId};
use downbeat_edge::Interfaces;
use downbeat_edge::setting_value;
use downbeat_executor::Core;
use downbeat_msgs::downbeat_interfaces::msg::{CycleTimes, ModuleSettings};
use downbeat_msgs::{Message, cdr};

use super::PlaybackError;
use crate::encoding::RecordedType;
use crate::journal;
use crate::running::SIMULATED_TIME;

/// The messages of several topics as CDR, per topic in the order of the bag. Every chunk contains messages of
/// most topics, so reading several topics together takes as long as reading one.
pub(crate) struct Extract {
    interfaces: Interfaces,
    messages: BTreeMap<TopicId, Vec<Bytes>>,
}

impl Extract {
    /// Creates an empty extract.
    pub(crate) fn new(interfaces: &Interfaces) -> Self {
        Self { interfaces: interfaces.clone(), messages: BTreeMap::new() }
    }

    pub(crate) fn read(
        reader: &Reader,
        topics: &BTreeSet<TopicId>,
        interfaces: &Interfaces,
    ) -> Result<Self, PlaybackError> {
        let mut extract = BTreeMap::new();
        for &id in topics {
            extract.insert(id, (RecordedType::of(&reader.topics()[id.index()], interfaces)?, Vec::new()));
        }
        for message in reader.messages(Selection::all().topics(topics.iter().copied()))? {
            let message = message?;
            if let Some((recorded, messages)) = extract.get_mut(&message.topic) {
                messages.push(recorded.to_cdr(message.data)?);
            }
        }
        let messages = extract.into_iter().map(|(id, (_, messages))| (id, messages)).collect();
        Ok(Self { interfaces: interfaces.clone(), messages })
    }

    /// The interfaces with which the messages were read.
    pub(crate) fn interfaces(&self) -> &Interfaces {
        &self.interfaces
    }

    /// Returns the messages of a topic, and reads them if that has not happened yet.
    pub(crate) fn of(&mut self, reader: &Reader, topic: TopicId) -> Result<&[Bytes], PlaybackError> {
        if !self.messages.contains_key(&topic) {
            let mut read = Self::read(reader, &BTreeSet::from([topic]), &self.interfaces)?;
            self.messages.append(&mut read.messages);
        }
        Ok(self.messages.get(&topic).map_or(&[], Vec::as_slice))
    }

    /// Like `of`, but decodes the messages. Returns none if the bag lacks the topic.
    pub(crate) fn messages<T: Message>(
        &mut self,
        reader: &Reader,
        topic: &'static str,
    ) -> Result<Option<Vec<T>>, PlaybackError> {
        let Some(id) = reader.topic(&format!("/{topic}")) else { return Ok(None) };
        let messages = self.of(reader, id)?.iter().map(|message| cdr::from_slice(message));
        Ok(Some(messages.collect::<Result<_, _>>().map_err(|error| PlaybackError::account(topic, error))?))
    }
}

/// Returns whether the bag was recorded in simulated time, in which all modules run inside the cycle.
pub(crate) fn was_in_simulated_time(reader: &Reader) -> bool {
    reader.metadata().is_some_and(|metadata| metadata.custom_data.contains_key(SIMULATED_TIME))
}

/// What a bag contains about the cycles.
pub(crate) enum Cycles {
    /// The time of each cycle, up to those in which the robot began to stop if the recording was not interrupted.
    Recorded {
        times: Vec<i64>,
        /// See [`Cycles::end`].
        end: i64,
    },
    /// The bag was recorded in a robot but without the cycle times: there was a cycle at the time of each
    /// message.
    OfMessages,
    /// The bag was recorded elsewhere, for example from ROS 2: timers fire at their exact times.
    Unknown,
}

impl Cycles {
    pub(crate) fn read(reader: &Reader, extract: &mut Extract) -> Result<Self, PlaybackError> {
        let messages = extract.messages::<CycleTimes>(reader, journal::CYCLES)?.unwrap_or_default();
        if messages.is_empty() {
            // Metadata that the recorder writes for each robot.
            let is_of_robot =
                reader.metadata().is_some_and(|metadata| metadata.custom_data.contains_key("robot"));
            return Ok(if is_of_robot { Self::OfMessages } else { Self::Unknown });
        }
        let (mut times, mut is_whole) = (Vec::new(), false);
        for message in messages {
            if message.first != times.len() as u64 {
                return Err(PlaybackError::CyclesLost { expected: times.len() as u64, found: message.first });
            }
            times.extend_from_slice(&message.times);
            is_whole = message.is_end;
        }
        let last = times.last().copied().unwrap_or(i64::MIN);
        // In simulated time the robot stopped at the time of the last cycle, else later.
        let has_all_of_last = is_whole && !was_in_simulated_time(reader);
        Ok(Self::Recorded { times, end: if has_all_of_last { last.saturating_add(1) } else { last } })
    }

    pub(crate) fn is_recorded(&self) -> bool {
        matches!(self, Self::Recorded { .. })
    }

    /// The time of the first recorded cycle.
    pub(crate) fn first(&self) -> Option<i64> {
        match self {
            Self::Recorded { times, .. } => times.first().copied(),
            Self::OfMessages | Self::Unknown => None,
        }
    }

    /// The time from which messages of modules are not compared. The cycles in which the robot stopped are not
    /// recorded; an interrupted recording may also lack the messages of its last cycle.
    pub(crate) fn end(&self) -> i64 {
        match self {
            Self::Recorded { end, .. } => *end,
            Self::OfMessages | Self::Unknown => i64::MAX,
        }
    }
}

/// The changes of settings of several modules, in their recorded order.
#[derive(Default)]
pub(crate) struct SettingsChanges(VecDeque<ModuleSettings>);

impl SettingsChanges {
    /// Reads the changes of the wanted modules; empty if the bag lacks the topic.
    pub(crate) fn read(
        reader: &Reader,
        extract: &mut Extract,
        is_wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, PlaybackError> {
        let changes = extract.messages::<ModuleSettings>(reader, journal::SETTINGS)?.unwrap_or_default();
        Ok(Self(changes.into_iter().filter(|change| is_wanted(&change.module)).collect()))
    }

    /// Applies the changes that are due in the next sync phase of the core.
    pub(crate) fn give(
        &mut self,
        core: &Core,
        is_due: impl Fn(&ModuleSettings) -> bool,
    ) -> Result<(), PlaybackError> {
        while self.0.front().is_some_and(&is_due) {
            let Some(change) = self.0.pop_front() else { break };
            for parameter in change.settings {
                let setting = format!("{}.{}", change.module, parameter.name);
                let value = setting_value(parameter.value).map_err(|problem| {
                    PlaybackError::account(journal::SETTINGS, format!("{setting}: {problem}"))
                })?;
                // If the module refuses the value, the difference shows in its messages.
                drop(core.handle().set(&change.module, &parameter.name, value));
            }
        }
        Ok(())
    }
}
