//! The core: owns the modules and the mechanisms, and runs the cycles.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::time::{Duration, Instant};

use crossbeam::sync::Parker;

use super::agenda::{Asker, Ready};
use super::detached::DetachedModule;
use super::phase::{Mechanisms, SyncPhase};
use super::stage::{Launcher, StageHolder};
use super::state::{CoreLife, CoreState, Pause};
use crate::module::{Input, Link, Place};
use crate::observe::{CycleInfo, Measuring, spans_are_on};
use crate::threads::{PromptTimers, Watch, end_of, reason};
use crate::{Role, ThreadError, Time, TraceCause};

/// Errors of [`Core::run`] and [`Core::cycle`].
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The clock advances only when it is set.
    #[error("this clock does not run by itself; set it and call `cycle`, or use a clock that runs")]
    ClockStandsStill,
    /// The core was stopped.
    #[error("this core has stopped and cannot be restarted; create a new one")]
    Stopped,
    /// The core's thread, or a thread of its launcher, cannot run as configured.
    #[error(transparent)]
    Launcher(#[from] ThreadError),
    /// The thread of a detached module cannot start, or cannot run as configured.
    #[error("detached module \"{module}\": {source}")]
    Thread {
        /// The module.
        module: String,
        /// The error of the system.
        source: ThreadError,
    },
}

/// How [`Core::run`] waits while nothing is due.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Idle {
    /// The thread sleeps until the next event.
    #[default]
    Park,
    /// The thread polls. It reacts a few microseconds sooner, and keeps a processor busy.
    Spin,
}

/// Owns the modules of a robot and runs them in cycles. A cycle is a process phase, in which modules run, and
/// a sync phase, in which their requests take effect.
pub struct Core {
    pub(crate) stage: StageHolder,
    pub(crate) state: CoreState,
    pub(crate) mechanisms: Mechanisms,
    launcher: Box<dyn Launcher>,
    /// True if the launcher runs all modules on the core's thread.
    is_linear: bool,
    pub(crate) idle: Idle,
    /// Measures the whole cycle.
    pub(crate) watch: Option<Watch>,
    /// Called when the core has stopped.
    pub(crate) at_end: Vec<Box<dyn FnOnce() + Send>>,
    parker: Parker,
    /// The time of the last cycle.
    last_now: Time,
    /// True if the core slept before the cycle.
    has_slept: bool,
}

/// Limits the speed of simulated time.
struct Pace {
    speed: f64,
    /// A simulated time, and the instant at which it was reached.
    reached: Option<(Time, Instant)>,
}

impl Pace {
    /// A cycle later than this does not catch up.
    const LATE: Duration = Duration::from_millis(100);

    fn new(speed: f64) -> Self {
        Self { speed, reached: None }
    }

    /// The remaining wait until this time; `None` if it has come.
    fn early(&mut self, at: Time) -> Option<Duration> {
        let now = Instant::now();
        let &mut (from, since) = self.reached.get_or_insert((at, now));
        let passed = Duration::try_from_secs_f64(at.saturating_since(from).as_secs_f64() / self.speed);
        let due = since.checked_add(passed.unwrap_or(Duration::MAX));
        match due.map(|due| (due.saturating_duration_since(now), now.saturating_duration_since(due))) {
            Some((Duration::ZERO, late)) => {
                if late > Self::LATE {
                    self.reached = Some((at, now));
                }
                None
            }
            Some((early, _)) => Some(early),
            None => Some(Duration::from_secs(1)),
        }
    }
}

impl Core {
    /// A core without mechanisms.
    pub(crate) fn bare(launcher: impl Launcher + 'static, clock: impl crate::Clock + 'static) -> Self {
        let parker = Parker::new();
        let link = Arc::new(Link::new(parker.unparker().clone()));
        Self {
            stage: StageHolder::Own(Box::default()),
            state: CoreState::new(Arc::new(clock), link),
            mechanisms: Mechanisms::default(),
            is_linear: launcher.is_linear(),
            launcher: Box::new(launcher),
            idle: Idle::default(),
            watch: None,
            at_end: Vec::new(),
            parker,
            last_now: Time::from_nanos(i64::MIN),
            has_slept: false,
        }
    }

    pub(crate) fn set_launcher(&mut self, launcher: impl Launcher + 'static) {
        self.is_linear = launcher.is_linear();
        self.launcher = Box::new(launcher);
    }

    /// A view of the core for mechanisms, between two cycles.
    pub(crate) fn between_cycles(&mut self) -> SyncPhase<'_> {
        let stage = self.stage.exclusive();
        SyncPhase::between_cycles(stage, &mut self.state, &mut self.mechanisms, self.last_now)
    }

    /// Runs cycles until [`CoreHandle::stop`](crate::CoreHandle::stop) is called, then stops the modules.
    /// Sleeps while nothing is due, unless [`Idle::Spin`] is set.
    ///
    /// # Errors
    /// If the clock does not advance by itself, a thread cannot be started, or the core was stopped before.
    pub fn run(&mut self) -> Result<(), RunError> {
        if !self.state.clock.runs_by_itself() {
            return Err(RunError::ClockStandsStill);
        }
        let _timers = PromptTimers::start();
        while !self.state.link.stop_is_requested() {
            match &mut self.state.pause {
                Pause::Paused { steps: 0 } => self.attend(),
                Pause::Paused { steps } => {
                    *steps -= 1;
                    self.cycle()?;
                }
                Pause::Running => {
                    self.cycle()?;
                    self.wait();
                }
            }
        }
        self.stop();
        Ok(())
    }

    /// Runs as [`Core::run`], in simulated time. `clock`, which must be the core's clock, stands still while
    /// modules run, and is then set to the time of the next event, so that time passes as fast as the work is
    /// done. The same input gives the same run. Ends before the first event at or after `end`.
    ///
    /// ```
    /// use std::time::Duration;
    /// use downbeat_executor::{Clock, Core, ManualClock, Module, Setup, SetupError, Time};
    ///
    /// struct Hourly;
    ///
    /// impl Module for Hourly {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.every(Duration::from_secs(3600), |_, _| ())
    ///     }
    /// }
    ///
    /// let clock = ManualClock::new(Time::ZERO);
    /// let mut core = Core::new().with_clock(clock.clone());
    /// core.add("hourly", Hourly)?;
    /// let day = Time::ZERO + Duration::from_secs(24 * 3600);
    /// core.run_simulated(&clock, Some(day))?; // Takes no time.
    /// assert_eq!(clock.now(), day);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// A core that is [stopped](CoreHandle::stop) earlier leaves the clock at the time of the stop:
    ///
    /// ```
    /// # use downbeat_executor::{Clock, Core, ManualClock, Module, Setup, SetupError, Time};
    /// # use std::time::Duration;
    /// # struct Impatient(downbeat_executor::CoreHandle);
    /// # impl Module for Impatient {
    /// #     type Ports = ();
    /// #     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    /// #         setup.every(Duration::from_secs(2), |module, _| module.0.stop())
    /// #     }
    /// # }
    /// # let clock = ManualClock::new(Time::ZERO);
    /// # let mut core = Core::new().with_clock(clock.clone());
    /// # core.add("impatient", Impatient(core.handle()))?; // stops it after 2 s
    /// core.run_simulated(&clock, Some(Time::ZERO + Duration::from_secs(60)))?;
    /// assert_eq!(clock.now(), Time::ZERO + Duration::from_secs(2));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// If a thread cannot be started, or the core was stopped before.
    pub fn run_simulated(&mut self, clock: &crate::ManualClock, end: Option<Time>) -> Result<(), RunError> {
        self.run_simulated_at(clock, end, None)
    }

    /// Runs as [`Core::run_simulated`], but not faster than at this speed: 1 is real time, 2 is twice as
    /// fast. The results are the same. Time that is lost because the machine is too slow is not made up for.
    ///
    /// # Errors
    /// As for [`Core::run_simulated`].
    pub fn run_simulated_at(
        &mut self,
        clock: &crate::ManualClock,
        end: Option<Time>,
        speed: Option<f64>,
    ) -> Result<(), RunError> {
        let mut pace = speed.map(Pace::new);
        while !self.state.link.stop_is_requested() {
            match &mut self.state.pause {
                Pause::Paused { steps: 0 } => {
                    self.attend();
                    pace = speed.map(Pace::new);
                    continue;
                }
                Pause::Paused { steps } => *steps -= 1,
                Pause::Running => {
                    let next = self.next_event().filter(|at| end.is_none_or(|end| *at < end));
                    if let (Some(pace), Some(at)) = (&mut pace, next)
                        && let Some(early) = pace.early(at)
                    {
                        self.parker.park_timeout(early);
                        continue;
                    }
                }
            }
            match self.next_event() {
                Some(at) if end.is_none_or(|end| at < end) => {
                    clock.set(at);
                    self.cycle()?;
                }
                Some(_) => break,
                None => match end {
                    Some(_) => break,
                    None => self.parker.park(),
                },
            }
        }
        if let Some(end) = end
            && !self.state.link.stop_is_requested()
        {
            clock.set(end);
        }
        self.stop();
        Ok(())
    }

    /// Runs one cycle at the current time of the clock. The first cycle starts the modules.
    ///
    /// # Errors
    /// If a thread of a detached module cannot be started, or the core was stopped.
    pub fn cycle(&mut self) -> Result<(), RunError> {
        if self.state.life != CoreLife::Running {
            self.start()?;
        }
        if self.state.link.take_clock_announcement() {
            self.state.detached.iter().flatten().for_each(DetachedModule::wake);
        }
        let now = self.state.clock.now();
        if now < self.last_now {
            self.go_back(now);
        }
        self.last_now = now;
        let measuring = self.state.inspector.begin();
        if measuring.is_on() || self.watch.is_some() || spans_are_on() {
            self.observed_cycle(now, measuring);
        } else {
            self.process_and_sync(now);
        }
        self.has_slept = false;
        Ok(())
    }

    #[cold]
    fn observed_cycle(&mut self, now: Time, measuring: Measuring) {
        let cycle = self.state.cycle;
        let _span = tracing::trace_span!("cycle", number = cycle, time = %now).entered();
        if let Some(watch) = &self.watch {
            watch.begin();
        }
        self.stage.exclusive().measuring = measuring;
        let due = if measuring.is_on() { self.earliest_due() } else { Time::MAX };
        let fresh: Vec<_> = match measuring {
            Measuring::Trace => {
                self.stage.views.topics.fresh().map(|(slot, topic)| (slot, Arc::clone(topic))).collect()
            }
            Measuring::Times | Measuring::Nothing => Vec::new(),
        };
        self.process_and_sync(now);
        if let Some(watch) = &self.watch {
            watch.end();
        }
        if measuring.is_on() {
            let lateness = (due <= now).then(|| now.saturating_since(due));
            self.take_readings(CycleInfo { cycle, lateness, has_slept: self.has_slept }, &fresh);
        }
    }

    /// The time of the next event: now, the time of a timer, or `None` if the core only waits for input.
    #[must_use]
    pub fn next_event(&mut self) -> Option<Time> {
        let has_to_start = self.state.life == CoreLife::New && !self.state.members.is_empty();
        if self.state.life == CoreLife::Stopped {
            return None;
        }
        if self.has_work() || has_to_start {
            return Some(self.state.clock.now());
        }
        Some(self.earliest_due()).filter(|&due| due < Time::MAX)
    }

    #[cold]
    fn start(&mut self) -> Result<(), RunError> {
        if self.state.life == CoreLife::Stopped {
            return Err(RunError::Stopped);
        }
        // A core that fails to start stays stopped, since some of its threads may be missing.
        let started = self.start_threads();
        self.state.life = if started.is_ok() { CoreLife::Running } else { CoreLife::Stopped };
        started
    }

    fn start_threads(&mut self) -> Result<(), RunError> {
        self.launcher.attach()?;
        self.between_cycles().each_mechanism(|mechanism, phase| mechanism.started(phase));
        let CoreState { detached, clock, link, pause, .. } = &mut self.state;
        detached.iter_mut().flatten().try_for_each(|module| {
            let started = module.start(clock, link, *pause != Pause::Running);
            started.map_err(|source| RunError::Thread { module: module.name.to_string(), source })
        })
    }

    /// Restarts the timers after an external clock has gone back. Detached modules notice the change
    /// themselves.
    #[cold]
    fn go_back(&mut self, now: Time) {
        let by = self.last_now.saturating_since(now).as_secs_f64();
        tracing::warn!("the clock went back by {by} s to {now}: timers restart from there");
        let stage = self.stage.exclusive();
        for slot in 0..stage.cells.slots() {
            if let Some(cell) = stage.cells.get(slot) {
                cell.go_back(now);
                self.state.agenda.wake_at(slot, cell.next_due());
            }
        }
    }

    /// `fresh` lists the topics that carried messages in a traced cycle, by the slots of the receiving
    /// modules.
    fn take_readings(&mut self, info: CycleInfo, fresh: &[(usize, Arc<str>)]) {
        let stage = self.stage.exclusive();
        stage.measuring = Measuring::Nothing;
        self.state.inspector.synced();
        for nth in 0..stage.runnable.len() {
            let Ready { slot, causes, .. } = stage.runnable[nth];
            // A module that was removed in this cycle has no cell any more.
            if let Some(cell) = stage.cells.get(slot)
                && let Some(span) = cell.span.take()
            {
                let causes = || {
                    let topics = fresh.iter().filter(|(receiver, _)| *receiver == slot);
                    let messages = topics.map(|(_, topic)| TraceCause::Messages(Arc::clone(topic)));
                    messages.chain(causes.traced()).collect()
                };
                self.state.inspector.ran(&mut cell.meter, &cell.io.name, info.cycle, &span, causes);
            }
        }
        self.state.inspector.end(info);
    }

    #[inline(always)]
    fn process_and_sync(&mut self, now: Time) {
        if !self.mechanisms.begin.is_empty() {
            self.process_begins();
        }
        let stage = if self.is_linear {
            let stage = self.stage.exclusive();
            stage.begin(now);
            self.state.agenda.take(now, &mut stage.runnable);
            match stage.measuring {
                Measuring::Nothing => stage.run_each(|_| ()),
                measuring => stage.run_each_measured(measuring),
            }
            stage
        } else {
            self.process(now);
            self.stage.exclusive()
        };
        SyncPhase::new(stage, &mut self.state, &mut self.mechanisms, now).run();
        if !self.state.freed_slots.is_empty() {
            self.free_slots();
        }
    }

    fn process(&mut self, now: Time) {
        if !self.mechanisms.begin.is_empty() {
            self.process_begins();
        }
        let stage = self.stage.exclusive();
        stage.begin(now);
        self.state.agenda.take(now, &mut stage.runnable);
        if !stage.runnable.is_empty() {
            self.launcher.process(self.stage.shared());
        }
    }

    fn sync(&mut self, now: Time) {
        SyncPhase::new(self.stage.exclusive(), &mut self.state, &mut self.mechanisms, now).run();
        self.free_slots();
    }

    #[cold]
    fn process_begins(&mut self) {
        let begin = std::mem::take(&mut self.mechanisms.begin);
        for number in 0..self.mechanisms.len() {
            if begin.has(crate::module::Asked::of(number))
                && let Some(mut mechanism) = self.mechanisms.take(number)
            {
                mechanism.process_begins();
                self.mechanisms.put_back(number, mechanism);
            }
        }
    }

    #[cold]
    fn free_slots(&mut self) {
        self.state.freed_slots.drain(..).for_each(|slot| self.launcher.slot_freed(slot));
    }

    /// Serves requests while the core is paused, and waits for the next one.
    fn attend(&mut self) {
        let is_paused = self.state.pause;
        self.between_cycles().attend();
        if self.state.pause == is_paused && !self.state.link.stop_is_requested() {
            self.parker.park();
        }
    }

    fn wait(&mut self) {
        if self.has_work() || self.state.link.stop_is_requested() {
            return;
        }
        if self.idle == Idle::Spin {
            return std::hint::spin_loop();
        }
        match self.earliest_due() {
            Time::MAX => {
                self.has_slept = true;
                self.parker.park();
            }
            due => {
                let remaining = due.saturating_since(self.state.clock.now());
                if remaining > Duration::ZERO {
                    self.has_slept = true;
                    self.parker.park_timeout(remaining);
                }
            }
        }
    }

    /// True if the next cycle has something to do at any time.
    fn has_work(&self) -> bool {
        self.state.agenda.has_ready() || self.mechanisms.has_work() || !self.state.link.is_empty()
    }

    /// The earliest due time of mechanisms and modules.
    fn earliest_due(&mut self) -> Time {
        self.mechanisms.earliest_due().min(self.state.agenda.earliest_due())
    }

    /// Runs the `shutdown` of all modules: timekeepers, then parts in the reverse order of registration, then
    /// observers in the order of registration. Messages sent before the stop are delivered before the first
    /// module stops; the last messages of each module are delivered before the next one stops.
    ///
    /// Outlets end after all modules: their sinks receive the waiting messages, and are dropped.
    ///
    /// Waits for sinks, and for detached modules that are in a callback, and logs their names. A stopped core
    /// does not start again.
    pub fn stop(&mut self) {
        if self.state.life != CoreLife::Running {
            self.state.life = CoreLife::Stopped;
            return self.end();
        }
        // Requests from now on would never be taken.
        self.state.link.close();
        self.state.link.request_stop();
        self.settle();
        let members = &self.state.members;
        let timekeepers = members.iter().filter(|member| member.role() == Role::Timekeeper);
        let parts = members.iter().rev().filter(|member| member.role() == Role::Part);
        let observers = members.iter().filter(|member| member.role() == Role::Observer);
        let order: Vec<_> = timekeepers.chain(parts).chain(observers).map(|member| member.id).collect();
        for id in order {
            match id.place {
                Place::Attached(slot) => self.shut_down(id.order, slot),
                Place::Detached(slot) => {
                    if let Some(module) = &mut self.state.detached[slot] {
                        module.stop();
                    }
                }
            }
            self.settle();
        }
        self.state.life = CoreLife::Stopped;
        // Mechanisms answer the remaining callers outside the core.
        self.between_cycles().ask_all();
        self.sync(self.state.clock.now());
        self.end();
    }

    /// Ends mechanisms and link after the modules: outlets pass on their waiting messages.
    fn end(&mut self) {
        self.mechanisms.each().for_each(|mechanism| mechanism.stopped());
        self.state.link.end();
        for then in std::mem::take(&mut self.at_end) {
            if let Err(panic) = catch_unwind(AssertUnwindSafe(then)) {
                tracing::error!("a closure of Core::on_stop panicked: {}", end_of(panic));
            }
        }
    }

    /// Runs a cycle with the module's `shutdown` at its end. A sync phase alone would not do: messages that
    /// are on their way would become stale before modules receive them.
    fn shut_down(&mut self, order: u64, slot: usize) {
        let now = self.state.clock.now();
        self.process(now);
        let stage = self.stage.exclusive();
        if let Some(cell) = stage.cells.get(slot) {
            cell.shutdown(Input::Views(&stage.views), now);
            let asked = cell.take_asked();
            if let Some(panic) = cell.take_panic() {
                tracing::error!(module = &**cell.name(), "panicked in its shutdown: {panic}");
            }
            stage.note_asker(Asker { order, slot, asked });
        }
        self.sync(now);
    }

    /// Runs two cycles: the first takes the last messages, the second delivers them.
    fn settle(&mut self) {
        for _ in 0..2 {
            let now = self.state.clock.now();
            self.process(now);
            self.sync(now);
        }
    }
}

impl Drop for Core {
    /// Stops a running core.
    fn drop(&mut self) {
        if self.state.life == CoreLife::Running
            && let Err(panic) = catch_unwind(AssertUnwindSafe(|| self.stop()))
        {
            tracing::error!("the core panicked while it was stopping: {}", reason(&*panic));
        }
        self.state.link.request_stop();
        self.state.link.end();
    }
}

/// Sends requests to a running core from any thread; from [`Core::handle`](crate::Core::handle).
///
/// A request takes effect in the next sync phase. The receipt carries the result, and may be dropped.
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
    pub(crate) link: Arc<Link>,
}
