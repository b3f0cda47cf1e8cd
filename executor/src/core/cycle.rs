//! Cycles: the process phase, the sync phase, and the wait for the next one.

use std::time::{Duration, Instant};

use super::{Core, Idle, Pause, RunError, SyncPhase, World};
use crate::detached::DetachedModule;
use crate::event::ModuleEvent;
use crate::inspect::{CycleInfo, Measuring, spans_are_on};
use crate::join::DetachedStep;
use crate::management::{Command, finish_leaving};
use crate::mechanism::Engaged;
use crate::messaging::Topics;
use crate::probe::{CycleReport, Probe};
use crate::setting::SettingsChange;
use crate::{Launcher, Stage, Time};

impl Core {
    /// Runs cycles until [`CoreHandle::stop`](crate::CoreHandle::stop) is called, then stops the modules. Sleeps while nothing is due,
    /// unless it is told to spin.
    ///
    /// # Errors
    /// If the clock does not go on by itself, a thread cannot be started, or the core was stopped before.
    pub fn run(&mut self) -> Result<(), RunError> {
        if !self.world.clock.runs_by_itself() {
            return Err(RunError::ClockStandsStill);
        }
        while !self.world.queue.stop_is_requested() {
            match &mut self.world.pause {
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

    /// Runs one cycle at the time the clock shows. The first one starts the modules.
    ///
    /// # Errors
    /// If a thread of a detached module cannot be started, or the core was stopped.
    pub fn cycle(&mut self) -> Result<(), RunError> {
        if !self.world.is_running {
            self.start()?;
        }
        if self.world.queue.take_clock_announcement() {
            self.world.detached.iter().flatten().for_each(DetachedModule::wake);
        }
        let now = self.world.clock.now();
        if now < self.world.last_now {
            self.go_back(now);
        }
        self.world.last_now = now;
        let (measuring, cycle) = (self.world.inspector.begin(), self.world.cycle);
        self.stage.exclusive().measuring = measuring;
        let due = if measuring.is_on() { self.world.earliest_due() } else { Time::MAX };
        if let Some(watch) = &self.watch {
            watch.begin();
        }
        if spans_are_on() || self.world.probe.is_some() {
            self.observed_cycle(now);
        } else {
            self.process_and_sync(now);
        }
        if let Some(watch) = &self.watch {
            watch.end();
        }
        if measuring.is_on() {
            let lateness = (due <= now).then(|| now.saturating_since(due));
            self.take_readings(CycleInfo { cycle, lateness, has_slept: self.world.has_slept });
        }
        self.world.has_slept = false;
        Ok(())
    }

    /// When the core has something to do next: now, at a timer's time, or never by itself.
    #[must_use]
    pub fn next_event(&mut self) -> Option<Time> {
        let has_to_start = !self.world.is_running && self.world.members.iter().next().is_some();
        if self.world.has_stopped {
            return None;
        }
        if self.world.has_work() || has_to_start {
            return Some(self.world.clock.now());
        }
        Some(self.world.earliest_due()).filter(|&due| due < Time::MAX)
    }

    fn start(&mut self) -> Result<(), RunError> {
        if self.world.has_stopped {
            return Err(RunError::Stopped);
        }
        // One that cannot start whole does not start later with what is left of it.
        let started = self.start_threads();
        self.world.has_stopped = started.is_err();
        self.world.is_running = started.is_ok();
        started
    }

    fn start_threads(&mut self) -> Result<(), RunError> {
        self.launcher.attach()?;
        let topics = &mut self.stage.exclusive().shared.topics;
        if self.world.steps_topic.is_none() {
            // Cannot be of another type: no module can name these types' topics otherwise by mistake, and where
            // one does, they are simply not published.
            self.world.steps_topic = open_own::<DetachedStep>(topics, DetachedStep::TOPIC);
            self.world.changes_topic = open_own::<SettingsChange>(topics, SettingsChange::TOPIC);
            self.world.events_topic = open_own::<ModuleEvent>(topics, ModuleEvent::TOPIC);
        }
        let mut detached = std::mem::take(&mut self.world.detached);
        let started = detached.iter_mut().flatten().try_for_each(|module| {
            let started = module.start(&self.world);
            started.map_err(|source| RunError::Thread { module: module.name.to_string(), source })
        });
        self.world.detached = detached;
        started
    }

    /// The clock is that of somebody else, and has gone back. Detached modules notice it themselves.
    #[cold]
    fn go_back(&mut self, now: Time) {
        let by = self.world.last_now.saturating_since(now).as_secs_f64();
        tracing::warn!("the clock went back by {by} s to {now}: timers start again from there");
        let stage = self.stage.exclusive();
        for slot in 0..stage.slots() {
            if let Some(cell) = stage.cell(slot) {
                cell.go_back(now);
                self.world.agenda.wake_at(slot, cell.next_due());
            }
        }
    }

    fn take_readings(&mut self, info: CycleInfo) {
        let stage = self.stage.exclusive();
        stage.measuring = Measuring::Nothing;
        self.world.inspector.synced();
        for nth in 0..stage.runnable.len() {
            // One that was removed in this cycle has nothing to tell.
            if let Some(cell) = stage.cell(stage.runnable[nth].slot)
                && let Some(span) = cell.span.take()
            {
                self.world.inspector.ran(&mut cell.meter, &cell.io.name, info.cycle, &span);
            }
        }
        self.world.inspector.end(info);
    }

    pub(super) fn process_and_sync(&mut self, now: Time) {
        if self.world.outlets.has_waiting() {
            self.world.outlets.run_waiting();
        }
        if self.launcher.is_linear() {
            let stage = self.stage.exclusive();
            stage.begin(now);
            self.world.agenda.take(now, &mut stage.runnable);
            stage.run_all();
            sync(stage, &mut self.world, &mut self.mechanisms, &mut *self.launcher, now);
        } else {
            self.process(now);
            self.sync(now);
        }
    }

    #[cold]
    fn observed_cycle(&mut self, now: Time) {
        let _span = tracing::trace_span!("cycle", number = self.world.cycle, time = %now).entered();
        match self.world.probe.clone() {
            None => self.process_and_sync(now),
            Some(probe) => self.probed_cycle(now, &*probe),
        }
    }

    fn probed_cycle(&mut self, now: Time, probe: &dyn Probe) {
        let due = self.world.earliest_due();
        let begin = Instant::now();
        self.process(now);
        let (processed, modules) = (Instant::now(), self.stage.runnable());
        let cycle = self.world.cycle;
        self.sync(now);
        probe.cycle(&CycleReport {
            cycle,
            time: now,
            lateness: (due <= now).then(|| now.saturating_since(due)),
            modules,
            process: processed - begin,
            sync: processed.elapsed(),
        });
    }

    pub(super) fn process(&mut self, now: Time) {
        if self.world.outlets.has_waiting() {
            self.world.outlets.run_waiting();
        }
        let stage = self.stage.exclusive();
        stage.begin(now);
        self.world.agenda.take(now, &mut stage.runnable);
        if !stage.runnable.is_empty() {
            self.launcher.process(self.stage.shared());
        }
    }

    pub(super) fn sync(&mut self, now: Time) {
        let stage = self.stage.exclusive();
        sync(stage, &mut self.world, &mut self.mechanisms, &mut *self.launcher, now);
    }

    /// While the core is paused: lets others look at it, and waits.
    fn attend(&mut self) {
        self.world.join();
        let commands = std::mem::take(&mut self.world.joined.commands);
        let is_paused = self.world.pause;
        for (by, command) in commands {
            match command {
                Command::Look(look) => look(self.stage.exclusive(), &mut self.world),
                other => self.world.joined.commands.push((by, other)),
            }
        }
        if self.world.pause == is_paused && !self.world.queue.stop_is_requested() {
            self.parker.park();
        }
    }

    fn wait(&mut self) {
        if self.world.has_work() || self.world.queue.stop_is_requested() {
            return;
        }
        if self.idle == Idle::Spin {
            return std::hint::spin_loop();
        }
        match self.world.earliest_due() {
            Time::MAX => {
                self.world.has_slept = true;
                self.parker.park();
            }
            due => {
                let remaining = due.saturating_since(self.world.clock.now());
                if remaining > Duration::ZERO {
                    self.world.has_slept = true;
                    self.parker.park_timeout(remaining);
                }
            }
        }
    }
}

/// A topic of the executor itself, which stays.
fn open_own<T: Send + Sync + 'static>(topics: &mut Topics, name: &str) -> Option<usize> {
    let topic = topics.open::<T>(name, "executor").ok()?;
    topics.add_user(topic);
    Some(topic)
}

/// What was asked for in the process phase takes effect.
fn sync(
    stage: &mut Stage,
    world: &mut World,
    mechanisms: &mut [Engaged],
    launcher: &mut dyn Launcher,
    now: Time,
) {
    world.inspector.processed();
    stage.take_askers(&mut world.askers);
    world.join();
    let mut asked = world.asked_from_outside(now);
    world.askers.iter().for_each(|asker| asked.add(asker.asked));
    let mut phase = SyncPhase { stage, world, now, asked };
    for mechanism in &mut *mechanisms {
        mechanism.sync(&mut phase);
    }
    if !phase.world.leaving.is_empty() {
        finish_leaving(&mut phase);
    }
    if !phase.world.gone.is_empty() {
        for module in std::mem::take(&mut phase.world.gone) {
            mechanisms.iter_mut().for_each(|engaged| engaged.mechanism.module_left(module, &mut phase));
        }
    }
    if !world.freed_slots.is_empty() {
        world.freed_slots.drain(..).for_each(|slot| launcher.slot_freed(slot));
    }
    world.cycle += 1;
}
