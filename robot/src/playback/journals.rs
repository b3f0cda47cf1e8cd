//! What a bag contains about the recorded run: its cycles and changed settings.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use bytes::Bytes;
use downbeat_bags::{Reader, Selection, TopicId};
use downbeat_edge::Interfaces;
use downbeat_edge::setting_value;
use downbeat_executor::Core;
use downbeat_msgs::downbeat_interfaces::msg::{CycleMessages, CycleTimes, ModuleSettings};
use downbeat_msgs::{Message, cdr};

use super::PlaybackError;
use crate::encoding::RecordedType;
use crate::journal;
use crate::running::{RECORDED_FROM, SIMULATED_TIME};

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

    /// Reads all topics that describe the recorded run.
    pub(crate) fn read_journals(&mut self, reader: &Reader) -> Result<(), PlaybackError> {
        let journals =
            [journal::CYCLES, journal::MESSAGES, journal::SETTINGS, journal::EVENTS, journal::STEPS];
        self.read(reader, journals.into_iter().filter_map(|topic| reader.topic(&format!("/{topic}"))))
    }

    /// Reads those of the topics that were not read before.
    pub(crate) fn read(
        &mut self,
        reader: &Reader,
        topics: impl IntoIterator<Item = TopicId>,
    ) -> Result<(), PlaybackError> {
        let mut extract = BTreeMap::new();
        for id in topics.into_iter().filter(|id| !self.messages.contains_key(id)) {
            let recorded = RecordedType::of(&reader.topics()[id.index()], &self.interfaces)?;
            extract.insert(id, (recorded, Vec::new()));
        }
        if extract.is_empty() {
            return Ok(());
        }
        for message in reader.messages(Selection::all().topics(extract.keys().copied()))? {
            let message = message?;
            if let Some((recorded, messages)) = extract.get_mut(&message.topic) {
                messages.push(recorded.to_cdr(message.data)?);
            }
        }
        self.messages.extend(extract.into_iter().map(|(id, (_, messages))| (id, messages)));
        Ok(())
    }

    /// The interfaces with which the messages were read.
    pub(crate) fn interfaces(&self) -> &Interfaces {
        &self.interfaces
    }

    /// Returns the messages of a topic, and reads them if that has not happened yet.
    pub(crate) fn of(&mut self, reader: &Reader, topic: TopicId) -> Result<&[Bytes], PlaybackError> {
        self.read(reader, [topic])?;
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
        Ok(Some(messages.collect::<Result<_, _>>().map_err(|error| PlaybackError::journal(topic, error))?))
    }
}

/// Returns whether the bag was recorded in simulated time, in which all modules run inside the cycle.
pub(crate) fn was_in_simulated_time(reader: &Reader) -> bool {
    reader.metadata().is_some_and(|metadata| metadata.custom_data.contains_key(SIMULATED_TIME))
}

/// From when on a bag has all messages, in nanoseconds.
fn complete_from(reader: &Reader) -> i64 {
    let noted = reader.metadata().and_then(|metadata| metadata.custom_data.get(RECORDED_FROM)?.parse().ok());
    // Of a recording that was killed it is not known.
    noted.filter(|from| *from != i64::MAX).max(reader.start_time()).unwrap_or(i64::MIN)
}

/// What a bag contains about the cycles.
pub(crate) enum Cycles {
    /// The time of each cycle, up to those in which the robot began to stop if the recording was not
    /// interrupted.
    Recorded {
        /// The number of the first one: not 0 if the recording began while the robot ran, or the bag is a
        /// part of another.
        first: u64,
        times: Arc<[i64]>,
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
        let first = messages.first().map_or(0, |message| Self::begin_in(reader, message));
        for message in messages {
            let expected = first + times.len() as u64;
            if message.first != expected {
                return Err(PlaybackError::CyclesLost { expected, found: message.first });
            }
            times.extend_from_slice(&message.times);
            is_whole = message.is_end;
        }
        // Only some of what happened in these is in the bag.
        let begin = if first > 0 { complete_from(reader) } else { i64::MIN };
        let before = times.iter().take_while(|time| **time < begin).count();
        times.drain(..before);
        let first = first + before as u64;
        let last = times.last().copied().unwrap_or(i64::MIN);
        // In simulated time the robot stopped at the time of the last cycle, else later.
        let has_all_of_last = is_whole && !was_in_simulated_time(reader);
        let end = if has_all_of_last { last.saturating_add(1) } else { last };
        Ok(Self::Recorded { first, times: times.into(), end })
    }

    /// The first cycle that a bag may begin with: that of its first message if cycles before that are older
    /// than the bag, else 0.
    fn begin_in(reader: &Reader, first: &CycleTimes) -> u64 {
        let is_older = first.times.first().is_some_and(|time| *time <= complete_from(reader));
        // No robot has run for so many.
        if is_older && first.first < u64::MAX / 2 { first.first } else { 0 }
    }

    /// The number of the first cycle.
    pub(crate) fn first_number(&self) -> u64 {
        match self {
            Self::Recorded { first, .. } => *first,
            Self::OfMessages | Self::Unknown => 0,
        }
    }

    /// The time up to which messages of modules are not compared, if the bag does not begin with the robot:
    /// they are of inputs before it.
    pub(crate) fn begin(&self) -> Option<i64> {
        self.first().filter(|_| self.first_number() > 0)
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

    /// The time from which messages of modules are not compared. The cycles in which the robot stopped are
    /// not recorded; an interrupted recording may also lack the messages of its last cycle.
    pub(crate) fn end(&self) -> i64 {
        match self {
            Self::Recorded { end, .. } => *end,
            Self::OfMessages | Self::Unknown => i64::MAX,
        }
    }
}

/// Where the cycle of an input is in the recorded run.
#[derive(Clone, Copy)]
pub(crate) struct Moment {
    /// Counts the cycles from 0.
    pub(crate) cycle: u64,
    pub(crate) time: i64,
    /// The last cycle at that time.
    pub(crate) last: u64,
}

/// In which cycles the messages of each topic joined that did not join in the first cycle at their time.
pub(crate) struct MessageCycles(BTreeMap<String, LaterMessages>);

/// Those of one topic, in order: cycle and number of messages.
#[derive(Default)]
pub(crate) struct LaterMessages(VecDeque<(u64, usize)>);

impl MessageCycles {
    /// Reads those of the wanted topics, named without the leading slash; none if the bag lacks them.
    pub(crate) fn read(
        reader: &Reader,
        extract: &mut Extract,
        is_wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, PlaybackError> {
        Self::of(extract.messages(reader, journal::MESSAGES)?.unwrap_or_default(), is_wanted)
    }

    /// Takes those of the wanted topics from the journal.
    pub(crate) fn of(
        messages: Vec<CycleMessages>,
        is_wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, PlaybackError> {
        let mut by_topic = BTreeMap::<String, LaterMessages>::new();
        for message in messages {
            let mut positions = message.positions.iter();
            for (cycle, &size) in (message.first..).zip(&message.sizes) {
                for &position in positions.by_ref().take(size as usize) {
                    let topic = message.topics.get(usize::from(position)).ok_or_else(|| {
                        let count = message.topics.len();
                        PlaybackError::journal(
                            journal::MESSAGES,
                            format!("topic {position} of {count} in cycle {cycle}"),
                        )
                    })?;
                    if is_wanted(topic) {
                        by_topic.entry(topic.clone()).or_default().add(cycle);
                    }
                }
            }
        }
        Ok(Self(by_topic))
    }

    /// The changes of settings, each with the cycle in which it took effect if that was not the last one at
    /// its time.
    pub(crate) fn of_changes(
        mut self,
        changes: Vec<ModuleSettings>,
        time_of: impl Fn(u64) -> Option<i64>,
    ) -> impl Iterator<Item = (ModuleSettings, Option<u64>)> {
        // The journal reports a change in the cycle after it.
        let reported = self.take(journal::SETTINGS).0.into_iter();
        let reported = reported.flat_map(|(cycle, count)| std::iter::repeat_n(cycle.checked_sub(1), count));
        let mut changed = reported.filter_map(move |cycle| Some((time_of(cycle?)?, cycle?))).peekable();
        changes.into_iter().map(move |message| {
            let stamp = message.stamp.as_nanos();
            while changed.next_if(|(time, _)| *time < stamp).is_some() {}
            let cycle = changed.next_if(|(time, _)| *time == stamp).map(|(_, cycle)| cycle);
            (message, cycle)
        })
    }

    pub(crate) fn take(&mut self, topic: &str) -> LaterMessages {
        self.0.remove(topic).unwrap_or_default()
    }
}

impl LaterMessages {
    fn add(&mut self, cycle: u64) {
        match self.0.back_mut() {
            Some((last, count)) if *last == cycle => *count += 1,
            _ => self.0.push_back((cycle, 1)),
        }
    }

    /// How many of the messages that wait join in this cycle: all but those that join in later cycles at the
    /// same time.
    pub(crate) fn due(&mut self, waiting: usize, moment: Moment) -> usize {
        while self.0.front().is_some_and(|(cycle, _)| *cycle <= moment.cycle) {
            self.0.pop_front();
        }
        let later = self.0.iter().take_while(|(cycle, _)| *cycle <= moment.last).map(|(_, count)| count);
        waiting.saturating_sub(later.sum())
    }
}

/// The changes of settings of several modules, in their recorded order.
#[derive(Default)]
pub(crate) struct SettingsChanges(VecDeque<SettingsChange>);

/// A change of a module's settings.
pub(crate) struct SettingsChange {
    /// The cycle in which it took effect, if the bag says so.
    cycle: Option<u64>,
    pub(crate) message: ModuleSettings,
}

impl SettingsChange {
    /// True if it takes effect in this cycle or did so in an earlier one.
    pub(crate) fn is_due(&self, moment: Moment) -> bool {
        let is_due_by_time = || self.message.stamp.as_nanos() <= moment.time;
        self.cycle.map_or_else(is_due_by_time, |cycle| cycle <= moment.cycle)
    }
}

impl SettingsChanges {
    /// Reads the changes of the wanted modules; empty if the bag lacks the topic.
    pub(crate) fn read(
        reader: &Reader,
        extract: &mut Extract,
        cycles: &Cycles,
        is_wanted: impl Fn(&str) -> bool,
    ) -> Result<Self, PlaybackError> {
        let messages = extract.messages::<ModuleSettings>(reader, journal::SETTINGS)?.unwrap_or_default();
        let (first, times): (u64, &[i64]) = match cycles {
            Cycles::Recorded { first, times, .. } => (*first, times),
            Cycles::OfMessages | Cycles::Unknown => (0, &[]),
        };
        let joined = MessageCycles::read(reader, extract, |topic| topic == journal::SETTINGS)?;
        let time_of = |cycle: u64| times.get(usize::try_from(cycle.checked_sub(first)?).ok()?).copied();
        let changes =
            joined.of_changes(messages, time_of).map(|(message, cycle)| SettingsChange { cycle, message });
        Ok(Self(changes.filter(|change| is_wanted(&change.message.module)).collect()))
    }

    /// Applies the changes that are due in the next sync phase of the core.
    pub(crate) fn give(
        &mut self,
        core: &Core,
        is_due: impl Fn(&SettingsChange) -> bool,
    ) -> Result<(), PlaybackError> {
        while self.0.front().is_some_and(&is_due) {
            let Some(SettingsChange { message: change, .. }) = self.0.pop_front() else { break };
            for parameter in change.settings {
                let setting = format!("{}.{}", change.module, parameter.name);
                let value = setting_value(parameter.value).map_err(|problem| {
                    PlaybackError::journal(journal::SETTINGS, format!("{setting}: {problem}"))
                })?;
                // If the module refuses the value, the difference shows in its messages.
                drop(core.handle().set(&change.module, &parameter.name, value));
            }
        }
        Ok(())
    }
}
