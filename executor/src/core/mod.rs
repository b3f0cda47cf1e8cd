//! The core: owns the modules and the mechanisms, and runs the cycles.

mod cycle;
mod handle;
mod phase;
mod stage_holder;
mod stop;
mod world;

use std::sync::Arc;
use std::time::Duration;

use crossbeam::sync::Parker;

pub use handle::CoreHandle;
pub use phase::SyncPhase;
use stage_holder::StageHolder;
pub use world::ModuleInfo;
pub(crate) use world::Pause;
pub(crate) use world::{Answer, JobResult, World};

use crate::asked::Asked;
use crate::event::Encoder;
use crate::inlet::{default_queue, open_inlet, open_inlet_of};
use crate::inspect::{Graph, Inspector};
use crate::job::Jobs;
use crate::join::JoinQueue;
use crate::management::{Candidate, Modules, Place, Source, admit};
use crate::mechanism::{Engaged, Version};
use crate::messaging::{AnyMessage, AnyReceived, MessageType, Messaging};
use crate::outlet::NewOutlet;
use crate::probe::Probe;
use crate::queue::Queue;
use crate::schedule::Timers;
use crate::service::{Services, StandIn};
use crate::setting::SettingsMechanism;
use crate::watchdog::Watch;
use crate::{
    Caller, Clock, Inlet, Launcher, Linear, Mechanism, Module, ModuleOptions, Outlet, OutletInbox, Overrun,
    Received, ServiceInfo, SettingInfo, SetupError, SystemClock, ThreadError, TopicInfo,
};

/// Why a core cannot run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The clock has to be moved by hand.
    #[error("this clock does not go on by itself; set it and call `cycle`, or use a clock that does")]
    ClockStandsStill,
    /// The core was stopped.
    #[error("this core has stopped, and a stopped core does not start again; make a new one")]
    Stopped,
    /// The core's own thread, or one of its launcher, cannot run as it was told.
    #[error(transparent)]
    Launcher(#[from] ThreadError),
    /// The thread of a detached module cannot start, or not run as it was told.
    #[error("detached module \"{module}\": {source}")]
    Thread {
        /// The module.
        module: String,
        /// What the system said.
        source: ThreadError,
    },
}

/// What [`Core::run`] does while nothing is due.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Idle {
    /// Its thread sleeps until something is.
    #[default]
    Park,
    /// Its thread looks again and again: it reacts a few microseconds sooner and keeps a processor busy.
    Spin,
}

/// Owns the modules of a robot and runs them in cycles: a process phase, in which modules run, and a sync
/// phase, in which what they asked for takes effect.
pub struct Core {
    stage: StageHolder,
    world: World,
    mechanisms: Vec<Engaged>,
    launcher: Box<dyn Launcher>,
    parker: Parker,
    idle: Idle,
    watch: Option<Watch>,
}

impl Default for Core {
    fn default() -> Self {
        Self::new()
    }
}

impl Core {
    /// A core without modules, with the launcher [`Linear`] and the [`SystemClock`].
    #[must_use]
    pub fn new() -> Self {
        let parker = Parker::new();
        let queue = Arc::new(JoinQueue::new(parker.unparker().clone()));
        let mut core = Self {
            stage: StageHolder::Own(Box::default()),
            world: World::new(Arc::new(SystemClock::new()), queue),
            mechanisms: Vec::new(),
            launcher: Box::new(Linear),
            parker,
            idle: Idle::default(),
            watch: None,
        };
        let joined = Asked::JOINED;
        core.engage(Modules, joined.or(Asked::PANIC).or(Asked::COMMANDS));
        core.engage(Jobs, joined.or(Asked::WORK));
        core.engage(SettingsMechanism, joined.or(Asked::COMMANDS));
        core.engage(Messaging, Asked::ALWAYS);
        core.engage(Services::default(), joined.or(Asked::CALLS).or(Asked::ANSWERS));
        core.engage(Timers, Asked::STATE.or(Asked::CALLS));
        core
    }

    /// The same core with another launcher.
    #[must_use]
    pub fn with_launcher(mut self, launcher: impl Launcher + 'static) -> Self {
        self.launcher = Box::new(launcher);
        self
    }

    /// The same core with another clock.
    ///
    /// # Panics
    /// If the core has modules or outlets: they were set up for the clock it had.
    #[must_use]
    pub fn with_clock(mut self, clock: impl Clock + 'static) -> Self {
        let is_empty = self.world.members.iter().next().is_none() && self.world.outlets.is_empty();
        assert!(is_empty, "give a core its clock before its modules and outlets");
        self.world.clock = Arc::new(clock);
        self
    }

    /// The clock from which modules have their time; for a thread beside the core that has to keep the same.
    #[must_use]
    pub fn clock(&self) -> Arc<dyn Clock> {
        Arc::clone(&self.world.clock)
    }

    /// The same core, which does not take the times of cycles and runs unless a [trace](CoreHandle::trace) is asked for.
    /// It counts all the same. Saves less than a hundredth of the time a cycle takes, and 15 KiB per module.
    ///
    /// # Panics
    /// If the core has modules: they were made to be measured.
    #[must_use]
    pub fn without_times(mut self) -> Self {
        assert!(self.world.members.iter().next().is_none(), "tell a core what to measure before its modules");
        self.world.inspector = Inspector::off();
        self
    }

    /// The same core, measured by `probe`.
    #[must_use]
    pub fn with_probe(mut self, probe: Arc<dyn Probe>) -> Self {
        self.world.probe = Some(probe);
        self
    }

    /// The same core, with another way to wait.
    #[must_use]
    pub fn with_idle(mut self, idle: Idle) -> Self {
        self.idle = idle;
        self
    }

    /// The same core with a deadline for each cycle: one that takes longer is reported while it still goes on.
    ///
    /// # Errors
    /// If the watchdog's thread cannot be started.
    pub fn with_cycle_deadline(mut self, deadline: Duration) -> Result<Self, RunError> {
        let watch = self.world.watchdog.watch(Arc::from("the cycle"), deadline);
        self.watch = Some(watch.map_err(|source| {
            RunError::Launcher(ThreadError::Start { thread: "watchdog".into(), source })
        })?);
        Ok(self)
    }

    /// Tells `report` of runs and cycles that take longer than their deadline, in place of the log. It is called on the
    /// watchdog's thread while they go on, and on their own when they have ended; what overruns again and again is told
    /// less and less often.
    ///
    /// A thread cannot be ended from outside. What can be done is to bring the hardware to a safe state, and to ask the
    /// core to stop.
    pub fn on_overrun(&mut self, report: impl Fn(&Overrun) + Send + Sync + 'static) {
        self.world.watchdog.report_to(Arc::new(report));
    }

    /// The same core with one more way for modules to interact; it takes part in each sync phase after those there
    /// are.
    #[must_use]
    pub fn with_mechanism<M: Mechanism>(mut self, mechanism: M) -> Self {
        self.engage(mechanism, Asked::ALWAYS);
        self
    }

    /// Adds a module that runs when it has something to do.
    ///
    /// # Errors
    /// If the name is taken, or the module's setup fails.
    pub fn add<M: Module>(&mut self, name: &str, module: M) -> Result<(), SetupError> {
        self.add_with(name, module, ModuleOptions::default())
    }

    /// Adds a module with its settings, remaps and synchrony.
    ///
    /// Under a clock that does not go on by itself, detached modules run inside the cycle.
    ///
    /// # Errors
    /// If the name is taken, the module's setup fails, or the options name what the module does not have.
    pub fn add_with<M: Module>(
        &mut self,
        name: &str,
        module: M,
        options: ModuleOptions,
    ) -> Result<(), SetupError> {
        self.admit(name, Source::once(module), options)
    }

    /// Adds a module that can be made again after a panic, as its options say; see
    /// [`Restart`](crate::Restart).
    ///
    /// # Errors
    /// Those of [`add_with`](Self::add_with).
    pub fn add_restartable<M: Module>(
        &mut self,
        name: &str,
        make: impl FnMut() -> M + Send + 'static,
        options: ModuleOptions,
    ) -> Result<(), SetupError> {
        self.admit(name, Source::factory(make), options)
    }

    /// A way to publish on a topic from threads outside the executor, through a queue that refuses what
    /// the core does not take in time.
    ///
    /// # Errors
    /// A name that is not valid, or a topic that carries another type.
    pub fn inlet<T: Send + Sync + 'static>(&mut self, topic: &str) -> Result<Inlet<T>, SetupError> {
        self.inlet_with(topic, default_queue())
    }

    /// A way to publish on a topic from threads outside the executor, through a queue of one's choice.
    ///
    /// # Errors
    /// A name that is not valid, or a topic that carries another type.
    pub fn inlet_with<T: Send + Sync + 'static>(
        &mut self,
        topic: &str,
        queue: impl Queue<T> + 'static,
    ) -> Result<Inlet<T>, SetupError> {
        open_inlet(self.stage.exclusive(), &mut self.world, topic, queue)
    }

    /// Takes the messages of a topic out of the core: calls `sink` with each, on the thread of the inbox, until the outlet is
    /// dropped.
    ///
    /// # Errors
    /// A name that is not valid, a topic that carries another type, or a thread that cannot be started.
    pub fn outlet<T: Send + Sync + 'static>(
        &mut self,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        sink: impl FnMut(Received<'_, T>) + Send + 'static,
    ) -> Result<Outlet, SetupError> {
        NewOutlet::new(topic, inbox.into(), sink).open(self.stage.exclusive(), &mut self.world)
    }

    /// As [`inlet_with`](Self::inlet_with), for messages of a type that is a value. A message of another type is logged and
    /// discarded.
    ///
    /// # Errors
    /// Those of [`inlet_with`](Self::inlet_with).
    pub fn inlet_of(
        &mut self,
        message_type: MessageType,
        topic: &str,
        queue: impl Queue<AnyMessage> + 'static,
    ) -> Result<Inlet<AnyMessage>, SetupError> {
        open_inlet_of(self.stage.exclusive(), &mut self.world, message_type, topic, queue)
    }

    /// As [`outlet`](Self::outlet), for messages of a type that is a value.
    ///
    /// # Errors
    /// Those of [`outlet`](Self::outlet).
    pub fn outlet_of(
        &mut self,
        message_type: MessageType,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Result<Outlet, SetupError> {
        let outlet = NewOutlet::of(message_type, topic, inbox.into(), sink);
        outlet.open(self.stage.exclusive(), &mut self.world)
    }

    /// Calls `then` when the core has stopped, after its modules and outlets.
    pub fn on_stop(&mut self, then: impl FnOnce() + Send + 'static) {
        self.world.at_end.push(Box::new(then));
    }

    /// A way to call a service from threads outside the executor.
    ///
    /// # Errors
    /// A name that is not valid, or a service of other types.
    pub fn caller<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        service: &str,
    ) -> Result<Caller<Q, R>, SetupError> {
        let index = self.world.services.open::<Q, R>(service, "caller")?;
        let name = Arc::clone(self.world.services.name(index));
        Ok(Caller::new(index, name, Arc::clone(&self.world.queue)))
    }

    /// Stands in for the server of a service that is not in this core: until a module serves it, calls of modules wait for what the
    /// value returned answers.
    ///
    /// # Errors
    /// A name that is not valid, or a service of other types.
    pub fn stand_in<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        service: &str,
    ) -> Result<StandIn<R>, SetupError> {
        let index = self.world.services.open::<Q, R>(service, "stand-in")?;
        self.world.services.get_mut(index).has_stand_in = true;
        Ok(StandIn::new(self.handle()))
    }

    /// Has the requests and answers of a service told as bytes in each [`ModuleEvent`](crate::ModuleEvent). Both run on the thread
    /// of the core.
    ///
    /// # Errors
    /// A name that is not valid, or a service of other types.
    pub fn encode_service<Q: Send + 'static, R: Send + 'static>(
        &mut self,
        service: &str,
        request: fn(&Q) -> Vec<u8>,
        answer: fn(&R) -> Vec<u8>,
    ) -> Result<(), SetupError> {
        let index = self.world.services.open::<Q, R>(service, "encoder")?;
        self.world.services.get_mut(index).encoder = Some(Encoder::new(request, answer));
        Ok(())
    }

    /// Holds the results of jobs back until each is released by [`CoreHandle::release_result`]: for a replay, in which the work
    /// runs again and its result joins in the cycle in which it joined when it was recorded.
    pub fn hold_results(&mut self) {
        self.world.held_results.get_or_insert_default();
    }

    /// Drops what modules ask of themselves but to leave: transitions, pauses and settings. For a replay of a detached module,
    /// which is given them in the run in which it took them over when it was recorded.
    pub fn drop_commands_to_self(&mut self) {
        self.world.drops_commands_to_self = true;
    }

    /// A way to stop the core and to change it from other threads.
    #[must_use]
    pub fn handle(&self) -> CoreHandle {
        CoreHandle { queue: Arc::clone(&self.world.queue) }
    }

    /// The topics, in the order in which they were first declared.
    pub fn topics(&self) -> impl Iterator<Item = &TopicInfo> {
        self.stage.shared.topics.infos()
    }

    /// The services, in the order in which they were first declared.
    pub fn services(&self) -> impl Iterator<Item = &ServiceInfo> {
        self.world.services.infos()
    }

    /// The modules, in the order of registration.
    #[must_use]
    pub fn modules(&self) -> Vec<ModuleInfo> {
        self.world.modules(&self.stage)
    }

    /// The mechanisms by name, in the order in which the sync phase runs them, with their versions.
    pub fn mechanisms(&self) -> impl Iterator<Item = (&'static str, Version)> {
        self.mechanisms.iter().map(|engaged| (engaged.mechanism.name(), engaged.mechanism.version()))
    }

    /// Who publishes, subscribes, serves and calls what.
    #[must_use]
    pub fn graph(&self) -> Graph {
        Graph::of(&self.stage, &self.world)
    }

    /// The settings of a module; nothing if there is no such module.
    #[must_use]
    pub fn settings(&self, module: &str) -> Option<Vec<SettingInfo>> {
        let id = self.world.members.find(module)?.id;
        Some(self.world.settings(&self.stage, id))
    }

    fn engage<M: Mechanism>(&mut self, mechanism: M, interest: Asked) {
        self.stage.exclusive().shared.offers.add(&mechanism);
        self.mechanisms.push(Engaged::new(Box::new(mechanism), interest));
    }

    fn admit(&mut self, name: &str, source: Source, options: ModuleOptions) -> Result<(), SetupError> {
        let candidate = Candidate { name: name.to_owned(), source, options };
        admit(self.stage.exclusive(), &mut self.world, candidate)
    }
}
