//! What the core keeps beside the stage: what launchers never see.

use std::sync::Arc;

use crate::agenda::{Agenda, Asker};
use crate::asked::Asked;
use crate::detached::{DetachedModule, StepOutcome};
use crate::event::ModuleEvent;
use crate::inlet::AnyInlet;
use crate::inspect::Inspector;
use crate::job::{HeldResults, Work, Workers};
use crate::join::{JoinQueue, Request};
use crate::management::{Command, Member, Members, Place};
use crate::outlet::Outlets;
use crate::probe::Probe;
use crate::service::{AnyCall, AnyClient, AnyReply, ReplyTo, ServiceRegistry};
use crate::setting::SettingsChange;
use crate::watchdog::Watchdog;
use crate::{Clock, LifecycleState, ModuleId, Role, SettingInfo, Stage, Time};

/// The threads for blocking jobs.
const JOB_THREADS: std::num::NonZeroUsize = std::num::NonZeroUsize::new(4).unwrap();

pub(crate) struct World {
    pub(crate) clock: Arc<dyn Clock>,
    /// The time of the last cycle.
    pub(crate) last_now: Time,
    pub(crate) queue: Arc<JoinQueue>,
    pub(crate) probe: Option<Arc<dyn Probe>>,
    pub(crate) members: Members,
    pub(crate) agenda: Agenda,
    pub(crate) services: ServiceRegistry,
    pub(crate) inlets: Vec<Box<dyn AnyInlet>>,
    pub(crate) outlets: Outlets,
    /// What is called when the core has stopped.
    pub(crate) at_end: Vec<Box<dyn FnOnce() + Send>>,
    /// By slot.
    pub(crate) detached: Vec<Option<DetachedModule>>,
    pub(crate) workers: Workers,
    pub(crate) watchdog: Watchdog,
    pub(crate) joined: Joined,
    /// True if something was added to it since the last sync phase.
    pub(crate) has_joined: bool,
    /// The modules that asked for something in this cycle, in the order of registration.
    pub(crate) askers: Vec<Asker>,
    /// Modules whose last callback has run, by their place in the order of registration.
    pub(crate) leaving: Vec<u64>,
    /// Modules that are gone and of which the mechanisms have not been told yet.
    pub(crate) gone: Vec<ModuleId>,
    /// When modules are started again after a panic, by their place in the order of registration.
    pub(crate) restarts: Vec<(Time, u64)>,
    /// When a mechanism has to do something next that no module waits for.
    pub(crate) calls_due: Time,
    /// Slots of the stage that were freed since the launcher was told.
    pub(crate) freed_slots: Vec<usize>,
    pub(crate) steps_topic: Option<usize>,
    pub(crate) changes_topic: Option<usize>,
    /// Settings that were changed since the last sync phase of messages.
    pub(crate) changes: Vec<SettingsChange>,
    pub(crate) events_topic: Option<usize>,
    /// What took effect since the last sync phase of messages.
    pub(crate) events: Vec<ModuleEvent>,
    /// Where results of jobs wait until they are released.
    pub(crate) held_results: Option<HeldResults>,
    /// True if what modules ask of themselves is dropped.
    pub(crate) drops_commands_to_self: bool,
    pub(crate) cycle: u64,
    pub(crate) is_running: bool,
    pub(crate) has_stopped: bool,
    pub(crate) pause: Pause,
    pub(crate) inspector: Inspector,
    /// True if the core slept before the cycle.
    pub(crate) has_slept: bool,
}

/// What is known of a module, see [`Core::modules`](crate::Core::modules).
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ModuleInfo {
    /// The name under which it was added.
    pub name: Arc<str>,
    /// Where it is in its life.
    pub state: LifecycleState,
    /// What it is for.
    pub role: Role,
    /// True if it runs on a thread of its own.
    pub is_detached: bool,
    /// True if it is paused.
    pub is_paused: bool,
    /// How often it was started again after a panic.
    pub restarts: u32,
}

/// What came from other threads since the last sync phase.
#[derive(Default)]
pub(crate) struct Joined {
    /// Each with the module that asked.
    pub(crate) commands: Vec<(Option<ModuleId>, Command)>,
    /// Those of the commands that are about settings.
    pub(crate) settings: Vec<Command>,
    pub(crate) steps: Vec<StepOutcome>,
    pub(crate) calls: Vec<Box<dyn AnyCall>>,
    pub(crate) results: Vec<JobResult>,
    /// Calls of detached modules, by client port.
    pub(crate) calls_of_detached: Vec<(ModuleId, u32, Box<dyn AnyClient>)>,
    /// Answers of detached modules, and of modules that start again.
    pub(crate) answers: Vec<Answer>,
    pub(crate) work: Vec<Work>,
}

/// An answer on its way to its client, with the name of its service.
pub(crate) type Answer = (ReplyTo, Arc<str>, Box<dyn AnyReply>);

pub(crate) struct JobResult {
    pub(crate) module: ModuleId,
    pub(crate) port: u32,
    /// Counts what the module asked of the job.
    pub(crate) number: u64,
    pub(crate) result: Box<dyn std::any::Any + Send>,
}

/// Whether the whole core is held.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Pause {
    #[default]
    Running,
    /// Runs so many more cycles.
    Paused { steps: u32 },
}

impl World {
    pub(crate) fn new(clock: Arc<dyn Clock>, queue: Arc<JoinQueue>) -> Self {
        Self {
            clock,
            last_now: Time::from_nanos(i64::MIN),
            queue,
            probe: None,
            members: Members::default(),
            agenda: Agenda::default(),
            services: ServiceRegistry::default(),
            inlets: Vec::new(),
            outlets: Outlets::default(),
            at_end: Vec::new(),
            detached: Vec::new(),
            workers: Workers::new(JOB_THREADS),
            watchdog: Watchdog::new(),
            joined: Joined::default(),
            has_joined: false,
            askers: Vec::new(),
            leaving: Vec::new(),
            gone: Vec::new(),
            restarts: Vec::new(),
            calls_due: Time::MAX,
            freed_slots: Vec::new(),
            steps_topic: None,
            changes_topic: None,
            changes: Vec::new(),
            events_topic: None,
            events: Vec::new(),
            held_results: None,
            drops_commands_to_self: false,
            cycle: 0,
            is_running: false,
            has_stopped: false,
            pause: Pause::default(),
            inspector: Inspector::new(),
            has_slept: false,
        }
    }

    pub(crate) fn free_detached_slot(&mut self) -> usize {
        self.detached.iter().position(Option::is_none).unwrap_or_else(|| {
            self.detached.push(None);
            self.detached.len() - 1
        })
    }

    /// Sorts what other threads asked for. What comes while this runs waits for the next cycle, so that a busy
    /// thread cannot hold this one.
    #[inline]
    pub(crate) fn join(&mut self) {
        if !self.queue.has_no_requests() {
            self.sort_requests();
        }
    }

    #[inline(never)]
    fn sort_requests(&mut self) {
        self.has_joined = true;
        for _ in 0..self.queue.len() {
            match self.queue.pop() {
                Some(Request::Command(command)) => self.joined.commands.push((None, command)),
                Some(Request::Step(outcome)) => self.joined.add_step(outcome),
                Some(Request::Call(call)) => self.joined.calls.push(call),
                Some(Request::Job(result)) => self.joined.results.push(result),
                None => break,
            }
        }
    }

    /// Has the mechanisms look at what a module asked for outside of the process phase.
    pub(crate) fn note_asker(&mut self, asker: Asker) {
        match self.askers.binary_search_by_key(&asker.module.order, |known| known.module.order) {
            Ok(position) => self.askers[position].asked.add(asker.asked),
            Err(position) => self.askers.insert(position, asker),
        }
    }

    /// The settings of a module, those of a detached one with the values after its last run.
    pub(crate) fn settings(&self, stage: &Stage, module: ModuleId) -> Vec<SettingInfo> {
        let settings = match module.place {
            Place::Attached(slot) => stage.look(slot, |cell| cell.settings().to_vec()),
            Place::Detached(slot) => self.detached[slot].as_ref().map(|module| module.settings().to_vec()),
        };
        settings.unwrap_or_default()
    }

    /// What is known of the modules, in the order of registration.
    pub(crate) fn modules(&self, stage: &Stage) -> Vec<ModuleInfo> {
        let describe = |member: &Member| {
            let (state, is_paused) = match member.id.place {
                Place::Attached(slot) => stage.look(slot, |cell| (cell.state(), cell.is_paused()))?,
                Place::Detached(slot) => {
                    self.detached[slot].as_ref().map(|module| (module.state, module.is_paused))?
                }
            };
            let is_detached = matches!(member.id.place, Place::Detached(_));
            let (name, role, restarts) = (Arc::clone(&member.name), member.role(), member.restarts);
            Some(ModuleInfo { name, state, role, is_detached, is_paused, restarts })
        };
        self.members.iter().filter_map(describe).collect()
    }

    /// What the mechanisms have to look at though no module of this cycle asked for it.
    #[inline]
    pub(crate) fn asked_from_outside(&mut self, now: Time) -> Asked {
        let is_due = !self.restarts.is_empty() || self.calls_due <= now || self.has_stopped;
        let has_joined = is_due || std::mem::take(&mut self.has_joined);
        if has_joined { Asked::ALWAYS.or(Asked::JOINED) } else { Asked::ALWAYS }
    }

    /// True if the next cycle has something to do whatever the time is.
    pub(crate) fn has_work(&self) -> bool {
        self.agenda.has_ready()
            || self.outlets.has_waiting()
            || !self.queue.is_empty()
            || self.joined.has_work()
    }

    /// The earliest time for which somebody asked.
    pub(crate) fn earliest_due(&mut self) -> Time {
        let restarts = self.restarts.iter().map(|&(due, _)| due);
        let due = restarts.fold(self.calls_due, Time::min);
        due.min(self.agenda.earliest_due())
    }
}

impl Joined {
    fn add_step(&mut self, mut step: StepOutcome) {
        let module = step.module;
        self.commands.extend(step.commands.drain(..).map(|command| (Some(module), command)));
        self.work.append(&mut step.work);
        self.calls_of_detached.extend(step.calls.drain(..).map(|(port, calls)| (module, port, calls)));
        self.answers.append(&mut step.answers);
        self.steps.push(step);
    }

    fn has_work(&self) -> bool {
        !(self.commands.is_empty()
            && self.settings.is_empty()
            && self.steps.is_empty()
            && self.calls.is_empty()
            && self.results.is_empty()
            && self.work.is_empty()
            && self.calls_of_detached.is_empty()
            && self.answers.is_empty())
    }
}
