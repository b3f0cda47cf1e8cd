//! The management of modules for modules and programs: functions of [`Context`], [`Core`] and [`CoreHandle`].

use super::admission::{Candidate, admit, admit_stopped};
use super::{Change, Command, Modules, ModulesPort, RestartRefused, UnknownModule};
use crate::cycle::Source;
use crate::module::{Hold, MODULES};
use crate::threads::{ReceiptSender, receipt};
use crate::{
    Context, Core, CoreHandle, LifecycleState, Module, ModuleInfo, ModuleOptions, Receipt, SetupError,
    SyncPhase, Transition, TransitionRefused,
};

impl<P> Context<'_, P> {
    /// Adds a module, which runs for the first time in the next cycle. Errors are logged.
    pub fn add<M: Module>(&mut self, name: &str, module: M, options: ModuleOptions) {
        let candidate = Candidate { name: name.to_owned(), source: Source::once(module), options };
        self.command(Command::Add { candidate: Box::new(candidate), fallback: None, receipt: None });
    }

    /// Removes this module and adds the module constructed by `make` under the same name, in one sync phase;
    /// for a new version of a module. If the setup of the new module fails, the error is logged and the
    /// module constructed by `fallback` is added.
    ///
    /// Both can be restarted. The new module is the last in the order of registration. Messages waiting in
    /// the inbox of a detached module are dropped.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// /// Counts its versions.
    /// struct Planner(u32);
    ///
    /// impl Module for Planner {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         if self.0 == 3 {
    ///             return Err(setup.refuse("there is no version 3"));
    ///         }
    ///         let version = setup.publish::<u32>("version")?;
    ///         setup.subscribe::<(), _>("next", move |planner, _, ctx| {
    ///             let current = planner.0;
    ///             ctx.replace_self(ModuleOptions::default(), move || Planner(current + 1), move || Planner(current));
    ///         })?;
    ///         setup.subscribe::<(), _>("ask", move |planner, _, ctx| ctx.publish(version, planner.0))
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("planner", Planner(1))?;
    /// let (sender, versions) = std::sync::mpsc::channel();
    /// let _outlet = core.outlet("version", downbeat_executor::Inbox::KeepAll, move |version| drop(sender.send(*version)))?;
    /// let (next, ask) = (core.inlet("next")?, core.inlet("ask")?);
    /// for _ in 0..2 {
    ///     next.publish(())?;
    ///     (0..2).try_for_each(|_| core.cycle())?;
    ///     ask.publish(())?;
    ///     (0..3).try_for_each(|_| core.cycle())?;
    /// }
    /// assert_eq!(versions.try_iter().collect::<Vec<u32>>(), [2, 2]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn replace_self<M: Module>(
        &mut self,
        options: ModuleOptions,
        make: impl FnMut() -> M + Send + 'static,
        fallback: impl FnMut() -> M + Send + 'static,
    ) {
        let name = self.module_name().to_owned();
        let candidate = |source, options| Box::new(Candidate { name: name.clone(), source, options });
        let fallback = candidate(Source::factory(fallback), options.clone());
        let candidate = candidate(Source::factory(make), options);
        self.remove(&name);
        self.command(Command::Add { candidate, fallback: Some(fallback), receipt: None });
    }

    /// Removes a module, this one or another. Its last callback runs in this cycle's sync phase, and its
    /// resources are freed.
    pub fn remove(&mut self, module: &str) {
        self.change(module, Change::Remove);
    }

    /// Removes this module, see [`remove`](Self::remove).
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    /// /// Done as soon as it has run.
    /// struct Calibration;
    ///
    /// impl Module for Calibration {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.each_run(|_, ctx| ctx.remove_self());
    ///         Ok(())
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("calibration", Calibration)?;
    /// core.cycle()?;
    /// assert!(core.modules().is_empty());
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn remove_self(&mut self) {
        let name = self.module_name().to_owned();
        self.remove(&name);
    }

    /// Requests a transition of a module in the next cycle. A transition that is invalid in the module's
    /// state is logged.
    pub fn transition(&mut self, module: &str, transition: Transition) {
        self.command(Command::Transition { module: module.to_owned(), transition, receipt: None });
    }

    /// Pauses a module: none of its callbacks runs until it is resumed. Messages to it are dropped, requests
    /// wait.
    pub fn pause(&mut self, module: &str) {
        self.change(module, Change::Hold(Hold::Held));
    }

    /// Resumes a paused module.
    pub fn resume(&mut self, module: &str) {
        self.change(module, Change::Hold(Hold::Free));
    }

    fn change(&mut self, module: &str, change: Change) {
        self.command(Command::Change { module: module.to_owned(), change, receipt: None });
    }

    fn command(&mut self, command: Command) {
        self.io().ask(MODULES);
        self.io().open_own::<ModulesPort>(MODULES).0.push(command);
    }
}

impl Core {
    /// Adds a module that runs when it has something to do.
    ///
    /// # Errors
    /// If the name is taken, or the module's setup fails.
    pub fn add<M: Module>(&mut self, name: &str, module: M) -> Result<(), SetupError> {
        self.add_with(name, module, ModuleOptions::default())
    }

    /// Adds a module with its settings, remaps and synchrony.
    ///
    /// Under a clock that does not run by itself, detached modules run inside the cycle.
    ///
    /// # Errors
    /// If the name is taken, the module's setup fails, or the options name a topic or setting that the module
    /// does not have.
    pub fn add_with<M: Module>(
        &mut self,
        name: &str,
        module: M,
        options: ModuleOptions,
    ) -> Result<(), SetupError> {
        self.admit(name, Source::once(module), options)
    }

    /// Adds a module that can be restarted after a panic, according to its options; see
    /// [`Restart`](crate::Restart).
    ///
    /// # Errors
    /// As for [`add_with`](Self::add_with).
    pub fn add_restartable<M: Module>(
        &mut self,
        name: &str,
        make: impl FnMut() -> M + Send + 'static,
        options: ModuleOptions,
    ) -> Result<(), SetupError> {
        self.admit(name, Source::factory(make), options)
    }

    /// Adds a restartable module in the stopped state, with a reason. [`CoreHandle::restart`] constructs it.
    ///
    /// # Errors
    /// If the name is taken, or the core has stopped.
    pub fn add_stopped<M: Module>(
        &mut self,
        name: &str,
        make: impl FnMut() -> M + Send + 'static,
        options: ModuleOptions,
        reason: &str,
    ) -> Result<(), SetupError> {
        let candidate = Candidate { name: name.to_owned(), source: Source::factory(make), options };
        admit_stopped(&mut self.between_cycles(), candidate, reason)
    }

    /// Drops modules' requests to themselves except for their removal: transitions, pauses and settings. This
    /// is for a replay of a detached module, which receives the recorded requests in the runs in which they
    /// took effect.
    pub fn drop_commands_to_self(&mut self) {
        self.state.drops_commands_to_self = true;
    }

    /// The modules, in the order of registration.
    #[must_use]
    pub fn modules(&self) -> Vec<ModuleInfo> {
        self.state.modules(&self.stage)
    }

    fn admit(&mut self, name: &str, source: Source, options: ModuleOptions) -> Result<(), SetupError> {
        admit(&mut self.between_cycles(), Candidate { name: name.to_owned(), source, options })
    }
}

impl CoreHandle {
    /// Adds a module, which runs for the first time in the next cycle.
    pub fn add<M: Module>(
        &self,
        name: &str,
        module: M,
        options: ModuleOptions,
    ) -> Receipt<Result<(), SetupError>> {
        self.add_from(name, Source::once(module), options)
    }

    /// Adds a module that can be restarted after a panic, see [`Restart`](crate::Restart).
    pub fn add_restartable<M: Module>(
        &self,
        name: &str,
        make: impl FnMut() -> M + Send + 'static,
        options: ModuleOptions,
    ) -> Receipt<Result<(), SetupError>> {
        self.add_from(name, Source::factory(make), options)
    }

    /// Removes a module: its last callback runs, and its resources are freed.
    pub fn remove(&self, module: &str) -> Receipt<Result<(), UnknownModule>> {
        self.change(module, Change::Remove)
    }

    /// Pauses a module: none of its callbacks runs until it is resumed. Messages to it are dropped, requests
    /// wait.
    pub fn pause_module(&self, module: &str) -> Receipt<Result<(), UnknownModule>> {
        self.change(module, Change::Hold(Hold::Held))
    }

    /// Resumes a paused module.
    pub fn resume_module(&self, module: &str) -> Receipt<Result<(), UnknownModule>> {
        self.change(module, Change::Hold(Hold::Free))
    }

    /// Runs a module once, with the input of the next cycle, and then pauses it.
    pub fn step_module(&self, module: &str) -> Receipt<Result<(), UnknownModule>> {
        self.change(module, Change::Hold(Hold::Step))
    }

    /// Restarts a module that has panicked or is not active, with the closure with which it was added.
    /// Ignores its [restart policy](crate::Restart) and back-off. If the restart fails, the module stays
    /// stopped and can be restarted later.
    ///
    /// ```
    /// # use downbeat_executor::{Core, LifecycleState, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
    /// struct Camera;
    ///
    /// impl Module for Camera {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.subscribe::<(), _>("pull", |_, _, _| panic!("the cable came loose"))
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add_restartable("camera", || Camera, ModuleOptions::default())?;
    /// core.inlet("pull")?.publish(())?;
    /// (0..3).try_for_each(|_| core.cycle())?;
    /// assert_eq!(core.modules()[0].state, LifecycleState::Finalized);
    /// drop(core.handle().restart("camera"));
    /// (0..2).try_for_each(|_| core.cycle())?;
    /// assert_eq!(core.modules()[0].state, LifecycleState::Active);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn restart(&self, module: &str) -> Receipt<Result<(), RestartRefused>> {
        let module = module.to_owned();
        self.command(|receipt| Command::Restart { module, receipt })
    }

    /// Requests a transition of a module. The receipt is answered when the transition is made or refused.
    pub fn transition(
        &self,
        module: &str,
        transition: Transition,
    ) -> Receipt<Result<LifecycleState, TransitionRefused>> {
        let module = module.to_owned();
        self.command(|receipt| Command::Transition { module, transition, receipt })
    }

    /// The descriptions of the modules, in the order of registration.
    #[must_use = "the answer is in the receipt"]
    pub fn modules(&self) -> Receipt<Vec<ModuleInfo>> {
        self.ask(|phase| phase.state.modules(phase.stage))
    }

    fn add_from(
        &self,
        name: &str,
        source: Source,
        options: ModuleOptions,
    ) -> Receipt<Result<(), SetupError>> {
        let candidate = Box::new(Candidate { name: name.to_owned(), source, options });
        self.command(|receipt| Command::Add { candidate, fallback: None, receipt })
    }

    fn change(&self, module: &str, change: Change) -> Receipt<Result<(), UnknownModule>> {
        let module = module.to_owned();
        self.command(|receipt| Command::Change { module, change, receipt })
    }

    fn command<T>(&self, command: impl FnOnce(Option<ReceiptSender<T>>) -> Command) -> Receipt<T> {
        let (sender, receipt) = receipt();
        self.post(command(Some(sender)));
        receipt
    }

    fn post(&self, command: Command) {
        if !self.link.is_closed() {
            self.link.post(MODULES, move |modules: &mut Modules| modules.commands.push((None, command)));
        }
    }

    /// Calls `look` with the core in the next sync phase, in the order of the other commands.
    pub(crate) fn look(&self, look: impl FnOnce(&mut SyncPhase<'_>) + Send + 'static) {
        self.post(Command::Look(Box::new(look)));
    }

    /// As [`look`](Self::look), with an answer.
    pub(crate) fn ask<T: Send + 'static>(
        &self,
        look: impl FnOnce(&mut SyncPhase<'_>) -> T + Send + 'static,
    ) -> Receipt<T> {
        let (sender, receipt) = receipt();
        self.look(move |phase| sender.send(look(phase)));
        receipt
    }
}
