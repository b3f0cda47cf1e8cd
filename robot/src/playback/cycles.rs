//! A core whose cycles follow a bag.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::iter::Peekable;

use bytes::Bytes;
use downbeat_bags::{BagMessage, Messages, Reader, Selection, TopicId};
use downbeat_edge::EncodedInlet;
use downbeat_executor::{Clock, Core, ManualClock, Time};

use super::events::Events;
use super::journals::{Cycles, Extract, LaterMessages, MessageCycles, Moment, SettingsChanges};
use super::{MOST_CYCLES, PlaybackError};
use crate::ReplayedTime;
use crate::encoding::RecordedType;

/// A core with its input from a bag.
pub(crate) struct Follower<'a> {
    pub(crate) core: &'a mut Core,
    pub(crate) clock: &'a ManualClock,
    pub(crate) inputs: Inputs,
    pub(crate) settings: SettingsChanges,
    pub(crate) events: Events,
    /// Which versions of modules are in force.
    pub(crate) reached: ReplayedTime,
}

impl Follower<'_> {
    /// Runs the core until the end of the bag, then stops it. If the bag contains the cycle times, cycles run
    /// at exactly these times and each input joins in the cycle in which it was recorded. Otherwise messages
    /// are published at their times: in one cycle per message time if the bag was recorded in a robot, else
    /// with timers that fire at their exact times in between.
    ///
    /// `after_cycle` is called after each cycle and after the end, with the messages of other topics that the
    /// inputs have come upon. Returns the number of cycles in the bag.
    pub(crate) fn run(
        &mut self,
        reader: &Reader,
        cycles: &Cycles,
        mut after_cycle: impl FnMut(Vec<BagMessage>),
    ) -> Result<u64, PlaybackError> {
        let first = cycles.first_number();
        let mut count = first;
        match cycles {
            Cycles::Recorded { times, .. } => {
                if let Some(begin) = cycles.begin() {
                    self.inputs.skip_before(begin)?;
                    self.events.skip_before(first);
                }
                for at_one_time in times.chunk_by(|one, other| one == other) {
                    let last = count + at_one_time.len() as u64 - 1;
                    for &time in at_one_time {
                        let moment = Moment { cycle: count, time, last };
                        self.events.give(self.core, |event| event.cycle <= count)?;
                        self.inputs.give_in(moment)?;
                        self.settings.give(self.core, |change| change.is_due(moment))?;
                        self.cycle(time)?;
                        count += 1;
                        after_cycle(self.inputs.take_others());
                    }
                }
                self.clock.set(Time::from_nanos(cycles.end()));
            }
            Cycles::OfMessages => {
                let mut last = None;
                for message in reader.messages(Selection::all())? {
                    let time = message?.log_time;
                    if last.replace(time) != Some(time) {
                        self.events.give(self.core, |event| event.stamp.as_nanos() <= time)?;
                        self.give(time)?;
                        self.cycle(time)?;
                        count += 1;
                        after_cycle(self.inputs.take_others());
                    }
                }
            }
            Cycles::Unknown => {
                while let Some(time) = self.inputs.next_time()? {
                    self.run_until(Time::from_nanos(time))?;
                    self.give(time)?;
                    after_cycle(self.inputs.take_others());
                }
                self.run_until(Time::from_nanos(reader.end_time().unwrap_or(0)))?;
            }
        }
        self.core.stop();
        after_cycle(self.inputs.take_others());
        Ok(count - first)
    }

    /// Runs a cycle. Its inputs were applied before, so that they join in its sync phase as they did when
    /// they were recorded.
    fn cycle(&mut self, time: i64) -> Result<(), PlaybackError> {
        self.clock.set(Time::from_nanos(time));
        self.reached.set(time);
        Ok(self.core.cycle()?)
    }

    /// Applies all messages and settings up to that time.
    fn give(&mut self, time: i64) -> Result<(), PlaybackError> {
        self.inputs.give(time)?;
        self.settings.give(self.core, |change| change.message.stamp.as_nanos() <= time)
    }

    /// Runs what is due before `end`, then advances the clock to `end`.
    fn run_until(&mut self, end: Time) -> Result<(), PlaybackError> {
        let (mut instant, mut cycles) = (self.clock.now(), 0);
        while let Some(event) =
            self.core.next_event().filter(|&event| event < end || event == self.clock.now())
        {
            self.clock.set(event);
            self.core.cycle()?;
            cycles = if event == instant { cycles + 1 } else { 0 };
            instant = event;
            if cycles > MOST_CYCLES {
                return Err(PlaybackError::Restless(instant));
            }
        }
        self.clock.set(end);
        Ok(())
    }
}

/// Messages of several topics, published in the order of the bag; on the way, messages of other topics are
/// kept for whoever compares them, so that the bag is read once.
pub(crate) struct Inputs {
    topics: BTreeMap<TopicId, Input>,
    messages: Option<Peekable<Messages>>,
    others: Vec<BagMessage>,
    given: u64,
}

/// A topic, and those of its messages whose time has come and that have not joined.
struct Input {
    inlet: EncodedInlet,
    recorded: RecordedType,
    later: LaterMessages,
    waiting: VecDeque<Bytes>,
}

impl Inputs {
    /// Opens these topics, named without the leading slash. Topics that the bag lacks are skipped. `others`
    /// are topics that are only read.
    pub(crate) fn open<'a>(
        core: &mut Core,
        reader: &Reader,
        names: impl IntoIterator<Item = &'a str>,
        others: impl IntoIterator<Item = TopicId>,
        extract: &mut Extract,
    ) -> Result<Self, PlaybackError> {
        let names: Vec<&str> = names.into_iter().collect();
        let mut later = MessageCycles::read(reader, extract, |topic| names.contains(&topic))?;
        let (interfaces, mut topics) = (extract.interfaces(), BTreeMap::new());
        for name in names {
            let Some(id) = reader.topic(&format!("/{name}")) else { continue };
            let recorded = RecordedType::of(&reader.topics()[id.index()], interfaces)?;
            let inlet = interfaces.inlet(core, name, recorded.message_type())?;
            topics.insert(id, Input { inlet, recorded, later: later.take(name), waiting: VecDeque::new() });
        }
        let read: BTreeSet<_> = topics.keys().copied().chain(others).collect();
        let messages = match read.is_empty() {
            true => None,
            false => Some(reader.messages(Selection::all().topics(read))?.peekable()),
        };
        Ok(Self { topics, messages, others: Vec::new(), given: 0 })
    }

    /// The messages of the other topics that were read since the last call.
    fn take_others(&mut self) -> Vec<BagMessage> {
        std::mem::take(&mut self.others)
    }

    /// The messages that were not read.
    pub(crate) fn into_rest(self) -> Option<Peekable<Messages>> {
        self.messages
    }

    /// The time of the next message of an input.
    pub(crate) fn next_time(&mut self) -> Result<Option<i64>, PlaybackError> {
        while let Some(message) = self.peek()? {
            let (topic, time) = (message.topic, message.log_time);
            if self.topics.contains_key(&topic) {
                return Ok(Some(time));
            }
            self.others.extend(self.messages.as_mut().and_then(Iterator::next).transpose()?);
        }
        Ok(None)
    }

    fn peek(&mut self) -> Result<Option<&BagMessage>, PlaybackError> {
        let Some(messages) = &mut self.messages else { return Ok(None) };
        if let Some(Err(error)) = messages.next_if(Result::is_err) {
            return Err(error.into());
        }
        Ok(messages.peek().and_then(|message| message.as_ref().ok()))
    }

    /// Publishes all messages up to that time.
    pub(crate) fn give(&mut self, time: i64) -> Result<(), PlaybackError> {
        self.read(time)?;
        self.publish(|input| input.waiting.len())
    }

    /// Publishes the messages that joined in this cycle.
    fn give_in(&mut self, moment: Moment) -> Result<(), PlaybackError> {
        self.read(moment.time)?;
        self.publish(|input| input.later.due(input.waiting.len(), moment))
    }

    /// Leaves out the messages before that time.
    fn skip_before(&mut self, time: i64) -> Result<(), PlaybackError> {
        self.read(time.saturating_sub(1))?;
        self.topics.values_mut().for_each(|input| input.waiting.clear());
        Ok(())
    }

    /// Reads all messages up to that time.
    fn read(&mut self, time: i64) -> Result<(), PlaybackError> {
        while self.peek()?.is_some_and(|next| next.log_time <= time) {
            let message = self.messages.as_mut().and_then(Iterator::next);
            let Some(message) = message.transpose()? else { break };
            match self.topics.get_mut(&message.topic) {
                Some(input) => input.waiting.push_back(input.recorded.to_cdr(message.data)?),
                None => self.others.push(message),
            }
        }
        Ok(())
    }

    /// Publishes so many of the messages that wait.
    fn publish(&mut self, count: impl Fn(&mut Input) -> usize) -> Result<(), PlaybackError> {
        for input in self.topics.values_mut().filter(|input| !input.waiting.is_empty()) {
            let due = count(input);
            for message in input.waiting.drain(..due) {
                input.inlet.publish_shared(&message)?;
                self.given += 1;
            }
        }
        Ok(())
    }

    /// Number of published messages.
    pub(crate) fn given(&self) -> u64 {
        self.given
    }
}
