//! Callbacks at times a module chooses while it runs.

use std::collections::VecDeque;

use crate::Time;

/// A module's key to one of its tasks, from [`Setup::task`](crate::Setup::task); scheduled with
/// [`Context::schedule`](crate::Context::schedule).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Task {
    pub(crate) index: u32,
}

/// The times at which the tasks of one module are due.
#[derive(Default)]
pub(crate) struct Tasks {
    declared: u32,
    /// By time, and by order of scheduling where times are equal.
    scheduled: VecDeque<Scheduled>,
    number: u64,
}

#[derive(Clone, Copy)]
struct Scheduled {
    due: Time,
    number: u64,
    task: Task,
}

impl Tasks {
    pub(crate) fn declare(&mut self) -> Task {
        self.declared += 1;
        Task { index: self.declared - 1 }
    }

    /// True if the module has none.
    pub(crate) fn is_empty(&self) -> bool {
        self.declared == 0
    }

    /// False if the key is not of this module.
    #[must_use]
    pub(crate) fn schedule(&mut self, task: Task, due: Time) -> bool {
        if task.index >= self.declared {
            return false;
        }
        let position = self.scheduled.partition_point(|scheduled| scheduled.due <= due);
        self.scheduled.insert(position, Scheduled { due, number: self.number, task });
        self.number += 1;
        true
    }

    pub(crate) fn cancel(&mut self, task: Task) {
        self.scheduled.retain(|scheduled| scheduled.task != task);
    }

    pub(crate) fn cancel_all(&mut self) {
        self.scheduled.clear();
    }

    pub(crate) fn due(&self) -> Time {
        self.scheduled.front().map_or(Time::MAX, |scheduled| scheduled.due)
    }

    /// Tells tasks that were scheduled before this moment from those scheduled after it.
    pub(crate) fn mark(&self) -> u64 {
        self.number
    }

    /// The next task that is due and was scheduled before `mark`: one that schedules itself for now runs again
    /// in the next cycle, not without end in this one.
    pub(crate) fn take_due(&mut self, now: Time, mark: u64) -> Option<Task> {
        let is_due = |scheduled: &Scheduled| scheduled.due <= now && scheduled.number < mark;
        let position = self.scheduled.iter().take_while(|scheduled| scheduled.due <= now).position(is_due)?;
        self.scheduled.remove(position).map(|scheduled| scheduled.task)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tasks_run_by_time_and_then_by_order_of_scheduling() {
        let mut tasks = Tasks::default();
        let [a, b] = [tasks.declare(), tasks.declare()];
        for (task, due) in [(a, 20), (b, 10), (a, 10)] {
            assert!(tasks.schedule(task, Time::from_nanos(due)));
        }
        let (now, mark) = (Time::from_nanos(15), tasks.mark());
        assert_eq!(tasks.take_due(now, mark), Some(b));
        assert_eq!(tasks.take_due(now, mark), Some(a));
        assert_eq!(tasks.take_due(now, mark), None);
        assert_eq!(tasks.due(), Time::from_nanos(20));
    }

    #[test]
    fn a_task_that_schedules_itself_for_now_runs_in_the_next_cycle() {
        let mut tasks = Tasks::default();
        let task = tasks.declare();
        let mark = tasks.mark();
        assert!(tasks.schedule(task, Time::ZERO));
        assert_eq!(tasks.take_due(Time::ZERO, mark), None);
        assert_eq!(tasks.take_due(Time::ZERO, tasks.mark()), Some(task));
    }

    #[test]
    fn a_task_that_was_not_declared_is_not_scheduled() {
        assert!(!Tasks::default().schedule(Task { index: 0 }, Time::ZERO));
    }
}
