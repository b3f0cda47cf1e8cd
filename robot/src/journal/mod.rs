//! Journals: runs, cycles, settings and events of a running robot as ROS messages, so that a bag holds them
//! and a replay repeats them.
//!
//! The executor reports runs of detached modules, changed settings and events on topics of its own, as Rust
//! types. A journal publishes each report as a ROS message on another topic, which robot files name, and
//! which is recorded, like any topic.

pub(crate) mod events;
mod runs;

use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;

use downbeat_edge::{Interfaces, parameter_value};
use downbeat_executor::{
    Context, Core, DetachedStep, Idle, Module, ModuleEvent, ModuleOptions, Publication, Received, Role,
    SettingsChange, Setup, SetupError, Synchrony, Time,
};
use downbeat_msgs::builtin_interfaces::msg::Time as TimeMessage;
use downbeat_msgs::downbeat_interfaces::msg::{CycleMessages, CycleTimes, ModuleSettings, ModuleStep};
use downbeat_msgs::rcl_interfaces::msg::Parameter;

/// The topic with the times of cycles.
pub const CYCLES: &str = "cycle_times";
/// The topic with the cycles of messages, where several cycles run at one time.
pub const MESSAGES: &str = "cycle_messages";
/// The topic with the runs of detached modules.
pub const STEPS: &str = "module_steps";
/// The topic with the changes of settings.
pub const SETTINGS: &str = "module_settings";
/// The topic with requests, answers, commands to modules and results of jobs.
pub const EVENTS: &str = "module_events";

/// The topic with the runs of all modules and their causes.
pub const RUNS: &str = "module_runs";

/// The topics of all journals.
pub(crate) const TOPICS: [&str; 6] = [CYCLES, MESSAGES, STEPS, SETTINGS, EVENTS, RUNS];

const CYCLE_JOURNAL: &str = "cycle_journal";
const STEP_JOURNAL: &str = "step_journal";
const SETTINGS_JOURNAL: &str = "settings_journal";
const EVENT_JOURNAL: &str = "event_journal";
const RUN_JOURNAL: &str = "run_journal";

/// The names of the modules that publish them.
pub(crate) const MODULE_NAMES: [&str; 5] =
    [CYCLE_JOURNAL, STEP_JOURNAL, SETTINGS_JOURNAL, EVENT_JOURNAL, RUN_JOURNAL];

/// Adds the journals to a core that has all its modules. Requests and answers are recorded with their content
/// where their types are registered. A core that spins has no journal of its cycles: there would be millions,
/// nearly all of them idle.
///
/// # Errors
/// If the core has modules or topics of these names.
pub fn add(core: &mut Core, interfaces: &Interfaces, idle: Idle) -> Result<(), SetupError> {
    events::encode_services(core, interfaces)?;
    let steps = Journal { reports: DetachedStep::TOPIC, topic: STEPS, message: step_message };
    steps.add(core, STEP_JOURNAL)?;
    let settings = Journal { reports: SettingsChange::TOPIC, topic: SETTINGS, message: settings_message };
    settings.add(core, SETTINGS_JOURNAL)?;
    let events = Journal { reports: ModuleEvent::TOPIC, topic: EVENTS, message: events::message };
    events.add(core, EVENT_JOURNAL)?;
    runs::RunJournal::add(core)?;
    match idle {
        Idle::Park => CycleJournal::add(core),
        Idle::Spin => Ok(()),
    }
}

/// Publishes each report of the executor as a ROS message.
struct Journal<R, M> {
    /// The topic of the reports.
    reports: &'static str,
    /// The topic of the messages.
    topic: &'static str,
    message: fn(&R) -> M,
}

impl<R: Send + Sync + 'static, M: Send + Sync + 'static> Journal<R, M> {
    /// As an observer, which stops after all modules: it publishes their last reports too.
    fn add(self, core: &mut Core, name: &str) -> Result<(), SetupError> {
        core.add_with(name, self, ModuleOptions { role: Role::Observer, ..ModuleOptions::default() })
    }

    fn on_report(&mut self, report: Received<'_, R>, ctx: &mut Context<'_, Publication<M>>) {
        ctx.publish(*ctx.ports, (self.message)(&report));
    }
}

impl<R: Send + Sync + 'static, M: Send + Sync + 'static> Module for Journal<R, M> {
    type Ports = Publication<M>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        setup.subscribe(self.reports, Self::on_report)?;
        setup.publish(self.topic)
    }
}

fn step_message(step: &DetachedStep) -> ModuleStep {
    ModuleStep {
        stamp: TimeMessage::from_nanos(step.time.as_nanos()),
        module: step.module.to_string(),
        step: step.step,
        cycle: step.cycle,
        is_stop: step.is_stop,
        topics: step.inputs.iter().map(|input| input.topic.to_string()).collect(),
        skipped: step.inputs.iter().map(|input| input.skipped).collect(),
        counts: step.inputs.iter().map(|input| input.received).collect(),
    }
}

fn settings_message(change: &SettingsChange) -> ModuleSettings {
    let parameter =
        |(name, value): &(String, _)| Parameter { name: name.clone(), value: parameter_value(value) };
    ModuleSettings {
        stamp: TimeMessage::from_nanos(change.time.as_nanos()),
        module: change.module.to_string(),
        step: change.step.unwrap_or(0),
        settings: change.settings.iter().map(parameter).collect(),
    }
}

/// Publishes the times of all cycles on [`CYCLES`], many at once, and on [`MESSAGES`] which messages joined
/// in cycles that are not the first at their time.
///
/// It is the first module to stop, so that its last message ends with the last cycle in which all modules
/// ran: in a replay they run in all of its cycles.
#[derive(Default)]
pub struct CycleJournal {
    first: u64,
    times: Vec<i64>,
    last: Last,
    messages: CycleMessages,
    /// The positions of topics in `messages`.
    positions: HashMap<Arc<str>, u16>,
}

/// The last cycle, whose messages the next one sees.
#[derive(Clone, Copy, Default)]
enum Last {
    #[default]
    None,
    /// The first one at this time.
    FirstAt(Time),
    AnotherAt(Time),
}

/// The keys of [`CycleJournal`].
#[derive(Clone, Copy)]
pub struct CyclePorts {
    times: Publication<CycleTimes>,
    messages: Publication<CycleMessages>,
}

/// Times and runs are published when there are this many, or the first of them is this old.
const MOST: usize = 256;
const OLDEST: Duration = Duration::from_millis(250);

impl CycleJournal {
    /// Adds the journal to a core.
    ///
    /// # Errors
    /// If another module has the name or the topic.
    pub fn add(core: &mut Core) -> Result<(), SetupError> {
        let options = ModuleOptions {
            synchrony: Synchrony::EveryCycle,
            role: Role::Timekeeper,
            ..ModuleOptions::default()
        };
        core.add_with(CYCLE_JOURNAL, Self::default(), options)
    }

    fn on_cycle(&mut self, ctx: &mut Context<'_, CyclePorts>) {
        let now = ctx.now();
        self.note_messages(ctx);
        self.last = match self.last {
            Last::FirstAt(time) | Last::AnotherAt(time) if time == now => Last::AnotherAt(now),
            _ => Last::FirstAt(now),
        };
        let since = self.times.first().map_or(now, |&first| Time::from_nanos(first));
        self.times.push(now.as_nanos());
        if self.times.len() >= MOST || now.saturating_since(since) >= OLDEST {
            self.publish(false, ctx);
        }
    }

    /// Notes what the last cycle published.
    fn note_messages(&mut self, ctx: &Context<'_, CyclePorts>) {
        let before = self.messages.positions.len();
        if let Last::AnotherAt(_) = self.last {
            let robot_topics = ctx.carried().filter(|(topic, _)| !topic.starts_with("executor/"));
            for (topic, count) in robot_topics {
                if let Some(position) = self.position_of(topic) {
                    self.messages.positions.extend(std::iter::repeat_n(position, count));
                }
            }
        }
        if !matches!(self.last, Last::None) {
            let size = self.messages.positions.len() - before;
            self.messages.sizes.push(u32::try_from(size).unwrap_or(u32::MAX));
        }
    }

    /// `None` for topics beyond the first 65536 of a message: theirs join in the first cycle of their time.
    fn position_of(&mut self, topic: &Arc<str>) -> Option<u16> {
        if let Some(&position) = self.positions.get(topic) {
            return Some(position);
        }
        let position = u16::try_from(self.messages.topics.len()).ok()?;
        self.messages.topics.push(topic.to_string());
        self.positions.insert(Arc::clone(topic), position);
        Some(position)
    }

    fn publish(&mut self, is_end: bool, ctx: &mut Context<'_, CyclePorts>) {
        let times = std::mem::replace(&mut self.times, Vec::with_capacity(MOST));
        let first = self.first;
        self.first += times.len() as u64;
        ctx.publish(ctx.ports.times, CycleTimes { first, is_end, times });
        let next = self.messages.first + self.messages.sizes.len() as u64;
        let next = CycleMessages { first: next, ..CycleMessages::default() };
        let messages = std::mem::replace(&mut self.messages, next);
        self.positions.clear();
        if !messages.positions.is_empty() {
            ctx.publish(ctx.ports.messages, messages);
        }
    }
}

impl Module for CycleJournal {
    type Ports = CyclePorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        setup.each_run(Self::on_cycle);
        Ok(CyclePorts { times: setup.publish(CYCLES)?, messages: setup.publish(MESSAGES)? })
    }

    fn shutdown(&mut self, ctx: &mut Context<'_, CyclePorts>) {
        self.note_messages(ctx);
        self.publish(true, ctx);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use downbeat_executor::{ManualClock, OutletInbox};
    use parking_lot::Mutex;

    use super::*;

    /// A module that takes its time to stop.
    struct Slow(ManualClock);

    impl Module for Slow {
        type Ports = ();

        fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
            Ok(())
        }

        fn shutdown(&mut self, _: &mut Context<'_, ()>) {
            self.0.set(Time::from_nanos(500));
        }
    }

    #[test]
    fn the_account_of_cycles_ends_before_the_first_module_stops_even_if_that_joined_later() {
        let clock = ManualClock::new(Time::from_nanos(100));
        let mut core = Core::new().with_clock(clock.clone());
        CycleJournal::add(&mut core).unwrap();
        core.add("slow", Slow(clock)).unwrap();
        let times = Arc::new(Mutex::new(Vec::new()));
        let heard = Arc::clone(&times);
        let note =
            move |message: Received<'_, CycleTimes>| heard.lock().extend(message.times.iter().copied());
        core.outlet(CYCLES, OutletInbox::new("test", downbeat_executor::Inbox::KeepAll), note)
            .unwrap()
            .keep();
        core.cycle().unwrap();
        core.stop();
        assert_eq!(*times.lock(), [100; 4]);
    }
}
