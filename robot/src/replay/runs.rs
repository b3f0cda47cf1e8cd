//! The runs of a replay and what the modules publish in them.

use std::sync::Arc;

use bytes::Bytes;
use downbeat_bags::Reader;
use downbeat_edge::{CoreAccess, KnownType};
use downbeat_executor::{
    self as executor, Core, CycleRuns, Inbox, ManualClock, OutletInbox, Received, SetupError, Time,
};
use downbeat_msgs::downbeat_interfaces::msg::ModuleEvent;
use parking_lot::Mutex;

use super::ReplayError;
use super::calls::Calls;
use super::comparison::{Comparisons, Replayed};
use super::plan::Plan;
use crate::RobotFile;
use crate::journal;
use crate::playback::cycles::{Follower, Inputs};
use crate::playback::events::Events;
use crate::playback::journals::{Extract, SettingsChanges};
use crate::playback::{first_step, replay_steps};

/// Replays the modules inside the cycle together, in the recorded cycles. Returns the number of cycles.
pub(super) fn attached(
    file: &RobotFile,
    reader: &Reader,
    plan: &Plan,
    extract: &mut Extract,
    comparisons: &mut Comparisons,
    calls: &mut Calls,
) -> Result<u64, ReplayError> {
    let start = plan.cycles.first().or(reader.start_time()).unwrap_or(0);
    let clock = ManualClock::new(Time::from_nanos(start));
    plan.reached.reset();
    let mut core = file.launch(Core::new().with_clock(clock.clone()))?;
    let is_replayed = |module: &str| plan.attached.iter().any(|name| name == module);
    core = build(file, reader, plan, extract, core, is_replayed)?;
    let interfaces = &file.catalog.interfaces;
    let captured = Captured::add(&mut core, plan.published_by(is_replayed))?;
    let names = plan.inputs.iter().map(String::as_str);
    let inputs = Inputs::open(&mut core, reader, names, comparisons.fed_topics(), extract)?;
    let settings = SettingsChanges::read(reader, extract, &plan.cycles, is_replayed)?;
    let end = plan.cycles.end();
    let recorded = extract.messages(reader, journal::EVENTS)?;
    let events = Events::of_core(&mut core, recorded.as_deref(), interfaces, Some(plan.services()))?;
    let reached = plan.reached.clone();
    let mut follower = Follower::new(reader, &plan.cycles, clock, inputs, settings, events, reached)?;
    let cycles = follower.run(&mut core, |recorded| {
        recorded.into_iter().for_each(|message| comparisons.recorded(message));
        let before_end = captured.take().into_iter().filter(|replayed| replayed.time < end);
        before_end.for_each(|replayed| comparisons.replayed(replayed));
    })?;
    comparisons.read_from(follower.inputs.into_rest());
    captured.take_events().iter().for_each(|event| calls.replayed(plan, event, is_replayed));
    comparisons.end_before(end);
    Ok(cycles)
}

/// Replays a detached module from its recorded runs. Returns the number of runs.
pub(super) fn detached(
    file: &RobotFile,
    reader: &Reader,
    plan: &Plan,
    extract: &mut Extract,
    name: &str,
    comparisons: &mut Comparisons,
    calls: &mut Calls,
) -> Result<usize, ReplayError> {
    let clock = ManualClock::new(Time::ZERO);
    // Its first version that could be made, if it joined later.
    plan.reached.set(first_step(reader, extract, name)?.unwrap_or(i64::MIN));
    let core = Core::new().with_clock(clock.clone());
    let mut core = build(file, reader, plan, extract, core, |module| module == name)?;
    let captured = Captured::add(&mut core, plan.published_by(|module| module == name))?;
    let steps = replay_steps(&mut core, &clock, reader, extract, name, &plan.reached, Some(plan.services()));
    let steps =
        steps.map_err(|source| ReplayError::Steps { module: name.to_owned(), source: Box::new(source) })?;
    if !steps.is_whole {
        comparisons.interrupted(name);
        calls.interrupted(name);
    }
    // If the end was not recorded, what it publishes, at the time of the last run, is not in the bag.
    let is_recorded = |time: i64| steps.is_whole || time < steps.last.as_nanos();
    for replayed in captured.take() {
        if is_recorded(replayed.time) {
            comparisons.replayed(replayed);
        }
    }
    captured.take_events().iter().for_each(|event| calls.replayed(plan, event, |module| module == name));
    Ok(steps.count)
}

/// Adds the wanted modules to a core. Modules that drive a device get its recorded answers, unless the device
/// is simulated again.
pub(super) fn build(
    file: &RobotFile,
    reader: &Reader,
    plan: &Plan,
    extract: &mut Extract,
    core: Core,
    is_wanted: impl Fn(&str) -> bool,
) -> Result<Core, ReplayError> {
    let (mut problem, interfaces) = (None, &file.catalog.interfaces);
    let built = file.build_modules(core, |module, core| {
        if !is_wanted(&module.name) {
            return Some(Ok(()));
        }
        if plan.runs_live(module) {
            return None;
        }
        let replayed = module.kind.replayed()?;
        let options = module.options();
        let answers = reader.topic(&replayed.topic_of(&options)).map(|id| extract.of(reader, id));
        match answers.unwrap_or(Ok(&[])) {
            Ok(answers) => match replayed.add_to(core, &module.name, options, answers, interfaces) {
                Ok(added) => Some(added),
                Err(error) => {
                    problem = Some(ReplayError::Device { module: module.name.clone(), problem: error });
                    Some(Ok(()))
                }
            },
            Err(error) => {
                problem = Some(error.into());
                Some(Ok(()))
            }
        }
    });
    problem.map_or_else(|| Ok(built?), Err)
}

/// The captured messages that have not been taken yet.
#[derive(Clone, Default)]
pub(super) struct Captured(Arc<Mutex<Contents>>);

#[derive(Default)]
struct Contents {
    messages: Vec<Replayed>,
    events: Vec<ModuleEvent>,
    /// How many events that were not published yet [`Captured::take_events_of`] has taken.
    early: usize,
    runs: Option<Arc<CycleRuns>>,
}

impl Captured {
    /// Captures the messages of these topics, which may come to be later, and the events of modules.
    pub(super) fn add(
        core: &mut Core,
        topics: impl IntoIterator<Item = (Arc<str>, KnownType)>,
    ) -> Result<Self, SetupError> {
        let captured = Self::default();
        let inbox = OutletInbox::new("replay", Inbox::KeepAll);
        for (topic, message_type) in topics {
            let (captured, name) = (captured.clone(), Arc::clone(&topic));
            let sink = move |time: Time, cdr: Bytes| {
                let replayed = Replayed { topic: Arc::clone(&name), time: time.as_nanos(), cdr };
                captured.0.lock().messages.push(replayed);
            };
            message_type.outlet(&mut CoreAccess::Idle(core), &topic, &inbox, sink)?.keep();
        }
        let events = captured.clone();
        let note = move |event: Received<'_, executor::ModuleEvent>| {
            events.0.lock().events.push(journal::events::message(&event));
        };
        core.outlet(executor::ModuleEvent::TOPIC, &inbox, note)?.keep();
        Ok(captured)
    }

    pub(super) fn take(&self) -> Vec<Replayed> {
        std::mem::take(&mut self.0.lock().messages)
    }

    /// Captures the runs of each cycle, too.
    pub(super) fn add_runs(&self, core: &mut Core) -> Result<(), SetupError> {
        let captured = self.clone();
        let note = move |runs: Received<'_, Arc<CycleRuns>>| {
            captured.0.lock().runs = Some(Arc::clone(&runs));
        };
        core.outlet(CycleRuns::TOPIC, Inbox::KeepAll, note)?.keep();
        Ok(())
    }

    /// The runs of the last cycle.
    pub(super) fn take_runs(&self) -> Option<Arc<CycleRuns>> {
        self.0.lock().runs.take()
    }

    pub(super) fn take_events(&self) -> Vec<ModuleEvent> {
        std::mem::take(&mut self.0.lock().events)
    }

    /// The events up to the end of the last cycle of the core; the core publishes some of them only in the
    /// next cycle.
    pub(super) fn take_events_of(&self, core: &Core) -> Vec<ModuleEvent> {
        let mut contents = self.0.lock();
        let waiting = core.waiting_events();
        let early = std::mem::replace(&mut contents.early, waiting.len());
        let published = std::mem::take(&mut contents.events).into_iter().skip(early);
        published.chain(waiting.iter().map(journal::events::message)).collect()
    }
}
