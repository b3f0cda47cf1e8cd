//! The process phase as a launcher sees it.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use crate::Time;
use crate::agenda::{Asker, Ready};
use crate::cell::ModuleCell;
use crate::inspect::{Measuring, Stopwatch};
use crate::module_io::Shared;

/// The modules that run in this cycle, and the messages they read.
///
/// During the process phase the messages are only read, and each module is touched by the one thread that
/// runs it. That is why every way to divide the modules among threads gives the same result.
#[derive(Default)]
pub struct Stage {
    pub(crate) now: Time,
    pub(crate) measuring: Measuring,
    pub(crate) shared: Shared,
    /// By slot. A lock is taken only where threads share the stage.
    modules: Vec<Mutex<Option<ModuleCell>>>,
    /// Those that run in this cycle, in the order of registration.
    pub(crate) runnable: Vec<Ready>,
    /// Those of them that asked for something.
    asked: Mutex<Vec<Asker>>,
    next: AtomicUsize,
}

impl Stage {
    /// How many modules run in this cycle.
    #[must_use]
    pub fn runnable(&self) -> usize {
        self.runnable.len()
    }

    /// The number under which the `nth` module of this cycle is kept: the same in every cycle, and given to another
    /// module only after this one was removed.
    ///
    /// # Panics
    /// If `nth` is not less than [`runnable`](Self::runnable).
    #[must_use]
    pub fn slot(&self, nth: usize) -> usize {
        self.runnable[nth].slot
    }

    /// Runs all modules of this cycle on this thread.
    pub fn run_all(&mut self) {
        match self.measuring {
            Measuring::Nothing => self.run_each(|_| ()),
            measuring => self.run_each_measured(measuring),
        }
    }

    #[cold]
    fn run_each_measured(&mut self, measuring: Measuring) {
        let mut stopwatch = Stopwatch::start(measuring);
        self.run_each(|cell| cell.span = stopwatch.lap());
    }

    #[inline]
    fn run_each(&mut self, mut has_run: impl FnMut(&mut ModuleCell)) {
        let Self { now, shared, modules, runnable, asked, next, .. } = self;
        let asked = asked.get_mut().unwrap_or_else(PoisonError::into_inner);
        for ready in &*runnable {
            let cell = modules[ready.slot].get_mut().unwrap_or_else(PoisonError::into_inner);
            let Some(cell) = cell else { continue };
            let what = cell.run(shared, *now);
            if !what.is_empty() {
                asked.push(Asker { module: *ready, asked: what });
            }
            has_run(cell);
        }
        *next.get_mut() = runnable.len();
    }

    /// Runs the next module of this cycle that no thread has taken yet; false if there is none.
    pub fn run_next(&self) -> bool {
        let nth = self.next.fetch_add(1, Ordering::Relaxed);
        let is_one = nth < self.runnable.len();
        if is_one {
            self.run_nth(nth);
        }
        is_one
    }

    /// Runs the `nth` module of this cycle, for launchers that divide the modules themselves: each runs once, and
    /// none through [`run_next`](Self::run_next).
    ///
    /// # Panics
    /// If `nth` is not less than [`runnable`](Self::runnable).
    pub fn run_nth(&self, nth: usize) {
        let ready = self.runnable[nth];
        let mut cell = self.modules[ready.slot].lock().unwrap_or_else(PoisonError::into_inner);
        let Some(cell) = &mut *cell else { return };
        let mut stopwatch = Stopwatch::start(self.measuring);
        let asked = cell.run(&self.shared, self.now);
        if self.measuring.is_on() {
            cell.span = stopwatch.lap();
        }
        if !asked.is_empty() {
            let asker = Asker { module: ready, asked };
            self.asked.lock().unwrap_or_else(PoisonError::into_inner).push(asker);
        }
    }

    pub(crate) fn begin(&mut self, now: Time) {
        self.now = now;
        *self.next.get_mut() = 0;
    }

    /// Moves the modules that asked for something in the process phase to `askers`, in the order of registration.
    pub(crate) fn take_askers(&mut self, askers: &mut Vec<Asker>) {
        askers.clear();
        std::mem::swap(self.asked.get_mut().unwrap_or_else(PoisonError::into_inner), askers);
        // Few ask for something, and on one thread they do so in order.
        if askers.len() > 1 && !askers.is_sorted_by_key(|asker| asker.module.order) {
            askers.sort_unstable_by_key(|asker| asker.module.order);
        }
    }

    pub(crate) fn note_asker(&mut self, asker: Asker) {
        let askers = self.asked.get_mut().unwrap_or_else(PoisonError::into_inner);
        match askers.iter_mut().find(|known| known.module == asker.module) {
            Some(known) => known.asked.add(asker.asked),
            None => askers.push(asker),
        }
    }

    pub(crate) fn free_slot(&mut self) -> usize {
        let is_free = |cell: &mut Mutex<Option<ModuleCell>>| {
            cell.get_mut().unwrap_or_else(PoisonError::into_inner).is_none()
        };
        self.modules.iter_mut().position(is_free).unwrap_or_else(|| {
            self.modules.push(Mutex::new(None));
            self.modules.len() - 1
        })
    }

    pub(crate) fn put(&mut self, slot: usize, cell: ModuleCell) {
        self.modules[slot] = Mutex::new(Some(cell));
    }

    /// One more than the greatest slot there was.
    pub(crate) fn slots(&self) -> usize {
        self.modules.len()
    }

    pub(crate) fn cell(&mut self, slot: usize) -> Option<&mut ModuleCell> {
        self.modules[slot].get_mut().unwrap_or_else(PoisonError::into_inner).as_mut()
    }

    /// The module in the slot, beside what modules share.
    pub(crate) fn cell_and_shared(&mut self, slot: usize) -> (Option<&mut ModuleCell>, &mut Shared) {
        let cell = self.modules[slot].get_mut().unwrap_or_else(PoisonError::into_inner);
        (cell.as_mut(), &mut self.shared)
    }

    pub(crate) fn take_cell(&mut self, slot: usize) -> Option<ModuleCell> {
        self.modules[slot].get_mut().unwrap_or_else(PoisonError::into_inner).take()
    }

    /// Looks at a module while nobody runs it.
    pub(crate) fn look<T>(&self, slot: usize, look: impl FnOnce(&ModuleCell) -> T) -> Option<T> {
        self.modules.get(slot)?.lock().unwrap_or_else(PoisonError::into_inner).as_ref().map(look)
    }
}
