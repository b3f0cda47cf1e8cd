//! Replay of a detached module from its recorded runs.

use std::collections::{BTreeMap, VecDeque};

use bytes::Bytes;
use downbeat_bags::Reader;
use downbeat_edge::{EncodedInlet, EncodedInletError, Interfaces};
use downbeat_executor::{Core, ManualClock, Time};
use downbeat_msgs::downbeat_interfaces::msg::ModuleStep;

use super::PlaybackError;
use super::events::{Events, WiredServices};
use super::journals::{Cycles, Extract, SettingsChanges};
use crate::encoding::RecordedType;
use crate::journal;
use crate::{ReplayedTime, reloads_of};

/// The replayed runs of a detached module.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReplayedSteps {
    /// Number of runs.
    pub count: usize,
    /// True if the runs include the end of the module. Otherwise the recording was interrupted.
    pub is_whole: bool,
    /// The time of the last run.
    pub last: Time,
}

/// Runs a core that contains the module once for each of its runs in the bag, at the recorded times and with
/// the messages that each run received.
///
/// `clock` is the clock of the core and must be at or before the time of the first run. Other modules of the
/// core may subscribe, but must not publish what the module receives.
///
/// # Errors
/// Returns an error if the bag lacks the runs or what the module received in them.
pub fn replay_module(
    core: &mut Core,
    clock: &ManualClock,
    reader: &Reader,
    module: &str,
    interfaces: &Interfaces,
) -> Result<ReplayedSteps, PlaybackError> {
    let reached = ReplayedTime::default();
    replay_steps(core, clock, reader, &mut Extract::new(interfaces), module, &reached, None)
}

/// Like [`replay_module`], with what has already been read from the bag.
pub(crate) fn replay_steps(
    core: &mut Core,
    clock: &ManualClock,
    reader: &Reader,
    extract: &mut Extract,
    module: &str,
    reached: &ReplayedTime,
    services: Option<WiredServices<'_>>,
) -> Result<ReplayedSteps, PlaybackError> {
    let mut follower = StepFollower::new(core, clock, reader, extract, module, reached, services)?;
    while follower.step(core)? {}
    // Delivers what the last run published to the subscribers.
    core.stop();
    Ok(follower.done())
}

/// What a core with one detached module does with a bag, run by run.
pub(crate) struct StepFollower {
    module: String,
    clock: ManualClock,
    steps: Vec<Lived>,
    /// The position of the next run.
    next: usize,
    inputs: Inputs,
    settings: SettingsChanges,
    events: Events,
    reached: ReplayedTime,
}

impl StepFollower {
    pub(crate) fn new(
        core: &mut Core,
        clock: &ManualClock,
        reader: &Reader,
        extract: &mut Extract,
        module: &str,
        reached: &ReplayedTime,
        services: Option<WiredServices<'_>>,
    ) -> Result<Self, PlaybackError> {
        let steps = steps_of(module, reader, extract)?;
        let inputs = Inputs::open(core, reader, extract, &steps)?;
        let settings = SettingsChanges::read(reader, extract, &Cycles::Unknown, |name| name == module)?;
        let recorded = extract.messages(reader, journal::EVENTS)?;
        let events = Events::of_detached(core, recorded.as_deref(), extract.interfaces(), module, services)?;
        let (module, clock, reached) = (module.to_owned(), clock.clone(), reached.clone());
        Ok(Self { module, clock, steps, next: 0, inputs, settings, events, reached })
    }

    /// The next run; `None` after the last one.
    pub(crate) fn next(&self) -> Option<&ModuleStep> {
        self.steps.get(self.next).map(|lived| &lived.step)
    }

    /// Makes the next run. Returns false if there is none.
    pub(crate) fn step(&mut self, core: &mut Core) -> Result<bool, PlaybackError> {
        let Some(Lived { step, .. }) = self.steps.get(self.next) else { return Ok(false) };
        self.next += 1;
        self.reached.set(step.stamp.as_nanos());
        // A message or setting that is applied before a cycle joins in its sync phase and is received in the
        // next one.
        if let Some(Lived { step: next, passed_by }) = self.steps.get(self.next) {
            passed_by.iter().try_for_each(|step| self.inputs.pass_by(step))?;
            self.inputs.give(next)?;
            if next.step == 0 {
                // If the module has replaced itself, it is refused.
                drop(core.handle().restart(&self.module));
                self.reached.set(next.stamp.as_nanos());
            }
            // The run counter restarts when the module is restarted.
            let run = (next.stamp.as_nanos(), next.step);
            self.settings
                .give(core, |change| (change.message.stamp.as_nanos(), change.message.step) <= run)?;
            self.events.take(core, next.step)?;
        }
        self.clock.set(Time::from_nanos(step.stamp.as_nanos()));
        if step.is_stop {
            core.stop();
        } else {
            core.cycle()?;
        }
        Ok(true)
    }

    fn done(&self) -> ReplayedSteps {
        let (is_whole, last) = self.steps.last().map_or((false, Time::ZERO), |last| {
            (last.step.is_stop, Time::from_nanos(last.step.stamp.as_nanos()))
        });
        ReplayedSteps { count: self.steps.len(), is_whole, last }
    }
}

/// The time of the first run of a module, in nanoseconds of the robot's time.
pub(crate) fn first_step(
    reader: &Reader,
    extract: &mut Extract,
    module: &str,
) -> Result<Option<i64>, PlaybackError> {
    let steps = extract.messages::<ModuleStep>(reader, journal::STEPS)?.unwrap_or_default();
    Ok(steps.iter().find(|step| step.module == module).map(|step| step.stamp.as_nanos()))
}

/// A run of the module, and those of the life before that ended after it began: a module that was replaced
/// takes what had come to it, and does nothing with it.
struct Lived {
    step: ModuleStep,
    passed_by: Vec<ModuleStep>,
}

fn steps_of(module: &str, reader: &Reader, extract: &mut Extract) -> Result<Vec<Lived>, PlaybackError> {
    let steps = extract.messages::<ModuleStep>(reader, journal::STEPS)?.unwrap_or_default();
    let steps: Vec<_> = steps.into_iter().filter(|step| step.module == module).collect();
    match steps.first() {
        None => Err(PlaybackError::NoSteps(module.into())),
        Some(first) if first.step != 0 || !first.topics.is_empty() => Err(PlaybackError::NotFromStart),
        Some(_) => {
            let events = extract.messages(reader, journal::EVENTS)?.unwrap_or_default();
            Ok(lives_of(steps, &reloads_of(module, &events)))
        }
    }
}

/// Leaves out the ends of all lives but the last. `reloads` are the times of the runs in which the module
/// replaced itself.
fn lives_of(steps: Vec<ModuleStep>, reloads: &[i64]) -> Vec<Lived> {
    let (mut lived, mut passed_by) = (Vec::<Lived>::new(), Vec::new());
    let last = steps.len().saturating_sub(1);
    // `None` after the module has replaced itself.
    let mut expected = Some(0);
    for (position, step) in steps.into_iter().enumerate() {
        let is_of_life = step.step == 0 || Some(step.step) == expected;
        if !is_of_life || (step.is_stop && position != last) {
            passed_by.push(step);
            continue;
        }
        let is_replaced = reloads.contains(&step.stamp.as_nanos());
        expected = (!is_replaced).then_some(step.step + 1);
        lived.push(Lived { step, passed_by: std::mem::take(&mut passed_by) });
    }
    lived
}

/// The messages that the module received, by topic, in the order of the bag.
struct Inputs {
    topics: BTreeMap<String, (EncodedInlet, VecDeque<Bytes>)>,
}

impl Inputs {
    fn open(
        core: &mut Core,
        reader: &Reader,
        extract: &mut Extract,
        steps: &[Lived],
    ) -> Result<Self, PlaybackError> {
        let mut topics = BTreeMap::new();
        let all = steps.iter().flat_map(|lived| lived.passed_by.iter().chain([&lived.step]));
        for (step, name) in all.flat_map(|step| step.topics.iter().map(move |name| (step, name))) {
            if topics.contains_key(name) {
                continue;
            }
            let missing = || PlaybackError::MissingInput { step: step.step, topic: name.clone() };
            let id = reader.topic(&format!("/{name}")).ok_or_else(missing)?;
            let recorded = RecordedType::of(&reader.topics()[id.index()], extract.interfaces())?;
            let inlet = extract.interfaces().inlet(core, name, recorded.message_type())?;
            let messages = extract.of(reader, id)?;
            topics.insert(name.clone(), (inlet, messages.iter().cloned().collect()));
        }
        Ok(Self { topics })
    }

    fn give(&mut self, step: &ModuleStep) -> Result<(), PlaybackError> {
        self.take(step, |inlet, message| inlet.publish_shared(message))
    }

    /// Drops what a run received.
    fn pass_by(&mut self, step: &ModuleStep) -> Result<(), PlaybackError> {
        self.take(step, |_, _| Ok(()))
    }

    fn take(
        &mut self,
        step: &ModuleStep,
        give: impl Fn(&EncodedInlet, &Bytes) -> Result<(), EncodedInletError>,
    ) -> Result<(), PlaybackError> {
        let counts = step.skipped.iter().zip(&step.counts);
        for (name, (&skipped, &count)) in step.topics.iter().zip(counts) {
            let missing = || PlaybackError::MissingInput { step: step.step, topic: name.clone() };
            let (inlet, messages) = self.topics.get_mut(name).ok_or_else(missing)?;
            for position in 0..skipped + count {
                let message = messages.pop_front().ok_or_else(missing)?;
                if position >= skipped {
                    give(inlet, &message)?;
                }
            }
        }
        Ok(())
    }
}
