//! Construction and configuration of a core.

use std::sync::Arc;
use std::time::Duration;

use crate::exchange::{Messages, add_built_in};
use crate::module::{MESSAGES, ModuleCell, Place};
use crate::{
    Clock, Core, CoreHandle, Graph, Idle, Launcher, Linear, Mechanism, Overrun, RunError, Snapshot,
    SystemClock, ThreadError, Version,
};

impl Default for Core {
    fn default() -> Self {
        Self::new()
    }
}

impl Core {
    /// A core without modules, with the launcher [`Linear`] and the [`SystemClock`].
    #[must_use]
    pub fn new() -> Self {
        let mut core = Self::bare(Linear, SystemClock::new());
        let views = &mut core.stage.exclusive().views;
        add_built_in(&mut core.mechanisms, views);
        core
    }

    /// Replaces the launcher.
    #[must_use]
    pub fn with_launcher(mut self, launcher: impl Launcher + 'static) -> Self {
        self.set_launcher(launcher);
        self
    }

    /// Replaces the clock.
    ///
    /// # Panics
    /// If the core has modules or outlets, since these were set up for the previous clock.
    #[must_use]
    pub fn with_clock(mut self, clock: impl Clock + 'static) -> Self {
        let has_outlets = self.mechanisms.get::<Messages>(MESSAGES).is_some_and(Messages::has_outlets);
        let is_empty = self.state.members.is_empty() && !has_outlets;
        assert!(is_empty, "call `with_clock` before modules and outlets are added");
        self.state.clock = Arc::new(clock);
        self
    }

    /// The clock of the modules; for threads outside the core that need the same time.
    #[must_use]
    pub fn clock(&self) -> Arc<dyn Clock> {
        Arc::clone(&self.state.clock)
    }

    /// Turns off the measurement of cycles and runs, except during a requested [trace](CoreHandle::trace).
    /// Counters stay active. Saves less than one percent of a cycle's time, and 15 KiB per module.
    ///
    /// # Panics
    /// If the core has modules, since these were set up for measurement.
    #[must_use]
    pub fn without_times(mut self) -> Self {
        assert!(self.state.members.is_empty(), "call `without_times` before modules are added");
        self.state.inspector = self.state.inspector.turned_off();
        self
    }

    /// Replaces the behaviour while nothing is due.
    #[must_use]
    pub fn with_idle(mut self, idle: Idle) -> Self {
        self.idle = idle;
        self
    }

    /// Sets a deadline for each cycle; a cycle that exceeds it is reported while it is still running.
    ///
    /// # Errors
    /// If the watchdog's thread cannot be started.
    pub fn with_cycle_deadline(mut self, deadline: Duration) -> Result<Self, RunError> {
        let watch = self.state.watchdog.watch(Arc::from("the cycle"), deadline);
        self.watch = Some(watch.map_err(|source| {
            RunError::Launcher(ThreadError::Start { thread: "watchdog".into(), source })
        })?);
        Ok(self)
    }

    /// Reports runs and cycles that exceed their deadline to `report` instead of the log. `report` is called
    /// on the watchdog's thread while the run lasts, and on the run's own thread when it has ended. Repeated
    /// overruns are reported at growing intervals.
    ///
    /// A thread cannot be ended from outside. The report can bring the hardware to a safe state, and ask the
    /// core to stop.
    pub fn on_overrun(&mut self, report: impl Fn(&Overrun) + Send + Sync + 'static) {
        self.state.watchdog.report_to(Arc::new(report));
    }

    /// Adds a mechanism. It runs in each sync phase, after those added before.
    #[must_use]
    pub fn with_mechanism<M: Mechanism>(mut self, mechanism: M) -> Self {
        self.mechanisms.add(mechanism, &mut self.stage.exclusive().views);
        self
    }

    /// Calls `then` when the core has stopped, after its modules and outlets.
    pub fn on_stop(&mut self, then: impl FnOnce() + Send + 'static) {
        self.at_end.push(Box::new(then));
    }

    /// A handle to stop and change the core from other threads.
    #[must_use]
    pub fn handle(&self) -> CoreHandle {
        CoreHandle { link: Arc::clone(&self.state.link) }
    }

    /// The mechanisms by name, in the order in which the sync phase runs them, with their versions.
    pub fn mechanisms(&self) -> impl Iterator<Item = (&'static str, Version)> {
        self.mechanisms.offers().iter().map(|offer| (offer.name, offer.version))
    }

    /// The graph of modules with their publications, subscriptions, servers and clients.
    #[must_use]
    pub fn graph(&self) -> Graph {
        Graph::of(&self.stage, &self.state, &self.mechanisms)
    }

    /// The counters of modules and topics after the last cycle. From another thread:
    /// [`CoreHandle::snapshot`].
    pub fn snapshot(&mut self) -> Snapshot {
        Snapshot::of(&mut self.between_cycles())
    }

    /// What a module that runs inside the cycle shows of itself ([`Module::debug`](crate::Module::debug)), at
    /// most 64 KiB. `None` if it shows nothing, runs on a thread of its own, or is not there.
    ///
    /// ```
    /// use std::fmt;
    /// use downbeat_executor::{Core, ManualClock, Module, Setup, SetupError, Time};
    ///
    /// #[derive(Debug)]
    /// struct Counter {
    ///     count: u32,
    /// }
    ///
    /// impl Module for Counter {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.each_run(|counter, _| counter.count += 1);
    ///         Ok(())
    ///     }
    ///
    ///     fn debug(&self) -> Option<&dyn fmt::Debug> {
    ///         Some(self)
    ///     }
    /// }
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.add("counter", Counter { count: 0 })?;
    /// core.cycle()?;
    /// core.cycle()?; // The module runs for the first time.
    /// assert_eq!(core.debug("counter").unwrap(), "Counter {\n    count: 1,\n}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn debug(&self, module: &str) -> Option<String> {
        match self.state.members.find(module)?.id.place {
            Place::Attached(slot) => self.stage.cells.look(slot, ModuleCell::debug)?,
            Place::Detached(_) => None,
        }
    }
}
