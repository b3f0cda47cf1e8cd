//! The account of runs: which modules ran in a cycle, for what causes, and what they published.

use std::fmt;
use std::sync::Arc;

use super::Topics;
use crate::cycle::{Asker, CoreState, Member};
use crate::exchange::Services;
use crate::module::{Asked, Causes, Direction, MESSAGES, Place, SERVICES, StepOutcome, Views};
use crate::topics::Report;
use crate::{ModuleId, Role, Stage, Time};

/// The runs of a cycle, published as `Arc<CycleRuns>` on [`CycleRuns::TOPIC`] if the topic has subscribers.
///
/// With it, each message is traced to the run that published it, and each run to the messages it received:
/// a run inside the cycle that has [`RunCause::Messages`] received, on all its subscriptions, the messages
/// that were published in the cycle before; a [`DetachedStep`](crate::DetachedStep) counts the messages of
/// each run of a detached module.
///
/// The messages of a topic in a cycle are, in this order, those of inlets
/// ([`from_inlets`](Self::from_inlets)) and those of the [`runs`](Self::runs). Observers are not part of the
/// robot: their runs and messages are left out, as are the reports of the executor.
///
/// A module that receives the topic is not woken by it, but runs with the next cycle that has another reason.
/// So recording runs does not add cycles.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CycleRuns {
    /// The time of the cycle.
    pub time: Time,
    /// The number of the cycle.
    pub cycle: u64,
    /// The modules and topics to which the numbers below refer. The same `Arc` until one of them changes.
    pub wiring: Arc<Wiring>,
    /// The messages that came from outside the core.
    pub from_inlets: Vec<Published>,
    /// The runs in the order in which their messages were published: runs of detached modules that joined in
    /// this cycle, in the order in which they ended, then those inside the cycle, in the order of
    /// registration.
    pub runs: Vec<ModuleRun>,
    /// The messages of all runs; see [`published`](Self::published).
    published: Vec<Published>,
}

/// A run of a module, see [`CycleRuns`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ModuleRun {
    /// The module, as an index of [`Wiring::modules`].
    pub module: u32,
    /// The reasons of the run.
    pub causes: RunCauses,
    /// The number of the run of a detached module; `None` inside the cycle.
    pub step: Option<u64>,
    /// Where its messages begin and end in `CycleRuns::published`.
    published: (u32, u32),
}

/// A number of messages of a topic.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Published {
    /// The topic, as an index of [`Wiring::topics`].
    pub topic: u32,
    /// The number of messages.
    pub count: u32,
}

/// The modules of a core that are parts of the robot, and their connections, at the time of a cycle.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Wiring {
    /// The modules, in the order of registration.
    pub modules: Vec<WiredModule>,
    /// The names of the topics.
    pub topics: Vec<Arc<str>>,
}

/// A module of a [`Wiring`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WiredModule {
    /// The name.
    pub name: Arc<str>,
    /// True if the module runs on a separate thread.
    pub is_detached: bool,
    /// The first cycle whose messages this instance of the module can receive. Later than 0 if the module was
    /// added or restarted while the core ran, or if no module received the report before.
    pub since: u64,
    /// The topics that the module receives, as indices of [`Wiring::topics`].
    pub subscribes: Vec<u32>,
    /// The topics on which the module publishes, as indices of [`Wiring::topics`].
    pub publishes: Vec<u32>,
    /// The services that the module answers.
    pub serves: Vec<Arc<str>>,
    /// The services that the module calls.
    pub calls: Vec<Arc<str>>,
}

/// A reason of a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum RunCause {
    /// The first run of the module while it is active, together with the transition to this state.
    Start = 0,
    /// Messages. Also part of a first run inside the cycle, which receives what there is.
    Messages = 1,
    /// A timer or a task was due.
    Time = 2,
    /// A request to one of its services.
    Request = 3,
    /// An answer to a call of the module, or the end of a call's time.
    Response = 4,
    /// A setting changed.
    Setting = 5,
    /// The result of a job.
    Result = 6,
    /// A run in every cycle, or the end of a pause.
    Woken = 7,
    /// Another transition of its lifecycle.
    Transition = 8,
    /// The module was stopped or removed.
    Stop = 9,
}

impl RunCause {
    /// All causes, in the order of their numbers.
    pub const ALL: [Self; 10] = [
        Self::Start,
        Self::Messages,
        Self::Time,
        Self::Request,
        Self::Response,
        Self::Setting,
        Self::Result,
        Self::Woken,
        Self::Transition,
        Self::Stop,
    ];
}

impl fmt::Display for RunCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Start => "start",
            Self::Messages => "messages",
            Self::Time => "timer",
            Self::Request => "request",
            Self::Response => "response",
            Self::Setting => "setting",
            Self::Result => "result of a job",
            Self::Woken => "every cycle",
            Self::Transition => "transition",
            Self::Stop => "stop",
        })
    }
}

/// A set of causes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct RunCauses(u16);

impl RunCauses {
    /// The set as a number, in which each cause is the bit of its number.
    #[must_use]
    pub const fn bits(self) -> u16 {
        self.0
    }

    /// The set of these [`bits`](Self::bits).
    #[must_use]
    pub const fn from_bits(bits: u16) -> Self {
        Self(bits)
    }

    /// True if the set contains the cause.
    #[must_use]
    pub const fn has(self, cause: RunCause) -> bool {
        self.0 & (1 << cause as u8) != 0
    }

    /// The causes in the set.
    pub fn iter(self) -> impl Iterator<Item = RunCause> {
        RunCause::ALL.into_iter().filter(move |&cause| self.has(cause))
    }

    fn of(causes: Causes) -> Self {
        let mut bits = 0;
        let mut add = |is_there: bool, cause: RunCause| bits |= u16::from(is_there) << cause as u8;
        add(causes.has(Causes::MESSAGES), RunCause::Messages);
        add(causes.has(Causes::STOP), RunCause::Stop);
        if causes.has(Causes::START) {
            // A first run calls all callbacks, whether or not there is something for them.
            add(true, RunCause::Start);
        } else {
            // A due time does not distinguish between the three kinds.
            let is_due = causes.and(Causes::DUE) == causes;
            add(is_due || causes.has(Causes::TASKS.and(Causes::TIMERS)), RunCause::Time);
            add(!is_due && causes.has(Causes::REPLIES), RunCause::Response);
            add(causes.has(Causes::REQUESTS), RunCause::Request);
            add(causes.has(Causes::SETTINGS), RunCause::Setting);
            add(causes.has(Causes::RESULTS), RunCause::Result);
            add(causes.has(Causes::WOKEN), RunCause::Woken);
            add(causes.has(Causes::TRANSITION), RunCause::Transition);
        }
        Self(bits)
    }
}

impl CycleRuns {
    /// The topic on which the runs are published.
    pub const TOPIC: &'static str = "executor/runs";

    /// The messages of a run, by topic.
    #[must_use]
    pub fn published(&self, run: &ModuleRun) -> &[Published] {
        self.published.get(run.published.0 as usize..run.published.1 as usize).unwrap_or_default()
    }

    /// An account without runs, to which [`add`](Self::add) adds them: for accounts that were recorded.
    #[must_use]
    pub fn new(time: Time, cycle: u64, wiring: Arc<Wiring>, from_inlets: Vec<Published>) -> Self {
        Self { time, cycle, wiring, from_inlets, runs: Vec::new(), published: Vec::new() }
    }

    /// Adds a run; see [`ModuleRun`].
    pub fn add(&mut self, module: u32, causes: RunCauses, step: Option<u64>, published: &[Published]) {
        let begin = index(self.published.len());
        self.published.extend_from_slice(published);
        self.runs.push(ModuleRun { module, causes, step, published: (begin, index(self.published.len())) });
    }

    fn begin(&mut self, time: Time, cycle: u64, wiring: &Arc<Wiring>) {
        (self.time, self.cycle) = (time, cycle);
        if !Arc::ptr_eq(&self.wiring, wiring) {
            self.wiring = Arc::clone(wiring);
        }
        self.from_inlets.clear();
        self.runs.clear();
        self.published.clear();
    }
}

impl Report for Arc<CycleRuns> {
    const TOPIC: &'static str = CycleRuns::TOPIC;
    const NUMBER: usize = 2;
}

/// Collects the runs of a cycle.
#[derive(Default)]
pub(super) struct RunLog {
    /// The account of this cycle, between `begin` and `end`.
    current: Option<Arc<CycleRuns>>,
    /// Accounts that were published; those that all receivers have dropped are used again.
    published: Vec<Arc<CycleRuns>>,
    wiring: Arc<Wiring>,
    /// The state of the topics and modules that `wiring` describes.
    version: Option<u64>,
    /// The modules of `wiring`.
    ids: Vec<ModuleId>,
    /// Indices of `wiring.modules` by slot; [`OUTSIDE`] for observers and free slots.
    attached: Vec<u32>,
    /// As `attached`, for detached modules.
    detached: Vec<u32>,
    /// The position in the process phase of the next module inside the cycle.
    next: usize,
}

/// In place of an index: no part of the robot.
const OUTSIDE: u32 = u32::MAX;

/// How many accounts are kept for use again: those of the cycles whose messages are still on their way.
const KEPT: usize = 4;

fn index(index: usize) -> u32 {
    u32::try_from(index).unwrap_or(OUTSIDE)
}

impl RunLog {
    /// Begins the account of this cycle. `services` names the services.
    pub(super) fn begin(&mut self, topics: &Topics, state: &CoreState, services: &Services, now: Time) {
        if self.version != Some(topics.version()) {
            self.wire(topics, state, services);
        }
        let spare = self.published.iter_mut().position(|account| Arc::get_mut(account).is_some());
        let mut account = match spare {
            Some(spare) => self.published.swap_remove(spare),
            None => Arc::new(CycleRuns::new(now, state.cycle, Arc::clone(&self.wiring), Vec::new())),
        };
        if let Some(account) = Arc::get_mut(&mut account) {
            account.begin(now, state.cycle, &self.wiring);
        }
        self.next = 0;
        self.current = Some(account);
    }

    #[inline]
    fn account(&mut self) -> Option<&mut CycleRuns> {
        self.current.as_mut().and_then(Arc::get_mut)
    }

    pub(super) fn inlet(&mut self, topic: usize, messages: usize) {
        if messages > 0
            && let Some(account) = self.account()
        {
            account.from_inlets.push(Published { topic: index(topic), count: index(messages) });
        }
    }

    /// Notes messages of the run that [`ran`](Self::ran) ends.
    #[inline]
    pub(super) fn publishes(&mut self, topic: usize, messages: usize) {
        if let Some(account) = self.account() {
            account.published.push(Published { topic: index(topic), count: index(messages) });
        }
    }

    /// Ends a run. The messages since the last run are its own.
    #[inline]
    fn ran(&mut self, module: u32, causes: Causes, step: Option<u64>) {
        let Some(account) = self.account() else { return };
        let begin = account.runs.last().map_or(0, |run| run.published.1);
        if module == OUTSIDE {
            return account.published.truncate(begin as usize);
        }
        let end = index(account.published.len());
        if !causes.is_empty() || begin < end {
            let causes = RunCauses::of(causes);
            account.runs.push(ModuleRun { module, causes, step, published: (begin, end) });
        }
    }

    pub(super) fn stepped(&mut self, step: &StepOutcome) {
        if let Place::Detached(slot) = step.module.place {
            let module = self.detached.get(slot).copied().unwrap_or(OUTSIDE);
            self.ran(module, step.causes, Some(step.number));
        }
    }

    /// Adds the modules inside the cycle that come before this one in the order of registration.
    #[inline]
    fn catch_up(&mut self, stage: &mut Stage, order: u64) {
        while let Some(ready) = stage.runnable.get(self.next).filter(|ready| ready.order < order) {
            self.next += 1;
            let causes = stage.cells.get(ready.slot).map_or(Causes::NONE, |cell| cell.take_ran());
            self.ran(self.attached.get(ready.slot).copied().unwrap_or(OUTSIDE), causes, None);
        }
    }

    /// Takes the messages of the modules inside the cycle, and notes their runs.
    pub(super) fn take_runs(&mut self, stage: &mut Stage, state: &mut CoreState, now: Time) {
        let messaging = Asked::of(MESSAGES);
        for &Asker { order, slot, asked } in &state.askers.list {
            self.catch_up(stage, order);
            let is_run = stage.runnable.get(self.next).is_some_and(|ready| ready.order == order);
            let Stage { cells, views: Views { topics, .. }, .. } = &mut *stage;
            let Some(cell) = cells.get(slot) else { continue };
            if asked.has(messaging) {
                let mut messages = 0;
                cell.io.outboxes.drain(|topic, outbox| {
                    let wake = |slot| state.agenda.wake(slot, Causes::MESSAGES);
                    let count = topics.absorb_for(topic, outbox, now, wake);
                    self.publishes(topic, count);
                    messages += count;
                });
                cell.meter.published(messages);
            }
            let causes = cell.take_ran();
            // A module that only stopped in this cycle may still have the causes of an earlier run.
            let causes = if is_run { causes } else { causes.without(Causes::ALL) };
            self.next += usize::from(is_run);
            self.ran(self.attached.get(slot).copied().unwrap_or(OUTSIDE), causes, None);
        }
        self.catch_up(stage, u64::MAX);
    }

    /// Publishes the account, unless it is empty.
    pub(super) fn end(&mut self, topics: &mut Topics, state: &mut CoreState, now: Time) {
        let Some(account) = self.current.take() else { return };
        if !(account.runs.is_empty() && account.from_inlets.is_empty()) {
            topics.report(Arc::clone(&account));
            topics.take_reports(now, &mut |slot| state.agenda.wake_later(slot, Causes::MESSAGES));
        }
        self.published.push(account);
        if self.published.len() > KEPT {
            self.published.remove(0);
        }
    }

    #[cold]
    fn wire(&mut self, topics: &Topics, state: &CoreState, services: &Services) {
        let parts: Vec<_> = state.members.iter().filter(|member| member.role() == Role::Part).collect();
        let since = |member: &Member| {
            let known = self.ids.iter().position(|id| *id == member.id);
            known.map_or(state.cycle, |known| self.wiring.modules[known].since)
        };
        let wired = |member: &&Member| {
            let used = |of, direction| {
                let uses =
                    member.uses.iter().filter(move |used| (used.of, used.direction) == (of, direction));
                let mut indices: Vec<_> = uses.map(|used| used.index).collect();
                indices.sort_unstable();
                indices.dedup();
                indices.into_iter()
            };
            let service = |used: usize| Arc::clone(services.name(used));
            WiredModule {
                name: Arc::clone(&member.name),
                is_detached: matches!(member.id.place, Place::Detached(_)),
                since: since(member),
                subscribes: used(MESSAGES, Direction::In).map(index).collect(),
                publishes: used(MESSAGES, Direction::Out).map(index).collect(),
                serves: used(SERVICES, Direction::In).map(service).collect(),
                calls: used(SERVICES, Direction::Out).map(service).collect(),
            }
        };
        let modules = parts.iter().map(wired).collect();
        self.wiring = Arc::new(Wiring { modules, topics: topics.names().cloned().collect() });
        self.ids = parts.iter().map(|member| member.id).collect();
        self.attached.clear();
        self.detached.clear();
        for (number, id) in self.ids.iter().enumerate() {
            let (slots, slot) = match id.place {
                Place::Attached(slot) => (&mut self.attached, slot),
                Place::Detached(slot) => (&mut self.detached, slot),
            };
            if slots.len() <= slot {
                slots.resize(slot + 1, OUTSIDE);
            }
            slots[slot] = index(number);
        }
        self.version = Some(topics.version());
    }
}
