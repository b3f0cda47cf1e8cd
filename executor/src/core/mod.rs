//! The core: owns the modules and runs the cycles.

mod sync;

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crossbeam::sync::Parker;

use crate::behaviour::ModuleBehaviour;
use crate::cell::ModuleCell;
use crate::context::ModuleIo;
use crate::detached::DetachedModule;
use crate::join::{CoreHandle, DetachedStep, Inlet, JoinQueue};
use crate::probe::{CycleReport, Probe};
use crate::topic::{ModuleSlot, Subscriber};
use crate::{
    Clock, Inbox, Launcher, Linear, Module, ModuleOptions, Role, SettingInfo, Setup, SetupError, Stage,
    Synchrony, SystemClock, Time, TopicInfo,
};

/// Why a core cannot run.
#[derive(Debug, thiserror::Error)]
pub enum RunError {
    /// The clock has to be moved by hand.
    #[error("this clock does not go on by itself; set it and call `cycle`, or use a clock that does")]
    ClockStandsStill,
    /// The system gave no thread.
    #[error("cannot start a thread for the detached module \"{module}\": {source}")]
    Thread {
        /// The module.
        module: String,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Owns the modules of a robot and runs them in cycles: a process phase, in which modules run, and a sync
/// phase, in which what they asked for takes effect.
pub struct Core {
    stage: Arc<Stage>,
    launcher: Box<dyn Launcher>,
    clock: Arc<dyn Clock>,
    queue: Arc<JoinQueue>,
    parker: Parker,
    detached: Vec<DetachedModule>,
    registered: Vec<(ModuleSlot, Role)>,
    next_due: Vec<Time>,
    has_work: Vec<bool>,
    steps_topic: Option<usize>,
    probe: Option<Arc<dyn Probe>>,
    cycle: u64,
    has_started: bool,
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
        Self {
            stage: Arc::default(),
            launcher: Box::new(Linear),
            clock: Arc::new(SystemClock::new()),
            queue: Arc::new(JoinQueue::new(parker.unparker().clone())),
            parker,
            detached: Vec::new(),
            registered: Vec::new(),
            next_due: Vec::new(),
            has_work: Vec::new(),
            steps_topic: None,
            probe: None,
            cycle: 0,
            has_started: false,
        }
    }

    /// The same core with another launcher.
    #[must_use]
    pub fn with_launcher(mut self, launcher: impl Launcher + 'static) -> Self {
        self.launcher = Box::new(launcher);
        self
    }

    /// The same core with another clock; to be called before modules are added.
    #[must_use]
    pub fn with_clock(mut self, clock: impl Clock + 'static) -> Self {
        self.clock = Arc::new(clock);
        self
    }

    /// The same core, measured by `probe`.
    #[must_use]
    pub fn with_probe(mut self, probe: Arc<dyn Probe>) -> Self {
        self.probe = Some(probe);
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
        mut module: M,
        options: ModuleOptions,
    ) -> Result<(), SetupError> {
        if self.has_started {
            return Err(SetupError::AlreadyRunning(name.into()));
        }
        if self.module_names().any(|known| *known == *name) {
            return Err(SetupError::DuplicateModule(name.into()));
        }
        let inbox = match options.synchrony {
            Synchrony::Detached(inbox) if self.clock.runs_by_itself() => Some(inbox),
            Synchrony::Detached(_) | Synchrony::WhenDue => None,
        };
        let stage = exclusive(&mut self.stage);
        let slot = match inbox {
            Some(_) => ModuleSlot::Detached(self.detached.len()),
            None => ModuleSlot::Attached(stage.modules.len()),
        };
        let mut io = ModuleIo::new(name);
        let mut setup = Setup::new(&mut io, &mut stage.topics, options.settings, options.remaps);
        module.setup(&mut setup)?;
        let callbacks = setup.finish()?;
        let subscribed: Vec<usize> =
            callbacks.subscriptions.iter().map(|callback| callback.topic()).collect();
        for (subscription, &topic) in subscribed.iter().enumerate() {
            stage.topics.subscribe(
                topic,
                match slot {
                    ModuleSlot::Attached(module) => Subscriber::Attached { module, subscription },
                    ModuleSlot::Detached(module) => Subscriber::Detached { module },
                },
            );
        }
        let cell = ModuleCell::new(io, Box::new(ModuleBehaviour { module, callbacks }), subscribed);
        self.keep(cell, inbox, options.role);
        self.registered.push((slot, options.role));
        Ok(())
    }

    fn keep(&mut self, cell: ModuleCell, inbox: Option<Inbox>, role: Role) {
        match inbox {
            Some(inbox) => self.detached.push(DetachedModule::new(cell, inbox, role)),
            None => {
                exclusive(&mut self.stage).modules.push(Mutex::new(cell));
                self.next_due.push(Time::MAX);
                self.has_work.push(true);
            }
        }
    }

    /// A way to publish on a topic from threads outside the executor.
    ///
    /// # Errors
    /// A name that is not valid, or a topic that carries another type.
    pub fn inlet<T: Send + Sync + 'static>(&mut self, topic: &str) -> Result<Inlet<T>, SetupError> {
        let topics = &mut exclusive(&mut self.stage).topics;
        let index = topics.open::<T>(topic, "inlet")?;
        topics.mark_published(index);
        Ok(Inlet::new(index, Arc::clone(&self.queue)))
    }

    /// A way to stop the core and to change settings from other threads.
    #[must_use]
    pub fn handle(&self) -> CoreHandle {
        CoreHandle { queue: Arc::clone(&self.queue) }
    }

    /// The topics, in the order in which they were first declared.
    #[must_use]
    pub fn topics(&self) -> &[TopicInfo] {
        self.stage.topics.infos()
    }

    /// The settings of a module before the start; nothing if there is no such module.
    #[must_use]
    pub fn settings(&self, module: &str) -> Option<Vec<SettingInfo>> {
        let detached = self.detached.iter().filter_map(DetachedModule::cell);
        if let Some(cell) = detached.into_iter().find(|cell| **cell.name() == *module) {
            return Some(cell.settings().to_vec());
        }
        let cells = self.stage.modules.iter().filter_map(|cell| cell.lock().ok());
        cells.into_iter().find(|cell| **cell.name() == *module).map(|cell| cell.settings().to_vec())
    }

    /// Runs cycles until [`CoreHandle::stop`] is called, then stops the modules. Sleeps while nothing is due.
    ///
    /// # Errors
    /// If the clock does not go on by itself, or a thread cannot be started.
    pub fn run(&mut self) -> Result<(), RunError> {
        if !self.clock.runs_by_itself() {
            return Err(RunError::ClockStandsStill);
        }
        while !self.queue.stop_is_requested() {
            self.cycle()?;
            self.wait();
        }
        self.stop();
        Ok(())
    }

    /// Runs one cycle at the time the clock shows. The first one starts the modules.
    ///
    /// # Errors
    /// If a thread of a detached module cannot be started.
    pub fn cycle(&mut self) -> Result<(), RunError> {
        if !self.has_started {
            self.start()?;
        }
        let now = self.clock.now();
        let due = self.earliest_due();
        let begin = self.probe.as_ref().map(|_| Instant::now());
        self.process(now);
        let processed = begin.map(|_| Instant::now());
        self.sync(now);
        if let (Some(probe), Some(begin), Some(processed)) = (&self.probe, begin, processed) {
            probe.cycle(&CycleReport {
                cycle: self.cycle,
                time: now,
                lateness: (due <= now).then(|| now.saturating_since(due)),
                modules: self.stage.runnable(),
                process: processed - begin,
                sync: processed.elapsed(),
            });
        }
        self.cycle += 1;
        Ok(())
    }

    /// When the core has something to do next: now, at a timer's time, or never by itself.
    #[must_use]
    pub fn next_event(&self) -> Option<Time> {
        if self.has_work.contains(&true) || !self.queue.is_empty() {
            return Some(self.clock.now());
        }
        Some(self.earliest_due()).filter(|&due| due < Time::MAX)
    }

    /// Runs the modules' last callbacks: parts in the reverse order of registration, then observers in the
    /// order of registration. What each publishes last is delivered before the next one stops.
    ///
    /// It waits for detached modules that are in a callback, and logs which. A stopped core does not start
    /// again.
    pub fn stop(&mut self) {
        if !self.has_started {
            return;
        }
        // Nobody would take what an inlet accepted from now on.
        self.queue.request_stop();
        let parts = self.registered.iter().rev().filter(|(_, role)| *role == Role::Part);
        let observers = self.registered.iter().filter(|(_, role)| *role == Role::Observer);
        let order: Vec<_> = parts.chain(observers).map(|&(slot, _)| slot).collect();
        for slot in order {
            let now = self.clock.now();
            match slot {
                ModuleSlot::Attached(index) => {
                    exclusive(&mut self.stage).cell(index).stop(now);
                    self.has_work[index] = true;
                }
                ModuleSlot::Detached(index) => self.detached[index].stop(),
            }
            // One cycle takes its last messages over, the next delivers them.
            for _ in 0..2 {
                self.process(now);
                self.sync(now);
                self.cycle += 1;
            }
        }
        self.has_started = false;
    }

    fn start(&mut self) -> Result<(), RunError> {
        let stage = exclusive(&mut self.stage);
        // Cannot be of another type: no module can name this type's topic otherwise by mistake, and where
        // one does, steps are simply not published.
        self.steps_topic = stage.topics.open::<DetachedStep>(DetachedStep::TOPIC, "executor").ok();
        for (index, module) in self.detached.iter_mut().enumerate() {
            let (clock, queue) = (Arc::clone(&self.clock), Arc::clone(&self.queue));
            module.start(index, clock, queue, self.probe.clone()).map_err(|source| {
                let module = module.name.to_string();
                RunError::Thread { module, source }
            })?;
        }
        self.has_started = true;
        Ok(())
    }

    fn process(&mut self, now: Time) {
        let stage = exclusive(&mut self.stage);
        stage.begin(now);
        stage.runnable.clear();
        let is_due = |(has_work, &due): (&bool, &Time)| *has_work || due <= now;
        let modules = self.has_work.iter().zip(&self.next_due).map(is_due);
        stage.runnable.extend(modules.enumerate().filter_map(|(index, is_due)| is_due.then_some(index)));
        if !stage.runnable.is_empty() {
            self.launcher.process(&mut self.stage);
        }
    }

    fn earliest_due(&self) -> Time {
        self.next_due.iter().copied().min().unwrap_or(Time::MAX)
    }

    fn wait(&self) {
        if self.has_work.contains(&true) || !self.queue.is_empty() || self.queue.stop_is_requested() {
            return;
        }
        match self.earliest_due() {
            Time::MAX => self.parker.park(),
            due => {
                let remaining = due.saturating_since(self.clock.now());
                if remaining > Duration::ZERO {
                    self.parker.park_timeout(remaining);
                }
            }
        }
    }

    fn module_names(&self) -> impl Iterator<Item = Arc<str>> {
        let attached =
            self.stage.modules.iter().filter_map(|cell| Some(Arc::clone(cell.lock().ok()?.name())));
        attached.chain(self.detached.iter().map(|module| Arc::clone(&module.name)))
    }
}

impl Drop for Core {
    fn drop(&mut self) {
        if let Some(stage) = Arc::get_mut(&mut self.stage) {
            // Guarded, unlike the drop of the topics themselves.
            stage.topics.retire();
        }
        self.queue.request_stop();
    }
}

/// The stage between process phases, when nobody else holds it.
///
/// # Panics
/// If a launcher has kept a clone of the stage, which its contract forbids.
fn exclusive(stage: &mut Arc<Stage>) -> &mut Stage {
    #[expect(clippy::expect_used, reason = "a broken launcher leaves nothing that could go on")]
    Arc::get_mut(stage).expect("the launcher kept the stage beyond the process phase")
}
