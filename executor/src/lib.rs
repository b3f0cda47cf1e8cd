//! A deterministic in-process executor for robot modules.
//!
//! Modules run in *cycles*. In the **process phase**, each module that has something to do runs with
//! exclusive access to itself, and only queues its messages and requests to others. In the **sync phase**,
//! all of them take effect. The order follows from the order of registration and of publishing, never from
//! threads: the same input gives the same output under every [`Launcher`].
//!
//! ```
//! use std::time::Duration;
//! use downbeat_executor::{Core, ManualClock, Module, Publication, Setup, SetupError, Time};
//!
//! #[derive(Default)]
//! struct Counter {
//!     count: u32,
//! }
//!
//! struct Ports {
//!     count: Publication<u32>,
//! }
//!
//! impl Module for Counter {
//!     type Ports = Ports;
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
//!         setup.every(Duration::from_millis(10), |counter, ctx| {
//!             counter.count += 1;
//!             ctx.publish(ctx.ports.count, counter.count);
//!         })?;
//!         Ok(Ports { count: setup.publish("count")? })
//!     }
//! }
//!
//! struct Printer;
//!
//! impl Module for Printer {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         setup.subscribe::<u32, _>("count", |_, count, ctx| println!("{}: {}", ctx.now(), *count))
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
//! With the default clock, [`Core::run`] runs until [`CoreHandle::stop`]. The [`tutorial`] builds a robot
//! step by step.
//!
//! # The order of one run
//!
//! A paused module does not run. Otherwise, a run does the following, in this order:
//!
//! 1. lifecycle transitions, in the order of the requests. If one is refused, the ones queued behind it are
//!    discarded. If the module is not active after the transitions, the run ends here: requests to the module
//!    are refused, and messages are dropped
//! 2. changed settings ([`Setup::on_change`])
//! 3. results of jobs, by the order in which the jobs were declared; of one job, in the order of joining
//! 4. messages, by the order of subscription; of one topic, in the order of the sync phase below
//! 5. requests, by the order in which the services were declared
//! 6. answers to calls and calls whose time is up, by the order in which the clients were declared
//! 7. tasks that are due, by time, and in the order of scheduling where times are equal. A task that is
//!    scheduled in this run waits for the next run
//! 8. timers that are due, by the order in which they were declared
//! 9. [`Setup::each_run`]
//!
//! A panic ends the module, and everything that this run has queued is discarded.
//!
//! ```
//! # use std::sync::mpsc::{Sender, channel};
//! # use std::time::Duration;
//! # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
//! /// Declares everything in reverse order, and reports the order of the calls.
//! struct Everything(Sender<&'static str>);
//!
//! impl Module for Everything {
//!     type Ports = ();
//!
//!     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
//!         setup.each_run(|module, _| drop(module.0.send("each run")));
//!         setup.every(Duration::from_millis(10), |module, _| drop(module.0.send("timer")))?;
//!         let task = setup.task(|module, _| drop(module.0.send("task")));
//!         let timeout = Duration::from_secs(1);
//!         let client = setup.client::<(), (), _>("it", timeout, |module, _, _| drop(module.0.send("answer")))?;
//!         setup.serve::<(), (), _>("it", |module, _, _| module.0.send("request").map_err(|gone| gone.to_string()))?;
//!         let job = setup.job::<(), _>(|module, _, _| drop(module.0.send("result")));
//!         setup.subscribe::<(), _>("go", move |module, _, ctx| {
//!             drop(module.0.send("message"));
//!             ctx.call(client, ());
//!             ctx.spawn(job, || ());
//!             ctx.schedule_after(task, Duration::from_millis(10));
//!         })?;
//!         let setting = setup.setting("setting", 0_i64, "anything")?;
//!         setup.on_change(setting, |module, _| drop(module.0.send("setting")));
//!         Ok(())
//!     }
//! }
//!
//! let (sender, calls) = channel();
//! let clock = ManualClock::new(Time::ZERO);
//! let mut core = Core::new().with_clock(clock.clone());
//! core.add("everything", Everything(sender))?;
//! let go = core.inlet("go")?;
//! let mut last = Vec::new();
//! for cycle in 0..4_i64 {
//!     go.publish(())?;
//!     core.handle().set("everything", "setting", cycle + 1);
//!     core.cycle()?;
//!     last = calls.try_iter().collect();
//!     clock.advance(Duration::from_millis(10));
//! }
//! let order = ["setting", "result", "message", "request", "answer", "task", "timer", "each run"];
//! assert_eq!(last, order);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # The order of the sync phase
//!
//! The sync phase first takes the requests that other threads have posted so far; later ones wait for the
//! next cycle. Then the mechanisms run one after another. Within each mechanism, **requests from other
//! threads go first**, in the order of their arrival (those of a detached module arrive at the end of its
//! run). Requests of the other modules follow, in the order of registration, and for each module in the order
//! in which it made them.
//!
//! 1. **modules**: modules whose back-off is over start again; panics are noticed; modules are removed and
//!    run their `shutdown`; then the remaining commands apply: add, transition, pause, resume
//! 2. **jobs**: work starts; results go to their modules, in the order in which the work ended. Under a clock
//!    that does not run by itself, the work runs here, to its end
//! 3. **settings**: values are checked and applied, in the order of the requests
//! 4. **messaging**: inlets, in the order in which they were made; detached modules, in the order in which
//!    their runs ended, each with its [`DetachedStep`]; the modules; the account of all runs ([`CycleRuns`]).
//!    Each topic's messages are now the batch of the next cycle, and go to the inboxes of [`Outlet`]s
//! 5. **services**: requests go to their servers: first those of [`Caller`]s, then of detached modules, then
//!    of the others; then answers go to their clients, and callers receive their time-outs
//! 6. **timers**: when each module has to run next
//! 7. the mechanisms added with [`Core::with_mechanism`], in the order in which they were added
//! 8. removed modules are dropped, and their resources are freed
//!
//! A cycle skips a mechanism of the core that has received no request. Messages that a `shutdown` publishes
//! in step 1 are still sent in step 4. The `shutdown` of a detached module runs on the module's thread, and
//! its messages join a later sync phase.
//!
//! # Costs in cycles
//!
//! | | takes effect |
//! | --- | --- |
//! | a message | received in the next cycle |
//! | a call | received in the next cycle, answered in the one after that |
//! | a setting, pause, removal | in the sync phase of this cycle |
//! | an added module, a transition | runs in the next cycle |
//! | a request of another thread | as above, counted from the sync phase in which it is taken |
//!
//! Cycles follow each other without pause while there is something to do. These figures are therefore a short
//! latency, and no fraction of a timer's period.

mod api;
mod cycle;
mod error;
mod exchange;
mod launchers;
pub mod log;
mod module;
mod observe;
mod probe;
pub mod queue;
mod threads;
mod time;
mod topics;
pub mod tutorial;

pub use cycle::{
    Core, CoreHandle, Idle, Launcher, Mechanism, MechanismKey, ModuleInfo, RunError, Stage, Step, SyncPhase,
};
pub use error::{SetupError, Version};
pub use exchange::{
    AnyValue, CallError, CallId, CallOrigin, Caller, Client, Completion, CycleRuns, DetachedStep, Inlet,
    InletError, Job, JobError, ModuleCommand, ModuleEvent, ModuleEventKind, ModuleRun, Outlet, OutletGate,
    OutletInbox, Published, Reply, Responder, RestartRefused, RunCause, RunCauses, ServiceInfo, ServiceType,
    Setting, SettingRefused, SettingsChange, StandIn, StepInput, Task, UnknownModule, WiredModule, Wiring,
};
pub use launchers::{Linear, Pool, PoolError, Scheduled, Threads};
pub use module::{
    Context, Inbox, LifeEvent, LifeStep, LifecycleState, Listening, Module, ModuleChange, ModuleId,
    ModuleOptions, Port, Restart, Role, SettingInfo, SettingType, SettingValue, Setup, StopRequest,
    Synchrony, Transition, TransitionError, TransitionRefused,
};
pub use observe::{
    CycleStatistics, CycleTrace, Graph, GraphEdge, GraphModule, GraphOutlet, GraphService, GraphTopic,
    LoopTiming, ModuleState, ModuleStatistics, OutletStatistics, Snapshot, TimeStatistics, Timing,
    TopicStatistics, TraceCause, TraceEvent, TraceEventKind, running_module, running_modules,
};
pub use probe::{Heard, Probe, ProbeError};
pub use threads::{Failure, Overrun, Receipt, Spin, ThreadError, ThreadOptions};
pub use time::{Clock, ManualClock, SystemClock, Time};
pub use topics::{
    AnyMessage, AnyPublication, AnyReceived, ErasedType, Kept, MessageType, Publication, Received,
    TopicCounter, TopicInfo,
};
