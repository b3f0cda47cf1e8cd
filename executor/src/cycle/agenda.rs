//! The schedule of modules: which of them run in the next cycle, and when others are due.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use crate::Time;
use crate::module::{Asked, Causes};

/// A module of the next cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ready {
    /// The module's position in the order of registration; never reused.
    pub(crate) order: u64,
    /// The slot of the module's cell.
    pub(crate) slot: usize,
    /// The reasons of the run.
    pub(crate) causes: Causes,
}

/// A module that has made requests in this cycle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Asker {
    pub(crate) order: u64,
    pub(crate) slot: usize,
    /// The mechanisms that received its requests.
    pub(crate) asked: Asked,
}

/// The modules that are ready now, and the due times of the others.
#[derive(Default)]
pub(crate) struct Agenda {
    ready: Vec<Ready>,
    /// The smallest order that can be appended without breaking the order of `ready`.
    next_order: u64,
    is_out_of_order: bool,
    /// By slot.
    entries: Vec<Entry>,
    /// A heap of due times. Entries that differ from `entries` are outdated and are skipped when they reach
    /// the top.
    due: BinaryHeap<Reverse<(Time, usize)>>,
    every_cycle: Vec<usize>,
    /// Modules that run in the next cycle, which they do not bring about.
    later: Vec<(usize, Causes)>,
}

#[derive(Clone, Copy)]
struct Entry {
    order: u64,
    due: Time,
    /// The reasons to run in the next cycle; none if the module does not run.
    causes: Causes,
}

impl Agenda {
    /// Adds a module, which runs in the next cycle.
    pub(crate) fn enter(&mut self, slot: usize, order: u64) {
        let entry = Entry { order, due: Time::MAX, causes: Causes::NONE };
        if slot == self.entries.len() {
            self.entries.push(entry);
        } else {
            self.entries[slot] = entry;
        }
        self.wake(slot, Causes::ALL);
    }

    pub(crate) fn run_in_every_cycle(&mut self, slot: usize) {
        self.every_cycle.push(slot);
    }

    pub(crate) fn leave(&mut self, slot: usize) {
        self.entries[slot].due = Time::MAX;
        self.entries[slot].causes = Causes::NONE;
        self.ready.retain(|ready| ready.slot != slot);
        self.later.retain(|&(later, _)| later != slot);
        self.every_cycle.retain(|&every| every != slot);
    }

    /// Schedules the module for the next cycle.
    #[inline]
    pub(crate) fn wake(&mut self, slot: usize, causes: Causes) {
        let entry = &mut self.entries[slot];
        if entry.causes.is_empty() {
            self.is_out_of_order |= self.next_order > entry.order;
            self.next_order = entry.order;
            self.ready.push(Ready { order: entry.order, slot, causes });
        }
        entry.causes.add(causes);
    }

    /// Schedules the module for the next cycle that takes place for another reason.
    pub(crate) fn wake_later(&mut self, slot: usize, causes: Causes) {
        self.later.push((slot, causes));
    }

    /// Schedules the module for the first cycle at or after `due`.
    pub(crate) fn wake_at(&mut self, slot: usize, due: Time) {
        if self.entries[slot].due == due {
            return;
        }
        self.entries[slot].due = due;
        if due < Time::MAX {
            self.due.push(Reverse((due, slot)));
            self.compact();
        }
    }

    pub(crate) fn has_ready(&self) -> bool {
        !self.ready.is_empty()
    }

    /// The earliest due time of all modules.
    pub(crate) fn earliest_due(&mut self) -> Time {
        while let Some(&Reverse((due, slot))) = self.due.peek() {
            if self.entries[slot].due == due {
                return due;
            }
            self.due.pop();
        }
        Time::MAX
    }

    /// Moves the modules that run at `now` into `runnable`, in the order of registration.
    #[inline(always)]
    pub(crate) fn take(&mut self, now: Time, runnable: &mut Vec<Ready>) {
        runnable.clear();
        while let Some(&Reverse((due, slot))) = self.due.peek() {
            if due > now {
                break;
            }
            self.due.pop();
            if self.entries[slot].due == due {
                self.entries[slot].due = Time::MAX;
                self.wake(slot, Causes::DUE);
            }
        }
        for index in 0..self.every_cycle.len() {
            self.wake(self.every_cycle[index], Causes::WOKEN);
        }
        if !self.later.is_empty() {
            self.take_later();
        }
        std::mem::swap(&mut self.ready, runnable);
        for ready in &mut *runnable {
            ready.causes = std::mem::take(&mut self.entries[ready.slot].causes);
        }
        if self.is_out_of_order {
            runnable.sort_unstable_by_key(|ready| ready.order);
        }
        (self.next_order, self.is_out_of_order) = (0, false);
    }

    #[inline(never)]
    fn take_later(&mut self) {
        for index in 0..self.later.len() {
            let (slot, causes) = self.later[index];
            self.wake(slot, causes);
        }
        self.later.clear();
    }

    /// Removes outdated entries: a module may postpone a distant due time any number of times.
    fn compact(&mut self) {
        if self.due.len() > 64 + 4 * self.entries.len() {
            let Self { due, entries, .. } = self;
            due.retain(|Reverse((time, slot))| entries[*slot].due == *time);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slots(agenda: &mut Agenda, now: i64) -> Vec<usize> {
        let mut runnable = Vec::new();
        agenda.take(Time::from_nanos(now), &mut runnable);
        runnable.iter().map(|ready| ready.slot).collect()
    }

    #[test]
    fn modules_run_in_the_order_of_registration_wherever_they_are_kept() {
        let mut agenda = Agenda::default();
        agenda.enter(0, 7);
        agenda.enter(1, 5);
        agenda.enter(2, 6);
        assert_eq!(slots(&mut agenda, 0), [1, 2, 0]);
        agenda.wake(0, Causes::MESSAGES);
        agenda.wake(1, Causes::MESSAGES);
        agenda.wake(0, Causes::REPLIES);
        assert_eq!(slots(&mut agenda, 0), [1, 0]);
    }

    #[test]
    fn a_due_time_that_was_moved_is_forgotten() {
        let mut agenda = Agenda::default();
        agenda.enter(0, 0);
        slots(&mut agenda, 0);
        agenda.wake_at(0, Time::from_nanos(10));
        agenda.wake_at(0, Time::from_nanos(20));
        assert_eq!(agenda.earliest_due(), Time::from_nanos(20));
        assert!(slots(&mut agenda, 19).is_empty());
        assert_eq!(slots(&mut agenda, 20), [0]);
        assert_eq!(agenda.earliest_due(), Time::MAX);
    }

    #[test]
    fn a_due_time_moved_again_and_again_does_not_fill_the_memory() {
        let mut agenda = Agenda::default();
        agenda.enter(0, 0);
        for time in 0..10_000 {
            agenda.wake_at(0, Time::from_nanos(1_000_000 + time));
        }
        assert!(agenda.due.len() < 100);
    }

    #[test]
    fn a_module_that_is_woken_later_brings_about_no_cycle() {
        let mut agenda = Agenda::default();
        agenda.enter(0, 0);
        slots(&mut agenda, 0);
        agenda.wake_later(0, Causes::MESSAGES);
        assert!(!agenda.has_ready());
        assert_eq!(slots(&mut agenda, 1), [0]);
        assert!(slots(&mut agenda, 2).is_empty());
    }

    #[test]
    fn a_module_that_left_does_not_run() {
        let mut agenda = Agenda::default();
        agenda.enter(0, 0);
        agenda.run_in_every_cycle(0);
        agenda.wake_at(0, Time::from_nanos(5));
        agenda.leave(0);
        assert!(slots(&mut agenda, 10).is_empty());
    }
}
