//! What happens in a running robot besides its messages, published as ROS messages, so that a bag holds it and a replay repeats it.
//!
//! The executor reports runs of detached modules, changed settings and events on topics of its own, as Rust types. A journal publishes
//! each report as a ROS message on another topic, which robot files name, and which is recorded, like any topic.

mod cycles;
pub(crate) mod events;
mod settings;
mod steps;

use downbeat_bridge::edge::Interfaces;
use downbeat_executor::{
    Context, Core, DetachedStep, Idle, Module, ModuleEvent, ModuleOptions, Publication, Received, Role,
    SettingsChange, Setup, SetupError,
};

pub use cycles::CycleJournal;

/// The topic with the times of cycles.
pub const CYCLES: &str = "cycle_times";
/// The topic with the runs of detached modules.
pub const STEPS: &str = "module_steps";
/// The topic with the changes of settings.
pub const SETTINGS: &str = "module_settings";
/// The topic with requests, answers, commands to modules and results of jobs.
pub const EVENTS: &str = "module_events";

/// The topics of all journals.
pub(crate) const TOPICS: [&str; 4] = [CYCLES, STEPS, SETTINGS, EVENTS];

const CYCLE_JOURNAL: &str = "cycle_journal";
const STEP_JOURNAL: &str = "step_journal";
const SETTINGS_JOURNAL: &str = "settings_journal";
const EVENT_JOURNAL: &str = "event_journal";

/// The names of the modules that publish them.
pub(crate) const MODULE_NAMES: [&str; 4] = [CYCLE_JOURNAL, STEP_JOURNAL, SETTINGS_JOURNAL, EVENT_JOURNAL];

/// Adds the journals to a core that has all its modules. Requests and answers are recorded with their content where their types are
/// registered. A core that spins has no journal of its cycles: there would be millions, nearly all of them idle.
///
/// # Errors
/// If the core has modules or topics of these names.
pub fn add(core: &mut Core, interfaces: &Interfaces, idle: Idle) -> Result<(), SetupError> {
    events::encode_services(core, interfaces)?;
    let steps = Journal { reports: DetachedStep::TOPIC, topic: STEPS, message: steps::message };
    steps.add(core, STEP_JOURNAL)?;
    let settings = Journal { reports: SettingsChange::TOPIC, topic: SETTINGS, message: settings::message };
    settings.add(core, SETTINGS_JOURNAL)?;
    let events = Journal { reports: ModuleEvent::TOPIC, topic: EVENTS, message: events::message };
    events.add(core, EVENT_JOURNAL)?;
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
