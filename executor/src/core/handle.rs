//! What other threads can ask of a running core.

use std::sync::Arc;

use crate::core::world::Pause;
use crate::core::{ModuleInfo, World};
use crate::inlet::{default_queue, open_inlet, open_inlet_of};
use crate::join::{JoinQueue, Request};
use crate::management::{Candidate, Command, Look, Source};
use crate::messaging::{AnyMessage, AnyReceived, MessageType};
use crate::outlet::NewOutlet;
use crate::queue::Queue;
use crate::receipt::{Receipt, ReceiptSender, receipt};
use crate::{
    CycleTrace, Graph, Inlet, LifeEvent, LifecycleState, Listening, Module, ModuleOptions, Outlet,
    OutletInbox, Received, SettingInfo, SettingRefused, SettingValue, SetupError, Snapshot, Stage, TopicInfo,
    Transition, TransitionRefused, UnknownModule,
};

/// Asks a running core for something from any thread; from [`Core::handle`](crate::Core::handle).
///
/// What it asks for takes effect in the next sync phase. The receipt tells how it went; it may be dropped, and what
/// was refused is then not told.
///
/// ```
/// use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
///
/// struct Walker;
///
/// impl Module for Walker {
///     type Ports = ();
///
///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
///         setup.setting_in("step_length", 0.04, 0.0..=0.08, "in x of base_footprint, m")?;
///         Ok(())
///     }
/// }
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// core.add("walker", Walker)?;
/// let handle = core.handle();
/// let set = handle.set("walker", "step_length", 0.06);
/// let paused = handle.pause_module("walker");
/// let mistaken = handle.pause_module("walkre");
/// core.cycle()?; // Answers them all in its sync phase.
/// assert!(set.try_take().unwrap().is_ok());
/// assert!(paused.try_take().unwrap().is_ok());
/// assert!(mistaken.try_take().unwrap().unwrap_err().to_string().contains("walker"));
/// assert!(core.modules()[0].is_paused);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct CoreHandle {
    pub(crate) queue: Arc<JoinQueue>,
}

impl CoreHandle {
    /// Asks the core to stop after the current cycle. Safe to call from a signal-handling thread, and more
    /// than once.
    pub fn stop(&self) {
        self.queue.request_stop();
    }

    /// True if the core has been asked to stop.
    #[must_use]
    pub fn stop_is_requested(&self) -> bool {
        self.queue.stop_is_requested()
    }

    /// Has the core and its detached modules look at their clock: where time comes from somebody else, who has just
    /// moved it. Otherwise they may sleep for as long as it would have taken the machine's clock.
    ///
    /// ```
    /// use downbeat_executor::{Clock, Core, Module, Setup, SetupError, Time};
    /// use std::sync::Arc;
    /// use std::sync::atomic::{AtomicI64, Ordering};
    /// use std::sync::mpsc::{Sender, channel};
    /// use std::time::Duration;
    ///
    /// #[derive(Clone, Default)]
    /// struct OfSimulator(Arc<AtomicI64>);
    ///
    /// impl Clock for OfSimulator {
    ///     fn now(&self) -> Time {
    ///         Time::from_nanos(self.0.load(Ordering::SeqCst))
    ///     }
    ///
    ///     fn runs_by_itself(&self) -> bool {
    ///         true
    ///     }
    /// }
    ///
    /// struct Hourly(Sender<Time>);
    ///
    /// impl Module for Hourly {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.every(Duration::from_secs(3600), |hourly: &mut Self, ctx| {
    ///             let _ = hourly.0.send(ctx.now());
    ///         })
    ///     }
    /// }
    ///
    /// let clock = OfSimulator::default();
    /// let (sender, times) = channel();
    /// let mut core = Core::new().with_clock(clock.clone());
    /// core.add("hourly", Hourly(sender))?;
    /// let handle = core.handle();
    /// let running = std::thread::spawn(move || core.run());
    /// let mut seconds = 0;
    /// while times.try_recv().is_err() {
    ///     seconds += 60;
    ///     clock.0.store(seconds * 1_000_000_000, Ordering::SeqCst);
    ///     handle.clock_moved();
    /// }
    /// handle.stop();
    /// running.join().unwrap()?;
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn clock_moved(&self) {
        self.queue.announce_clock();
    }

    /// Holds the whole core, detached modules too: no cycle runs until it is resumed. Time goes on, and timers
    /// skip what they miss. Only [`Core::run`](crate::Core::run) heeds it.
    pub fn pause(&self) {
        self.look(|_, world| {
            world.pause = Pause::Paused { steps: 0 };
            world.detached.iter().flatten().for_each(|module| module.hold(true));
        });
    }

    /// Lets a core go on that was paused.
    pub fn resume(&self) {
        self.look(|_, world| {
            world.pause = Pause::Running;
            world.detached.iter().flatten().for_each(|module| module.hold(false));
        });
    }

    /// Has a paused core run one cycle; detached modules stay where they are.
    pub fn step(&self) {
        self.look(|_, world| {
            if let Pause::Paused { steps } = &mut world.pause {
                *steps += 1;
            }
        });
    }

    /// True if the core is paused.
    #[must_use = "the answer is in the receipt"]
    pub fn is_paused(&self) -> Receipt<bool> {
        self.ask(|_, world| world.pause != Pause::Running)
    }

    /// Adds a module, which runs for the first time in the next cycle.
    pub fn add<M: Module>(
        &self,
        name: &str,
        module: M,
        options: ModuleOptions,
    ) -> Receipt<Result<(), SetupError>> {
        self.add_from(name, Source::once(module), options)
    }

    /// Adds a module that can be made again after a panic, see [`Restart`](crate::Restart).
    pub fn add_restartable<M: Module>(
        &self,
        name: &str,
        make: impl FnMut() -> M + Send + 'static,
        options: ModuleOptions,
    ) -> Receipt<Result<(), SetupError>> {
        self.add_from(name, Source::factory(make), options)
    }

    /// Removes a module: its last callback runs, and everything it held is freed.
    pub fn remove(&self, module: &str) -> Receipt<Result<(), UnknownModule>> {
        let module = module.to_owned();
        self.command(|receipt| Command::Remove { module, receipt })
    }

    /// Holds a module: no callback of it runs until it is resumed. Messages pass it by, requests wait.
    pub fn pause_module(&self, module: &str) -> Receipt<Result<(), UnknownModule>> {
        let module = module.to_owned();
        self.command(|receipt| Command::Pause { module, receipt })
    }

    /// Lets a module go on that was paused.
    pub fn resume_module(&self, module: &str) -> Receipt<Result<(), UnknownModule>> {
        let module = module.to_owned();
        self.command(|receipt| Command::Resume { module, receipt })
    }

    /// Has a module run once, on what the next cycle has for it, and holds it then.
    pub fn step_module(&self, module: &str) -> Receipt<Result<(), UnknownModule>> {
        let module = module.to_owned();
        self.command(|receipt| Command::Step { module, receipt })
    }

    /// Has a module make a transition. The answer comes when it has been made, or refused.
    pub fn transition(
        &self,
        module: &str,
        transition: Transition,
    ) -> Receipt<Result<LifecycleState, TransitionRefused>> {
        let module = module.to_owned();
        self.command(|receipt| Command::Transition { module, transition, receipt })
    }

    /// Has `listener` told of each step in the life of each module, from now on and until the value returned is dropped. It
    /// is called while the module runs, on its thread, so it must hand over and return; what it does must not come back to
    /// the modules otherwise than as a message, a request or a setting.
    ///
    /// ```
    /// use downbeat_executor::{Core, LifeStep, LifecycleState, ManualClock, Module, Setup, SetupError, Time, Transition};
    /// use std::sync::mpsc::channel;
    ///
    /// struct Camera;
    ///
    /// impl Module for Camera {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("camera", Camera)?;
    /// let (sender, events) = channel();
    /// let _listening = core.handle().on_transition(move |event| drop(sender.send(event.clone())));
    /// core.cycle()?;
    /// let steps: Vec<_> = events.try_iter().map(|event| event.step).collect();
    /// let (transition, from) = (Transition::Configure, LifecycleState::Unconfigured);
    /// assert_eq!(steps[0], LifeStep::Begins { transition, from });
    /// assert_eq!(steps[3], LifeStep::Made { transition: Transition::Activate, to: LifecycleState::Active });
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn on_transition(&self, listener: impl Fn(&LifeEvent) + Send + Sync + 'static) -> Listening {
        self.queue.listeners.add(listener)
    }

    /// Has the result of a job join in the next sync phase, or when it comes if that is later; see
    /// [`Core::hold_results`](crate::Core::hold_results). `job` is the position of the job among those that the module declared,
    /// `number` counts what the module asked of it.
    pub fn release_result(&self, module: &str, job: u32, number: u64) {
        let module = module.into();
        self.look(move |_, world| {
            if let Some(held) = &mut world.held_results {
                held.releases.push((module, job, number));
            }
        });
    }

    /// Changes a setting of a module.
    pub fn set(
        &self,
        module: &str,
        setting: &str,
        value: impl Into<SettingValue>,
    ) -> Receipt<Result<(), SettingRefused>> {
        let (module, setting, value) = (module.to_owned(), setting.to_owned(), value.into());
        self.command(|receipt| Command::Set { module, setting, value, receipt })
    }

    /// Gives `to` the values of the settings of `from`, see
    /// [`Context::transfer_settings`](crate::Context::transfer_settings).
    pub fn transfer_settings(&self, from: &str, to: &str) -> Receipt<Result<(), SettingRefused>> {
        let (from, to) = (from.to_owned(), to.to_owned());
        self.command(|receipt| Command::Transfer { from, to, receipt })
    }

    /// The settings of a module with their values; nothing if there is no such module.
    #[must_use = "the answer is in the receipt"]
    pub fn settings(&self, module: &str) -> Receipt<Option<Vec<SettingInfo>>> {
        let module = module.to_owned();
        self.ask(move |stage, world| {
            let id = world.members.find(&module)?.id;
            Some(world.settings(stage, id))
        })
    }

    /// A way to publish on a topic from threads outside the executor, as [`Core::inlet`](crate::Core::inlet).
    #[must_use = "the answer is in the receipt"]
    pub fn inlet<T: Send + Sync + 'static>(&self, topic: &str) -> Receipt<Result<Inlet<T>, SetupError>> {
        self.inlet_with(topic, default_queue())
    }

    /// A way to publish on a topic from threads outside the executor, made while the core runs: behind those that were
    /// made before.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Time};
    /// use downbeat_executor::queue::{Locked, Overflow};
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.cycle()?;
    /// let queue = Locked::bounded(std::num::NonZeroUsize::MIN, Overflow::DropOldest);
    /// let receipt = core.handle().inlet_with::<f64>("range", queue); // m
    /// core.cycle()?; // Makes it in its sync phase.
    /// let range = receipt.try_take().unwrap()?;
    /// range.publish(1.25)?;
    /// core.cycle()?;
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "range").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use = "the answer is in the receipt"]
    pub fn inlet_with<T: Send + Sync + 'static>(
        &self,
        topic: &str,
        queue: impl Queue<T> + 'static,
    ) -> Receipt<Result<Inlet<T>, SetupError>> {
        let topic = topic.to_owned();
        self.ask(move |stage, world| open_inlet(stage, world, &topic, queue))
    }

    /// Takes the messages of a topic out of the core, see [`Core::outlet`](crate::Core::outlet): from the cycle on in whose sync
    /// phase it is made, that cycle's messages included.
    #[must_use = "the answer is in the receipt"]
    pub fn outlet<T: Send + Sync + 'static>(
        &self,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        sink: impl FnMut(Received<'_, T>) + Send + 'static,
    ) -> Receipt<Result<Outlet, SetupError>> {
        self.open_outlet(NewOutlet::new(topic, inbox.into(), sink))
    }

    /// As [`inlet_with`](Self::inlet_with), for messages of a type that is a value; see [`Core::inlet_of`](crate::Core::inlet_of).
    #[must_use = "the answer is in the receipt"]
    pub fn inlet_of(
        &self,
        message_type: MessageType,
        topic: &str,
        queue: impl Queue<AnyMessage> + 'static,
    ) -> Receipt<Result<Inlet<AnyMessage>, SetupError>> {
        let topic = topic.to_owned();
        self.ask(move |stage, world| open_inlet_of(stage, world, message_type, &topic, queue))
    }

    /// As [`outlet`](Self::outlet), for messages of a type that is a value.
    #[must_use = "the answer is in the receipt"]
    pub fn outlet_of(
        &self,
        message_type: MessageType,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Receipt<Result<Outlet, SetupError>> {
        self.open_outlet(NewOutlet::of(message_type, topic, inbox.into(), sink))
    }

    /// The topics, in the order in which they were first declared.
    #[must_use = "the answer is in the receipt"]
    pub fn topics(&self) -> Receipt<Vec<TopicInfo>> {
        self.ask(|stage, _| stage.shared.topics.infos().cloned().collect())
    }

    /// What is known of the modules, in the order of registration.
    #[must_use = "the answer is in the receipt"]
    pub fn modules(&self) -> Receipt<Vec<ModuleInfo>> {
        self.ask(|stage, world| world.modules(stage))
    }

    /// What the core counted and measured, between two cycles.
    #[must_use = "the answer is in the receipt"]
    pub fn snapshot(&self) -> Receipt<Snapshot> {
        self.ask(Snapshot::of)
    }

    /// What runs in the next cycles, at least one. The answer comes when they have run; see
    /// [`finish_trace`](Self::finish_trace).
    #[must_use = "the answer is in the receipt"]
    pub fn trace(&self, cycles: u32) -> Receipt<CycleTrace> {
        let (answer, trace) = receipt();
        self.look(move |_, world| world.inspector.trace(cycles, answer));
        trace
    }

    /// Has a trace answered with what there is: for a core in which no more cycles may come soon.
    pub fn finish_trace(&self) {
        self.look(|_, world| world.inspector.finish_trace());
    }

    /// Who publishes, subscribes, serves and calls what.
    #[must_use = "the answer is in the receipt"]
    pub fn graph(&self) -> Receipt<Graph> {
        self.ask(|stage, world| Graph::of(stage, world))
    }

    fn add_from(
        &self,
        name: &str,
        source: Source,
        options: ModuleOptions,
    ) -> Receipt<Result<(), SetupError>> {
        let candidate = Box::new(Candidate { name: name.to_owned(), source, options });
        self.command(|receipt| Command::Add { candidate, receipt })
    }

    fn open_outlet(&self, outlet: NewOutlet) -> Receipt<Result<Outlet, SetupError>> {
        self.ask(move |stage, world| outlet.open(stage, world))
    }

    fn command<T>(&self, command: impl FnOnce(Option<ReceiptSender<T>>) -> Command) -> Receipt<T> {
        let (sender, receipt) = receipt();
        if !self.queue.is_closed() {
            self.queue.push(Request::Command(command(Some(sender))));
        }
        receipt
    }

    fn ask<T: Send + 'static>(
        &self,
        look: impl FnOnce(&mut Stage, &mut World) -> T + Send + 'static,
    ) -> Receipt<T> {
        let (sender, receipt) = receipt();
        self.look(move |stage, world| sender.send(look(stage, world)));
        receipt
    }

    pub(crate) fn look(&self, look: impl FnOnce(&mut Stage, &mut World) + Send + 'static) {
        self.look_in(Box::new(look));
    }

    fn look_in(&self, look: Look) {
        if !self.queue.is_closed() {
            self.queue.push(Request::Command(Command::Look(look)));
        }
    }
}
