//! A core whose cycles follow a bag.

use std::collections::BTreeMap;
use std::iter::Peekable;

use downbeat_bags::{Messages, Reader, Selection, TopicId};
use downbeat_edge::{EncodedInlet, Interfaces};
use downbeat_executor::{Clock, Core, ManualClock, Time};

use super::account::{Cycles, SettingsChanges};
use super::events::Events;
use super::{MOST_CYCLES, PlaybackError};
use crate::encoding::RecordedType;

/// A core with its input from a bag.
pub(crate) struct Follower<'a> {
    pub(crate) core: &'a mut Core,
    pub(crate) clock: &'a ManualClock,
    pub(crate) inputs: Inputs,
    pub(crate) settings: SettingsChanges,
    pub(crate) events: Events,
}

impl Follower<'_> {
    /// Runs the core until the end of the bag, then stops it. If the bag contains the cycle times, cycles run
    /// at exactly these times and each input joins in the cycle in which it was recorded. Otherwise messages
    /// are published at their times: in one cycle per message time if the bag was recorded in a robot, else
    /// with timers that fire at their exact times in between.
    ///
    /// `after_cycle` is called after each cycle and after the end. Returns the number of cycles in the bag.
    pub(crate) fn run(
        &mut self,
        reader: &Reader,
        cycles: &Cycles,
        mut after_cycle: impl FnMut(),
    ) -> Result<u64, PlaybackError> {
        let mut count = 0;
        match cycles {
            Cycles::Recorded { times, .. } => {
                for (number, &time) in (0..).zip(times) {
                    self.events.give(self.core, |event| event.cycle <= number)?;
                    self.cycle(time)?;
                    count += 1;
                    after_cycle();
                }
                self.clock.set(Time::from_nanos(cycles.end()));
            }
            Cycles::OfMessages => {
                let mut last = None;
                for message in reader.messages(Selection::all())? {
                    let time = message?.log_time;
                    if last.replace(time) != Some(time) {
                        self.events.give(self.core, |event| event.stamp.as_nanos() <= time)?;
                        self.cycle(time)?;
                        count += 1;
                        after_cycle();
                    }
                }
            }
            Cycles::Unknown => {
                while let Some(time) = self.inputs.next_time()? {
                    self.run_until(Time::from_nanos(time))?;
                    self.give(time)?;
                    after_cycle();
                }
                self.run_until(Time::from_nanos(reader.end_time().unwrap_or(0)))?;
            }
        }
        self.core.stop();
        after_cycle();
        Ok(count)
    }

    /// Applies the inputs of a cycle before it runs, so that they join in its sync phase as they did when
    /// they were recorded.
    fn cycle(&mut self, time: i64) -> Result<(), PlaybackError> {
        self.give(time)?;
        self.clock.set(Time::from_nanos(time));
        Ok(self.core.cycle()?)
    }

    /// Applies all messages and settings up to that time.
    fn give(&mut self, time: i64) -> Result<(), PlaybackError> {
        self.inputs.give(time)?;
        self.settings.give(self.core, |change| change.stamp.as_nanos() <= time)
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

/// Messages of several topics, published in the order of the bag.
pub(crate) struct Inputs {
    inlets: BTreeMap<TopicId, (EncodedInlet, RecordedType)>,
    messages: Option<Peekable<Messages>>,
    given: u64,
}

impl Inputs {
    /// Opens these topics, named without the leading slash. Topics that the bag lacks are skipped.
    pub(crate) fn open<'a>(
        core: &mut Core,
        reader: &Reader,
        topics: impl IntoIterator<Item = &'a str>,
        interfaces: &Interfaces,
    ) -> Result<Self, PlaybackError> {
        let mut inlets = BTreeMap::new();
        for name in topics {
            let Some(id) = reader.topic(&format!("/{name}")) else { continue };
            let recorded = RecordedType::of(&reader.topics()[id.index()], interfaces)?;
            inlets.insert(id, (interfaces.inlet(core, name, recorded.message_type())?, recorded));
        }
        if inlets.is_empty() {
            return Ok(Self { inlets, messages: None, given: 0 });
        }
        let messages = reader.messages(Selection::all().topics(inlets.keys().copied()))?;
        Ok(Self { inlets, messages: Some(messages.peekable()), given: 0 })
    }

    pub(crate) fn next_time(&mut self) -> Result<Option<i64>, PlaybackError> {
        let Some(messages) = &mut self.messages else { return Ok(None) };
        if let Some(Err(error)) = messages.next_if(Result::is_err) {
            return Err(error.into());
        }
        Ok(messages.peek().and_then(|message| message.as_ref().ok()).map(|message| message.log_time))
    }

    /// Publishes all messages up to that time.
    pub(crate) fn give(&mut self, time: i64) -> Result<(), PlaybackError> {
        while self.next_time()?.is_some_and(|next| next <= time) {
            let message = self.messages.as_mut().and_then(Iterator::next);
            let Some(message) = message.transpose()? else { break };
            if let Some((inlet, recorded)) = self.inlets.get(&message.topic) {
                inlet.publish(&recorded.to_cdr(message.data)?)?;
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
