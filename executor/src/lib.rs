//! A deterministic in-process executor for robot modules.
//!
//! Modules run in *cycles*. In the **process phase** each module that has something to do runs, with
//! exclusive access to itself, and only queues what it asks of others. In the **sync phase** all of it takes
//! effect. Order follows from the order of registration and of publishing, never from threads: the same
//! input gives the same output under every [`Launcher`].
//!
//! ```
//! use std::time::Duration;
//! use downbeat_executor::{Context, Core, ManualClock, Module, Publication, Received, Setup, SetupError, Time};
//!
//! #[derive(Default)]
//! struct Counter {
//!     count: u32,
//!     out: Option<Publication<u32>>,
//! }
//!
//! impl Module for Counter {
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         self.out = Some(setup.publish("count")?);
//!         setup.every(Duration::from_millis(10), Self::tick)
//!     }
//! }
//!
//! impl Counter {
//!     fn tick(&mut self, ctx: &mut Context<'_>) {
//!         self.count += 1;
//!         if let Some(out) = self.out {
//!             ctx.publish(out, self.count);
//!         }
//!     }
//! }
//!
//! struct Printer;
//!
//! impl Module for Printer {
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         setup.subscribe("count", |_: &mut Self, count: Received<'_, u32>, ctx: &mut Context<'_>| {
//!             println!("{}: {}", ctx.now(), *count);
//!         })
//!     }
//! }
//!
//! let clock = ManualClock::new(Time::ZERO);
//! let mut core = Core::new().with_clock(clock.clone());
//! core.add("counter", Counter::default())?;
//! core.add("printer", Printer)?;
//! for _ in 0..3 {
//!     core.cycle()?;
//!     clock.advance(Duration::from_millis(10));
//! }
//! core.stop();
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! With the default clock, [`Core::run`] runs until [`CoreHandle::stop`].

mod agenda;
mod behaviour;
mod cell;
mod clock;
mod context;
mod core;
mod detached;
mod error;
mod guard;
mod inlet;
mod inspect;
mod job;
mod join;
mod launcher;
mod lifecycle;
mod management;
mod mechanism;
mod messaging;
mod module;
mod options;
mod probe;
pub mod queue;
mod receipt;
mod schedule;
mod service;
mod setting;
mod setup;
mod stage;
mod thread;
mod time;
mod watchdog;

pub use crate::core::{Core, CoreHandle, Idle, ModuleInfo, RunError, SyncPhase};
pub use clock::{Clock, ManualClock, SystemClock};
pub use context::Context;
pub use error::SetupError;
pub use inlet::{Inlet, InletError};
pub use inspect::{
    CycleStatistics, CycleTrace, Graph, GraphEdge, GraphModule, GraphService, GraphTopic, ModuleState,
    ModuleStatistics, Snapshot, TimeStatistics, TopicStatistics, TraceEvent, TraceEventKind,
};
pub use job::{Completion, Job, JobError};
pub use join::{DetachedStep, StepInput};
pub use launcher::{Launcher, Linear, Pool, PoolError, Scheduled, Spin, Threads};
pub use lifecycle::{LifecycleState, Transition, TransitionError, TransitionRefused};
pub use management::{ModuleId, SettingRefused, UnknownModule};
pub use mechanism::{Mechanism, MechanismKey, Version};
pub use messaging::{Kept, Publication, Received, TopicCounter, TopicInfo};
pub use module::Module;
pub use options::{Inbox, ModuleOptions, Restart, Role, Synchrony};
pub use probe::{CycleReport, Probe, StepReport};
pub use receipt::Receipt;
pub use schedule::Task;
pub use service::{CallError, CallId, Caller, Client, Reply, Responder, ServiceInfo};
pub use setting::{Setting, SettingInfo, SettingType, SettingValue};
pub use setup::Setup;
pub use stage::Stage;
pub use thread::{ThreadError, ThreadOptions};
pub use time::Time;
pub use watchdog::Overrun;
