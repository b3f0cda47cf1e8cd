//! The process phase as a launcher sees it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::Time;
use crate::cell::ModuleCell;
use crate::topic::Topics;

/// The modules that run in this cycle, and the messages they read.
///
/// During the process phase the topics are only read, and each module is touched by the one thread that
/// runs it. That is why every way to divide the modules among threads gives the same result.
#[derive(Default)]
pub struct Stage {
    pub(crate) now: Time,
    pub(crate) topics: Topics,
    /// In the order of registration. A lock is taken only where threads share the stage.
    pub(crate) modules: Vec<Mutex<ModuleCell>>,
    /// Those that run in this cycle, ascending.
    pub(crate) runnable: Vec<usize>,
    next: AtomicUsize,
}

impl Stage {
    /// How many modules run in this cycle.
    #[must_use]
    pub fn runnable(&self) -> usize {
        self.runnable.len()
    }

    /// Runs all modules of this cycle on this thread.
    pub fn run_all(&mut self) {
        for &index in &self.runnable {
            let cell = self.modules[index].get_mut().unwrap_or_else(PoisonError::into_inner);
            cell.run(&self.topics, self.now);
        }
        *self.next.get_mut() = self.runnable.len();
    }

    /// Runs the next module of this cycle that no thread has taken yet; false if there is none.
    pub fn run_next(&self) -> bool {
        let Some(&index) = self.runnable.get(self.next.fetch_add(1, Ordering::Relaxed)) else { return false };
        let mut cell = self.modules[index].lock().unwrap_or_else(PoisonError::into_inner);
        cell.run(&self.topics, self.now);
        true
    }

    /// Runs the `nth` module of this cycle, counted from 0 below [`runnable`](Self::runnable).
    ///
    /// Each is run exactly once, by one thread or another; this is not mixed with [`run_next`](Self::run_next).
    pub fn run_nth(&self, nth: usize) {
        let Some(&index) = self.runnable.get(nth) else { return };
        let mut cell = self.modules[index].lock().unwrap_or_else(PoisonError::into_inner);
        cell.run(&self.topics, self.now);
    }

    /// A small number that the `nth` module of this cycle keeps while it lives; another may have it afterwards.
    #[must_use]
    pub fn slot(&self, nth: usize) -> usize {
        self.runnable[nth]
    }

    pub(crate) fn begin(&mut self, now: Time) {
        self.now = now;
        *self.next.get_mut() = 0;
    }

    pub(crate) fn cell(&mut self, index: usize) -> &mut ModuleCell {
        self.modules[index].get_mut().unwrap_or_else(PoisonError::into_inner)
    }
}
