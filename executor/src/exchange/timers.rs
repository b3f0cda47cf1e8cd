//! The mechanism "timers": periodic timers, scheduled tasks and time-outs.

use std::collections::VecDeque;
use std::time::Duration;

use crate::module::{Causes, ModuleIo, Place, TIMERS};
use crate::{
    Context, Core, Mechanism, Module, ModuleChange, Port, Setup, SetupError, SyncPhase, Time, Version,
};

/// Schedules the runs of modules for their timers, tasks and time-outs.
#[derive(Default)]
pub(crate) struct Timers;

impl Mechanism for Timers {
    type View = ();
    type Port = TimersPort;

    const NAME: &'static str = "timers";
    const VERSION: Version = Version::new(1, 0);

    fn view(&self) {}

    fn sync(&mut self, phase: &mut SyncPhase<'_>) {
        phase.each_asker(TIMERS, |cell, state| {
            if let Place::Attached(slot) = cell.io.id.place {
                state.agenda.wake_at(slot, cell.next_due());
            }
        });
    }
}

/// A module's timers and tasks.
#[derive(Default)]
pub(crate) struct TimersPort {
    timers: Vec<Timer>,
    tasks: Tasks,
}

impl TimersPort {
    pub(crate) fn periods(&self) -> Vec<Duration> {
        self.timers.iter().map(|timer| timer.period).collect()
    }
}

impl Port for TimersPort {
    fn changed(&mut self, change: ModuleChange<'_>) -> bool {
        match change {
            ModuleChange::Activated(now) => self.timers.iter_mut().for_each(|timer| timer.start(now)),
            ModuleChange::Deactivated => {
                self.timers.iter_mut().for_each(Timer::stop);
                self.tasks.cancel_all();
            }
            ModuleChange::ClockWentBack(now) => self.timers.iter_mut().for_each(|timer| timer.go_back(now)),
            ModuleChange::Inactive { .. } | ModuleChange::Panicked => {}
        }
        false
    }

    fn due(&self) -> Time {
        self.timers.iter().fold(self.tasks.due(), |due, timer| due.min(timer.due))
    }
}

/// A periodic timer. Its due times are multiples of the period after the start, so that a late cycle does not
/// shift later ones. Missed due times are skipped.
#[derive(Clone, Copy, Debug)]
struct Timer {
    period: Duration,
    due: Time,
}

impl Timer {
    /// A timer that has not started. `period` must not be zero.
    fn new(period: Duration) -> Self {
        Self { period, due: Time::MAX }
    }

    fn start(&mut self, now: Time) {
        self.due = now + self.period;
    }

    /// Handles a clock that has gone back to `now`. A due time further ahead than one period would silence
    /// the timer until then, so the timer is due after one period, as in rcl (`rcl/src/rcl/timer.c`).
    fn go_back(&mut self, now: Time) {
        if self.due < Time::MAX && self.due > now + self.period {
            self.start(now);
        }
    }

    fn stop(&mut self) {
        self.due = Time::MAX;
    }

    /// True if the timer is due; it is then set to the next multiple of its period after `now`.
    fn fire(&mut self, now: Time) -> bool {
        if now < self.due {
            return false;
        }
        self.due = self.due + self.period;
        if self.due <= now {
            // The number of periods may exceed the factor with which a `Duration` can be multiplied, since
            // setting a clock may move it by decades.
            let periods = now.saturating_since(self.due).as_nanos() / self.period.as_nanos() + 1;
            let step = periods.saturating_mul(self.period.as_nanos());
            self.due = self.due + Duration::from_nanos(u64::try_from(step).unwrap_or(u64::MAX));
        }
        true
    }
}

/// A module's key to one of its tasks, from [`Setup::task`](crate::Setup::task); scheduled with
/// [`Context::schedule`](crate::Context::schedule).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task {
    index: u32,
}

/// The scheduled tasks of one module.
#[derive(Default)]
struct Tasks {
    declared: u32,
    /// By time, and in the order of scheduling for equal times.
    scheduled: VecDeque<Scheduled>,
}

#[derive(Clone, Copy)]
struct Scheduled {
    due: Time,
    /// The run in which the task was scheduled.
    run: u64,
    task: Task,
}

impl Tasks {
    fn declare(&mut self) -> Task {
        self.declared += 1;
        Task { index: self.declared - 1 }
    }

    /// Returns false if the key is not of this module.
    #[must_use]
    fn schedule(&mut self, task: Task, due: Time, run: u64) -> bool {
        if task.index >= self.declared {
            return false;
        }
        let position = self.scheduled.partition_point(|scheduled| scheduled.due <= due);
        self.scheduled.insert(position, Scheduled { due, run, task });
        true
    }

    fn cancel(&mut self, task: Task) {
        self.scheduled.retain(|scheduled| scheduled.task != task);
    }

    fn cancel_all(&mut self) {
        self.scheduled.clear();
    }

    fn due(&self) -> Time {
        self.scheduled.front().map_or(Time::MAX, |scheduled| scheduled.due)
    }

    /// Takes the next due task that was scheduled before this run. A task that schedules itself for now
    /// therefore runs again in the next cycle, and not without end in this one.
    fn take_due(&mut self, now: Time, run: u64) -> Option<Task> {
        let is_due = |scheduled: &Scheduled| scheduled.due <= now && scheduled.run < run;
        let position = self.scheduled.iter().take_while(|scheduled| scheduled.due <= now).position(is_due)?;
        self.scheduled.remove(position).map(|scheduled| scheduled.task)
    }
}

impl<M: Module> Setup<'_, M> {
    /// Calls `callback` every `period`, for the first time one period after the module became active. Missed
    /// due times are skipped.
    ///
    /// # Errors
    /// If the period is zero.
    pub fn every<F>(&mut self, period: Duration, mut callback: F) -> Result<(), SetupError>
    where
        F: FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        if period.is_zero() {
            return Err(SetupError::ZeroPeriod(self.io.name.to_string()));
        }
        let timers = &mut self.io.open_own::<TimersPort>(TIMERS).timers;
        let index = timers.len();
        timers.push(Timer::new(period));
        self.steps.add(Causes::TIMERS, move |module, ctx| {
            let now = ctx.now();
            let fires = ctx.io().port::<TimersPort>(TIMERS).is_some_and(|port| port.timers[index].fire(now));
            if fires {
                ctx.io().ask(TIMERS);
                callback(module, ctx);
            }
        });
        Ok(())
    }

    /// Declares a callback that the module can schedule while it runs; the key is for [`Context::schedule`].
    pub fn task<F>(&mut self, callback: F) -> Task
    where
        F: FnMut(&mut M, &mut Context<'_, M::Ports>) + Send + 'static,
    {
        let task = self.io.open_own::<TimersPort>(TIMERS).tasks.declare();
        let next = |io: &mut ModuleIo, now| {
            let run = io.run;
            let task = io.port::<TimersPort>(TIMERS)?.tasks.take_due(now, run)?;
            io.ask(TIMERS);
            Some(task.index as usize)
        };
        self.steps.add_chosen(Causes::TASKS, next, task.index as usize, callback);
        task
    }
}

impl<P> Context<'_, P> {
    /// Runs a task in the first cycle at or after `time`, but not in this one. A task may be scheduled
    /// several times.
    pub fn schedule(&mut self, task: Task, time: Time) {
        let run = self.io().run;
        self.io().ask(TIMERS);
        if !self.io().open_own::<TimersPort>(TIMERS).tasks.schedule(task, time, run) {
            self.foreign("scheduled a task with")
        }
    }

    /// Runs a task after `delay`, see [`schedule`](Self::schedule).
    pub fn schedule_after(&mut self, task: Task, delay: Duration) {
        self.schedule(task, self.now() + delay);
    }

    /// Removes all entries of a task from the schedule.
    pub fn cancel(&mut self, task: Task) {
        self.io().ask(TIMERS);
        self.io().open_own::<TimersPort>(TIMERS).tasks.cancel(task);
    }
}

impl Core {
    /// The periods of a module's timers, in the order of declaration; `None` if there is no such module.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use downbeat_executor::{Core, Module, Setup, SetupError};
    /// struct Heartbeat;
    ///
    /// impl Module for Heartbeat {
    ///     type Ports = ();
    ///
    ///     fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
    ///         setup.every(Duration::from_secs(1), |_, _| {})
    ///     }
    /// }
    ///
    /// let mut core = Core::new();
    /// core.add("heartbeat", Heartbeat)?;
    /// assert_eq!(core.periods("heartbeat"), Some(&[Duration::from_secs(1)][..]));
    /// # Ok::<(), SetupError>(())
    /// ```
    #[must_use]
    pub fn periods(&self, module: &str) -> Option<&[Duration]> {
        self.state.members.find(module).map(|member| &*member.periods)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_timer_keeps_its_phase_and_skips_what_it_missed() {
        let mut timer = Timer::new(Duration::from_nanos(10));
        timer.start(Time::from_nanos(100));
        assert!(!timer.fire(Time::from_nanos(109)));
        assert!(timer.fire(Time::from_nanos(113)));
        assert_eq!(timer.due, Time::from_nanos(120));
        assert!(timer.fire(Time::from_nanos(150)));
        assert_eq!(timer.due, Time::from_nanos(160));
        assert!(!timer.fire(Time::from_nanos(159)));
    }

    #[test]
    fn a_timer_is_due_after_one_period_when_time_has_gone_back() {
        let mut timer = Timer::new(Duration::from_nanos(10));
        timer.go_back(Time::ZERO);
        assert_eq!(timer.due, Time::MAX, "the timer has not started");
        timer.start(Time::from_nanos(100));
        timer.go_back(Time::from_nanos(105));
        assert_eq!(timer.due, Time::from_nanos(110), "the last due time is not exceeded");
        timer.go_back(Time::from_nanos(3));
        assert_eq!(timer.due, Time::from_nanos(13));
    }

    #[test]
    fn a_timer_fires_once_when_the_clock_is_set_from_the_epoch_to_today() {
        let mut timer = Timer::new(Duration::from_millis(8));
        timer.start(Time::ZERO);
        let today = Time::from_nanos(1_795_000_000_000_000_001);
        assert!(timer.fire(today));
        assert!(!timer.fire(today));
        assert_eq!(timer.due, Time::from_nanos(1_795_000_000_008_000_000));
    }

    #[test]
    fn tasks_run_by_time_and_then_by_order_of_scheduling() {
        let mut tasks = Tasks::default();
        let [a, b] = [tasks.declare(), tasks.declare()];
        for (task, due) in [(a, 20), (b, 10), (a, 10)] {
            assert!(tasks.schedule(task, Time::from_nanos(due), 0));
        }
        let now = Time::from_nanos(15);
        assert_eq!(tasks.take_due(now, 1), Some(b));
        assert_eq!(tasks.take_due(now, 1), Some(a));
        assert_eq!(tasks.take_due(now, 1), None);
        assert_eq!(tasks.due(), Time::from_nanos(20));
    }

    #[test]
    fn a_task_that_schedules_itself_for_now_runs_in_the_next_cycle() {
        let mut tasks = Tasks::default();
        let task = tasks.declare();
        assert!(tasks.schedule(task, Time::ZERO, 1));
        assert_eq!(tasks.take_due(Time::ZERO, 1), None);
        assert_eq!(tasks.take_due(Time::ZERO, 2), Some(task));
    }

    #[test]
    fn a_task_that_was_not_declared_is_not_scheduled() {
        assert!(!Tasks::default().schedule(Task { index: 0 }, Time::ZERO, 0));
    }
}
