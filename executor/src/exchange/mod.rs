//! The mechanisms of the core, in the order in which the sync phase runs them. Each defines its state, its
//! port in a module, its sync step, and its functions for modules, cores and handles.

mod events;
mod jobs;
mod messages;
mod modules;
mod services;
mod settings;
mod timers;

pub use events::{CallOrigin, ModuleCommand, ModuleEvent, ModuleEventKind};
pub use jobs::{Completion, Job, JobError};
pub(crate) use messages::Messages;
pub use messages::{
    CycleRuns, DetachedStep, Inlet, InletError, ModuleRun, Outlet, OutletGate, OutletInbox, Published,
    RunCause, RunCauses, StepInput, WiredModule, Wiring,
};
pub use modules::{RestartRefused, UnknownModule};
pub(crate) use services::Services;
pub use services::{
    AnyValue, CallError, CallId, Caller, Client, Reply, Responder, ServiceInfo, ServiceType, StandIn,
};
pub use settings::{Setting, SettingRefused, SettingsChange};
pub use timers::Task;

use crate::cycle::Mechanisms;
use crate::module::{JOBS, MESSAGES, MODULES, SERVICES, SETTINGS, TIMERS, Views};

/// Adds the built-in mechanisms, in the order of the sync phase.
pub(crate) fn add_built_in(mechanisms: &mut Mechanisms, views: &mut Views) {
    mechanisms.add_built_in(MODULES, modules::Modules::default(), views);
    mechanisms.add_built_in(JOBS, jobs::Jobs::default(), views);
    mechanisms.add_built_in(SETTINGS, settings::Settings::default(), views);
    mechanisms.add_built_in(MESSAGES, messages::Messages::default(), views);
    mechanisms.add_built_in(SERVICES, services::Services::default(), views);
    mechanisms.add_built_in(TIMERS, timers::Timers, views);
}
