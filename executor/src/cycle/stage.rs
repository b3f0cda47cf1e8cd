//! The launcher's view of the process phase.

use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use super::agenda::{Asker, Ready};
use crate::module::{Asked, ModuleCell, Views};
use crate::observe::{Measuring, Stopwatch, spans_are_on};
use crate::threads::unpoisoned;
use crate::{ThreadError, Time};

/// Runs the modules of a cycle. The choice of the launcher never changes the results of modules.
///
/// [`Linear`](crate::Linear) runs them on the core's thread, [`Pool`](crate::Pool) on a fixed number of
/// threads, [`Threads`](crate::Threads) each on a separate thread. A program can define another launcher;
/// `examples/executor_alone/src/bin/launcher.rs` shows one with threads. The following one shows that not
/// even the order matters:
///
/// ```
/// use std::sync::Arc;
/// use downbeat_executor::{Core, Launcher, Stage};
///
/// struct Backwards;
///
/// impl Launcher for Backwards {
///     fn process(&mut self, stage: &mut Arc<Stage>) {
///         (0..stage.runnable()).rev().for_each(|nth| stage.run_nth(nth));
///     }
/// }
///
/// let core = Core::new().with_launcher(Backwards);
/// ```
pub trait Launcher: Send {
    /// Called on the core's thread when the core starts, before the first cycle.
    ///
    /// # Errors
    /// If the core's thread cannot run as configured; the core then does not start.
    fn attach(&mut self) -> Result<(), ThreadError> {
        Ok(())
    }

    /// Runs every runnable module of the stage once: with [`Stage::run_all`], with [`Stage::run_next`] on any
    /// number of threads, or with [`Stage::run_nth`] if each module needs a certain thread.
    ///
    /// No clone of `stage` may be left on return, since the sync phase changes the stage.
    fn process(&mut self, stage: &mut Arc<Stage>);

    /// True if [`process`](Self::process) only calls [`Stage::run_all`]; the core then calls that itself.
    fn is_linear(&self) -> bool {
        false
    }

    /// Called when the module in this [slot](Stage::slot) was removed, to free data kept for it. Another
    /// module may get the slot in a later cycle.
    fn slot_freed(&mut self, slot: usize) {
        let _ = slot;
    }
}

impl<L: Launcher + ?Sized> Launcher for Box<L> {
    fn attach(&mut self) -> Result<(), ThreadError> {
        (**self).attach()
    }

    fn process(&mut self, stage: &mut Arc<Stage>) {
        (**self).process(stage);
    }

    fn is_linear(&self) -> bool {
        (**self).is_linear()
    }

    fn slot_freed(&mut self, slot: usize) {
        (**self).slot_freed(slot);
    }
}

/// The modules that run in this cycle, and their input.
///
/// During the process phase, the messages are only read, and each module is accessed only by the thread that
/// runs it. Every division of the modules among threads therefore gives the same result.
#[derive(Default)]
pub struct Stage {
    pub(crate) now: Time,
    pub(crate) measuring: Measuring,
    pub(crate) views: Views,
    pub(crate) cells: Cells,
    /// The modules that run in this cycle, in the order of registration.
    pub(crate) runnable: Vec<Ready>,
    /// The modules of this cycle that have made requests.
    askers: Mutex<Askers>,
    next: AtomicUsize,
}

impl Stage {
    /// The number of modules that run in this cycle.
    #[must_use]
    pub fn runnable(&self) -> usize {
        self.runnable.len()
    }

    /// The slot of the `nth` module of this cycle. A module keeps its slot until it is removed; then another
    /// module may get it.
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
    pub(crate) fn run_each_measured(&mut self, measuring: Measuring) {
        let mut stopwatch = Stopwatch::start(measuring);
        self.run_each(|cell| cell.span = stopwatch.lap());
    }

    /// As [`run_all`](Self::run_all), without the check whether runs are measured.
    #[inline(always)]
    pub(crate) fn run_each(&mut self, mut has_run: impl FnMut(&mut ModuleCell)) {
        let Self { now, views, cells, runnable, askers, next, .. } = self;
        let (askers, has_spans) = (unpoisoned(askers.get_mut()), spans_are_on());
        for &Ready { order, slot, causes } in &*runnable {
            let Some(cell) = cells.get(slot) else { continue };
            let asked = match has_spans {
                false => cell.run(causes, views, *now),
                true => cell.run_in_span(causes, views, *now),
            };
            if !asked.is_empty() {
                askers.push(Asker { order, slot, asked });
            }
            has_run(cell);
        }
        *next.get_mut() = runnable.len();
    }

    /// Runs the next module of this cycle that no thread has taken; returns false if there is none.
    pub fn run_next(&self) -> bool {
        let nth = self.next.fetch_add(1, Ordering::Relaxed);
        let is_one = nth < self.runnable.len();
        if is_one {
            self.run_nth(nth);
        }
        is_one
    }

    /// Runs the `nth` module of this cycle, for launchers that assign modules to threads themselves. Each
    /// module must run once, and none through [`run_next`](Self::run_next).
    ///
    /// # Panics
    /// If `nth` is not less than [`runnable`](Self::runnable).
    pub fn run_nth(&self, nth: usize) {
        let Ready { order, slot, causes } = self.runnable[nth];
        let mut cell = unpoisoned(self.cells.cells[slot].lock());
        let Some(cell) = &mut *cell else { return };
        let mut stopwatch = Stopwatch::start(self.measuring);
        let asked = match spans_are_on() {
            false => cell.run(causes, &self.views, self.now),
            true => cell.run_in_span(causes, &self.views, self.now),
        };
        if self.measuring.is_on() {
            cell.span = stopwatch.lap();
        }
        if !asked.is_empty() {
            unpoisoned(self.askers.lock()).push(Asker { order, slot, asked });
        }
    }

    #[inline]
    pub(crate) fn begin(&mut self, now: Time) {
        self.now = now;
        *self.next.get_mut() = 0;
    }

    /// Takes the modules with requests of this process phase, in the order of registration.
    #[inline]
    pub(crate) fn swap_askers(&mut self, askers: &mut Askers) {
        askers.clear();
        std::mem::swap(unpoisoned(self.askers.get_mut()), askers);
        // With one thread they are already in order.
        if askers.list.len() > 1 && !askers.list.is_sorted_by_key(|asker| asker.order) {
            askers.list.sort_unstable_by_key(|asker| asker.order);
        }
    }

    pub(crate) fn note_asker(&mut self, asker: Asker) {
        let askers = unpoisoned(self.askers.get_mut());
        askers.asked.add(asker.asked);
        match askers.list.iter_mut().find(|known| known.order == asker.order) {
            Some(known) => known.asked.add(asker.asked),
            None => askers.list.push(asker),
        }
    }
}

/// The modules that have made requests in a cycle.
#[derive(Default)]
pub(crate) struct Askers {
    pub(crate) list: Vec<Asker>,
    /// The union of the mechanisms that received requests.
    pub(crate) asked: Asked,
}

impl Askers {
    #[inline]
    fn clear(&mut self) {
        self.list.clear();
        self.asked = Asked::default();
    }

    #[inline]
    fn push(&mut self, asker: Asker) {
        self.asked.add(asker.asked);
        self.list.push(asker);
    }
}

/// The modules that run inside cycles, by slot. The locks are needed only if threads share the stage.
#[derive(Default)]
pub(crate) struct Cells {
    cells: Vec<Mutex<Option<ModuleCell>>>,
    /// No slot with a smaller number is free.
    free_from: usize,
}

impl Cells {
    pub(crate) fn free_slot(&mut self) -> usize {
        let is_free = |cell: &mut Mutex<Option<ModuleCell>>| unpoisoned(cell.get_mut()).is_none();
        let candidates = self.cells.get_mut(self.free_from..).unwrap_or_default();
        let free = candidates.iter_mut().position(is_free).map(|position| self.free_from + position);
        let slot = free.unwrap_or_else(|| {
            self.cells.push(Mutex::new(None));
            self.cells.len() - 1
        });
        self.free_from = slot;
        slot
    }

    pub(crate) fn put(&mut self, slot: usize, cell: ModuleCell) {
        self.cells[slot] = Mutex::new(Some(cell));
    }

    /// The largest slot so far, plus one.
    pub(crate) fn slots(&self) -> usize {
        self.cells.len()
    }

    #[inline]
    pub(crate) fn get(&mut self, slot: usize) -> Option<&mut ModuleCell> {
        unpoisoned(self.cells[slot].get_mut()).as_mut()
    }

    pub(crate) fn take(&mut self, slot: usize) -> Option<ModuleCell> {
        self.free_from = self.free_from.min(slot);
        unpoisoned(self.cells[slot].get_mut()).take()
    }

    /// Reads a module while no thread runs it.
    pub(crate) fn look<T>(&self, slot: usize, look: impl FnOnce(&ModuleCell) -> T) -> Option<T> {
        unpoisoned(self.cells.get(slot)?.lock()).as_ref().map(look)
    }
}

/// The stage, shared with the threads of the launcher if there are any. An unshared stage is cheaper to
/// access, which matters because every cycle does so.
pub(crate) enum StageHolder {
    Own(Box<Stage>),
    Shared(Arc<Stage>),
}

impl StageHolder {
    /// The stage between process phases, when no other thread holds it.
    ///
    /// # Panics
    /// If a launcher has kept a clone of the stage, which its contract forbids.
    #[inline]
    pub(crate) fn exclusive(&mut self) -> &mut Stage {
        #[expect(clippy::expect_used, reason = "the core cannot continue with a broken launcher")]
        self.get_mut().expect("the launcher kept the stage beyond the process phase")
    }

    /// The stage, unless a launcher holds a clone of it.
    #[inline]
    pub(crate) fn get_mut(&mut self) -> Option<&mut Stage> {
        match self {
            Self::Own(stage) => Some(stage),
            Self::Shared(stage) => Arc::get_mut(stage),
        }
    }

    /// The stage in the form that launchers take.
    pub(crate) fn shared(&mut self) -> &mut Arc<Stage> {
        if let Self::Own(stage) = self {
            *self = Self::Shared(Arc::new(std::mem::take(&mut **stage)));
        }
        match self {
            Self::Shared(stage) => stage,
            Self::Own(_) => unreachable!("the stage was made shared above"),
        }
    }
}

impl std::ops::Deref for StageHolder {
    type Target = Stage;

    fn deref(&self) -> &Stage {
        match self {
            Self::Own(stage) => stage,
            Self::Shared(stage) => stage,
        }
    }
}
