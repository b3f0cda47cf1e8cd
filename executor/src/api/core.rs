//! How a core is made and configured.

use std::sync::Arc;
use std::time::Duration;

use crate::exchange::{Messages, add_built_in};
use crate::module::MESSAGES;
use crate::{
    Clock, Core, CoreHandle, Graph, Idle, Launcher, Linear, Mechanism, Overrun, RunError, SystemClock,
    ThreadError, Version,
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

    /// The same core with another launcher.
    #[must_use]
    pub fn with_launcher(mut self, launcher: impl Launcher + 'static) -> Self {
        self.set_launcher(launcher);
        self
    }

    /// The same core with another clock.
    ///
    /// # Panics
    /// If the core has modules or outlets: they were set up for the clock it had.
    #[must_use]
    pub fn with_clock(mut self, clock: impl Clock + 'static) -> Self {
        let has_outlets = self.mechanisms.get::<Messages>(MESSAGES).is_some_and(Messages::has_outlets);
        let is_empty = self.state.members.is_empty() && !has_outlets;
        assert!(is_empty, "give a core its clock before its modules and outlets");
        self.state.clock = Arc::new(clock);
        self
    }

    /// The clock from which modules have their time; for a thread beside the core that has to keep the same.
    #[must_use]
    pub fn clock(&self) -> Arc<dyn Clock> {
        Arc::clone(&self.state.clock)
    }

    /// The same core, which does not take the times of cycles and runs unless a [trace](CoreHandle::trace) is asked for.
    /// It counts all the same. Saves less than a hundredth of the time a cycle takes, and 15 KiB per module.
    ///
    /// # Panics
    /// If the core has modules: they were made to be measured.
    #[must_use]
    pub fn without_times(mut self) -> Self {
        assert!(self.state.members.is_empty(), "tell a core what to measure before its modules");
        self.state.inspector = self.state.inspector.turned_off();
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
        let watch = self.state.watchdog.watch(Arc::from("the cycle"), deadline);
        self.watch = Some(watch.map_err(|source| {
            RunError::Launcher(ThreadError::Start { thread: "watchdog".into(), source })
        })?);
        Ok(self)
    }

    /// Reports runs and cycles that exceed their deadline to `report` instead of the log. It is called on the watchdog's
    /// thread while they are running, and on their own thread when they have ended; repeated overruns are reported less
    /// and less often.
    ///
    /// A thread cannot be ended from outside. What can be done is to bring the hardware to a safe state, and to ask the
    /// core to stop.
    pub fn on_overrun(&mut self, report: impl Fn(&Overrun) + Send + Sync + 'static) {
        self.state.watchdog.report_to(Arc::new(report));
    }

    /// The same core with one more way for modules to interact; it takes part in each sync phase after those there
    /// are.
    #[must_use]
    pub fn with_mechanism<M: Mechanism>(mut self, mechanism: M) -> Self {
        self.mechanisms.add(mechanism, &mut self.stage.exclusive().views);
        self
    }

    /// Calls `then` when the core has stopped, after its modules and outlets.
    pub fn on_stop(&mut self, then: impl FnOnce() + Send + 'static) {
        self.at_end.push(Box::new(then));
    }

    /// A way to stop the core and to change it from other threads.
    #[must_use]
    pub fn handle(&self) -> CoreHandle {
        CoreHandle { link: Arc::clone(&self.state.link) }
    }

    /// The mechanisms by name, in the order in which the sync phase runs them, with their versions.
    pub fn mechanisms(&self) -> impl Iterator<Item = (&'static str, Version)> {
        self.mechanisms.offers().iter().map(|offer| (offer.name, offer.version))
    }

    /// Which modules publish, subscribe, serve and call what.
    #[must_use]
    pub fn graph(&self) -> Graph {
        Graph::of(&self.stage, &self.state, &self.mechanisms)
    }
}
