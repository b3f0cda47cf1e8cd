//! Replay of the modules inside the cycle, together, in the recorded cycles.

use std::collections::BTreeMap;
use std::iter::Peekable;

use downbeat_bags::{Messages, Reader, Selection, TopicId};
use downbeat_bridge::edge::{EncodedInlet, Interfaces};
use downbeat_executor::{Core, ManualClock, Time};

use super::ReplayError;
use super::captured::Captured;
use super::comparison::Comparisons;
use super::cycles::Cycles;
use super::plan::Plan;
use crate::encoding::RecordedType;
use crate::playback::settings::SettingsChanges;
use crate::playback::{Extract, run_until};
use crate::robot::RobotFile;

/// Returns how many cycles there were.
pub(super) fn replay(
    file: &RobotFile,
    reader: &Reader,
    plan: &Plan,
    extract: &mut Extract,
    comparisons: &mut Comparisons,
) -> Result<u64, ReplayError> {
    let start = match &plan.cycles {
        Cycles::Recorded { times, .. } => times.first().copied(),
        Cycles::OfMessages | Cycles::Unknown => reader.start_time(),
    };
    let clock = ManualClock::new(Time::from_nanos(start.unwrap_or(0)));
    let mut core = file.launch(Core::new().with_clock(clock.clone()))?;
    core = build(file, reader, extract, core, |module| plan.attached.iter().any(|name| name == module))?;
    let captured =
        Captured::add(&mut core, &file.catalog.interfaces, |topic| plan.outputs.contains_key(topic))?;
    let inputs = Inputs::open(&mut core, reader, plan, &file.catalog.interfaces)?;
    let is_replayed = |module: &str| plan.attached.iter().any(|name| name == module);
    let settings = SettingsChanges::read::<ReplayError>(reader, extract, is_replayed)?;
    let mut run = Run { core, clock, captured, inputs, settings, comparisons, cycles: 0 };
    match &plan.cycles {
        Cycles::Recorded { times, is_whole } => {
            times.iter().try_for_each(|&time| run.cycle(time))?;
            let last = times.last().copied().unwrap_or(i64::MIN);
            // While the robot stopped there were more, at times that no bag tells. Of a recording that was interrupted
            // the bag may lack what the last cycle published, too.
            let end = if *is_whole { last.saturating_add(1) } else { last };
            run.stop_before(end);
            run.comparisons.end_before(end);
        }
        Cycles::OfMessages => {
            let mut last = None;
            for message in reader.messages(Selection::all())? {
                let time = message?.log_time;
                if last.replace(time) != Some(time) {
                    run.cycle(time)?;
                }
            }
            run.stop();
        }
        Cycles::Unknown => {
            while let Some(time) = run.inputs.next_time()? {
                run_until(&mut run.core, &run.clock, Time::from_nanos(time))?;
                run.give(time)?;
            }
            let end = Time::from_nanos(reader.end_time().unwrap_or(0));
            run_until(&mut run.core, &run.clock, end)?;
            run.stop();
        }
    }
    Ok(run.cycles)
}

/// Adds the modules that are wanted to a core; those that drive a device with its recorded answers.
pub(super) fn build(
    file: &RobotFile,
    reader: &Reader,
    extract: &mut Extract,
    core: Core,
    is_wanted: impl Fn(&str) -> bool,
) -> Result<Core, ReplayError> {
    let mut problem = None;
    let built = file.build_modules(core, |module, core| {
        if !is_wanted(&module.name) {
            return Some(Ok(()));
        }
        let replayed = module.kind.replayed()?;
        let options = module.options();
        let answers = reader.topic(&replayed.topic_of(&options)).map(|id| extract.of(reader, id));
        match answers.unwrap_or(Ok(&[])) {
            Ok(answers) => match replayed.add_to(core, &module.name, options, answers) {
                Ok(added) => Some(added),
                Err(error) => {
                    problem = Some(ReplayError::Device { module: module.name.clone(), problem: error });
                    Some(Ok(()))
                }
            },
            Err(error) => {
                problem = Some(error);
                Some(Ok(()))
            }
        }
    });
    problem.map_or_else(|| Ok(built?), Err)
}

struct Run<'a> {
    core: Core,
    clock: ManualClock,
    captured: Captured,
    inputs: Inputs,
    settings: SettingsChanges,
    comparisons: &'a mut Comparisons,
    cycles: u64,
}

impl Run<'_> {
    /// What is given before a cycle joins in its sync phase, as it did when it was recorded.
    fn cycle(&mut self, time: i64) -> Result<(), ReplayError> {
        self.give(time)?;
        self.clock.set(Time::from_nanos(time));
        self.core.cycle()?;
        self.cycles += 1;
        self.collect();
        Ok(())
    }

    /// Gives all messages and settings up to that time.
    fn give(&mut self, time: i64) -> Result<(), ReplayError> {
        self.inputs.give(time)?;
        Ok(self.settings.give(&self.core, |change| change.stamp.as_nanos() <= time)?)
    }

    fn stop(&mut self) {
        self.core.stop();
        self.collect();
    }

    /// Without what the modules publish from `end` on.
    fn stop_before(&mut self, end: i64) {
        self.clock.set(Time::from_nanos(end));
        self.core.stop();
        let before = self.captured.take().into_iter().filter(|replayed| replayed.time < end);
        before.for_each(|replayed| self.comparisons.replayed(replayed));
    }

    fn collect(&mut self) {
        for replayed in self.captured.take() {
            self.comparisons.replayed(replayed);
        }
    }
}

/// What the modules receive from the bag.
struct Inputs {
    inlets: BTreeMap<TopicId, (EncodedInlet, RecordedType)>,
    messages: Option<Peekable<Messages>>,
}

impl Inputs {
    fn open(
        core: &mut Core,
        reader: &Reader,
        plan: &Plan,
        interfaces: &Interfaces,
    ) -> Result<Self, ReplayError> {
        let mut inlets = BTreeMap::new();
        for name in &plan.inputs {
            let Some(id) = reader.topic(&format!("/{name}")) else { continue };
            let recorded = RecordedType::of(&reader.topics()[id.index()], interfaces)?;
            inlets.insert(id, (interfaces.inlet(core, name, recorded.message_type())?, recorded));
        }
        if inlets.is_empty() {
            return Ok(Self { inlets, messages: None });
        }
        let messages = reader.messages(Selection::all().topics(inlets.keys().copied()))?;
        Ok(Self { inlets, messages: Some(messages.peekable()) })
    }

    fn next_time(&mut self) -> Result<Option<i64>, ReplayError> {
        let Some(messages) = &mut self.messages else { return Ok(None) };
        if let Some(Err(error)) = messages.next_if(Result::is_err) {
            return Err(error.into());
        }
        Ok(messages.peek().and_then(|message| message.as_ref().ok()).map(|message| message.log_time))
    }

    /// Gives all messages up to that time.
    fn give(&mut self, time: i64) -> Result<(), ReplayError> {
        while self.next_time()?.is_some_and(|next| next <= time) {
            let message = self.messages.as_mut().and_then(Iterator::next);
            let Some(message) = message.transpose()? else { break };
            if let Some((inlet, recorded)) = self.inlets.get(&message.topic) {
                inlet.publish(&recorded.to_cdr(message.data)?)?;
            }
        }
        Ok(())
    }
}
