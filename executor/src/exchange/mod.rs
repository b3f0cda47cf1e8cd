//! The mechanisms of the core, in the order in which the sync phase runs them: each with its state, its part of a module,
//! its sync step, and what modules, cores and handles can do with it.

mod events;
mod jobs;
mod messages;
mod modules;
mod services;
mod settings;
mod timers;

pub use events::{CallOrigin, ModuleCommand, ModuleEvent, ModuleEventKind};
pub(crate) use jobs::Jobs;
pub use jobs::{Completion, Job, JobError};
pub(crate) use messages::Messages;
pub use messages::{DetachedStep, Inlet, InletError, Outlet, OutletInbox, StepInput};
pub(crate) use modules::Modules;
pub use modules::UnknownModule;
pub use services::{CallError, CallId, Caller, Client, Reply, Responder, ServiceInfo, StandIn};
pub(crate) use services::{SERVICES, Services};
pub(crate) use settings::Settings;
pub use settings::{Setting, SettingInfo, SettingRefused, SettingsChange};
pub use timers::Task;
pub(crate) use timers::Timers;
