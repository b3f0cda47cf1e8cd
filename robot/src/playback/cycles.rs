//! A core whose cycles follow a bag.

use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::iter::Peekable;
use std::sync::Arc;

use bytes::Bytes;
use downbeat_bags::{BagMessage, Messages, Reader, Selection, TopicId};
use downbeat_edge::EncodedInlet;
use downbeat_executor::{Clock, Core, ManualClock, Time};

use super::events::Events;
use super::journals::{Cycles, Extract, LaterMessages, MessageCycles, Moment, SettingsChanges};
use super::{MOST_CYCLES, PlaybackError};
use crate::ReplayedTime;
use crate::encoding::RecordedType;

/// What a core does with a bag, cycle by cycle.
pub(crate) struct Follower {
    pub(crate) clock: ManualClock,
    pub(crate) inputs: Inputs,
    pub(crate) settings: SettingsChanges,
    pub(crate) events: Events,
    /// Which versions of modules are in force.
    pub(crate) reached: ReplayedTime,
    course: Course,
}

/// What is left of the cycles.
enum Course {
    /// At exactly these times.
    Recorded {
        times: Arc<[i64]>,
        /// The number of the first cycle.
        first: u64,
        /// Where the next one is in `times`.
        next: usize,
        /// See [`Cycles::end`].
        end: i64,
    },
    /// One at the time of each message.
    OfMessages {
        messages: Messages,
        last: Option<i64>,
    },
    /// Whenever something is due.
    Unknown {
        /// The time of the next message, or of the end of the bag, if it is known.
        target: Option<i64>,
        /// Of the bag.
        end: i64,
        is_last: bool,
        /// The last cycle, and how many there were at its time.
        instant: Time,
        cycles: u32,
    },
    Over,
}

impl Follower {
    /// If the bag contains the cycle times, cycles run at exactly these times and each input joins in the
    /// cycle in which it was recorded. Otherwise messages are published at their times: in one cycle per
    /// message time if the bag was recorded in a robot, else with timers that fire at their exact times in
    /// between.
    pub(crate) fn new(
        reader: &Reader,
        cycles: &Cycles,
        clock: ManualClock,
        mut inputs: Inputs,
        settings: SettingsChanges,
        mut events: Events,
        reached: ReplayedTime,
    ) -> Result<Self, PlaybackError> {
        if let Some(begin) = cycles.begin() {
            inputs.skip_before(begin)?;
            events.skip_before(cycles.first_number());
        }
        let course = match cycles {
            Cycles::Recorded { times, first, end } => {
                Course::Recorded { times: Arc::clone(times), first: *first, next: 0, end: *end }
            }
            Cycles::OfMessages => {
                Course::OfMessages { messages: reader.messages(Selection::all())?, last: None }
            }
            Cycles::Unknown => {
                let (end, instant) = (reader.end_time().unwrap_or(0), clock.now());
                Course::Unknown { target: None, end, is_last: false, instant, cycles: 0 }
            }
        };
        Ok(Self { clock, inputs, settings, events, reached, course })
    }

    /// Runs the core until the end of the bag, then stops it.
    ///
    /// `after_cycle` is called after each cycle and after the end, with the messages of other topics that the
    /// inputs have come upon. Returns the number of cycles.
    pub(crate) fn run(
        &mut self,
        core: &mut Core,
        mut after_cycle: impl FnMut(Vec<BagMessage>),
    ) -> Result<u64, PlaybackError> {
        let mut count = 0;
        while self.step(core)? {
            count += 1;
            after_cycle(self.inputs.take_others());
        }
        core.stop();
        after_cycle(self.inputs.take_others());
        Ok(count)
    }

    /// Runs the next cycle. Returns false, with the clock at its end, if there is none.
    pub(crate) fn step(&mut self, core: &mut Core) -> Result<bool, PlaybackError> {
        match &mut self.course {
            Course::Recorded { times, first, next, end } => {
                let Some(&time) = times.get(*next) else {
                    self.clock.set(Time::from_nanos(*end));
                    self.course = Course::Over;
                    return Ok(false);
                };
                let cycle = *first + *next as u64;
                let later = times.iter().skip(*next + 1).take_while(|later| **later == time).count();
                *next += 1;
                let moment = Moment { cycle, time, last: cycle + later as u64 };
                self.events.give(core, |event| event.cycle <= cycle)?;
                self.inputs.give_in(moment)?;
                self.settings.give(core, |change| change.is_due(moment))?;
                self.cycle(core, time)?;
                Ok(true)
            }
            Course::OfMessages { messages, last } => {
                for message in messages.by_ref() {
                    let time = message?.log_time;
                    if last.replace(time) != Some(time) {
                        self.events.give(core, |event| event.stamp.as_nanos() <= time)?;
                        self.give(core, time)?;
                        self.cycle(core, time)?;
                        return Ok(true);
                    }
                }
                self.course = Course::Over;
                Ok(false)
            }
            Course::Unknown { .. } => self.step_to_what_is_due(core),
            Course::Over => Ok(false),
        }
    }

    /// Runs a cycle. Its inputs were applied before, so that they join in its sync phase as they did when
    /// they were recorded.
    fn cycle(&mut self, core: &mut Core, time: i64) -> Result<(), PlaybackError> {
        self.clock.set(Time::from_nanos(time));
        self.reached.set(time);
        Ok(core.cycle()?)
    }

    /// Applies all messages and settings up to that time.
    fn give(&mut self, core: &Core, time: i64) -> Result<(), PlaybackError> {
        self.inputs.give(time)?;
        self.settings.give(core, |change| change.message.stamp.as_nanos() <= time)
    }

    /// Runs the next cycle that is due by itself, before the next message or with it.
    fn step_to_what_is_due(&mut self, core: &mut Core) -> Result<bool, PlaybackError> {
        loop {
            let Course::Unknown { target, end, is_last, instant, cycles } = &mut self.course else {
                return Ok(false);
            };
            let goal = match *target {
                Some(goal) => goal,
                None => {
                    let next = self.inputs.next_time()?;
                    *is_last = next.is_none();
                    *target.insert(next.unwrap_or(*end))
                }
            };
            let (now, goal_time) = (self.clock.now(), Time::from_nanos(goal));
            if let Some(event) = core.next_event().filter(|&event| event < goal_time || event == now) {
                self.clock.set(event);
                *cycles = if event == *instant { *cycles + 1 } else { 0 };
                *instant = event;
                if *cycles > MOST_CYCLES {
                    return Err(PlaybackError::Restless(event));
                }
                core.cycle()?;
                return Ok(true);
            }
            self.clock.set(goal_time);
            *target = None;
            if *is_last {
                self.course = Course::Over;
                return Ok(false);
            }
            self.give(core, goal)?;
        }
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
    pub(crate) fn take_others(&mut self) -> Vec<BagMessage> {
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
