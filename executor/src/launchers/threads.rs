//! The launcher with one thread per module.

use std::sync::Arc;
use std::thread::JoinHandle;

use super::run_guarded;
use crate::threads::Spinner;
use crate::threads::gate::{Gate, Seat};
use crate::{Launcher, Spin, Stage, ThreadError, ThreadOptions};

/// Runs each module on a separate thread, which lives as long as the module.
///
/// ```
/// use downbeat_executor::{Core, Threads};
///
/// let core = Core::new().with_launcher(Threads::new());
/// ```
///
/// Every run of a module wakes its thread, which takes the system some microseconds. This launcher suits few
/// modules with long runs, or libraries that require calls from always the same thread. A module's thread
/// starts when the module first runs. If the system refuses the thread, the launcher logs an error, and the
/// core's thread runs the module.
#[derive(Debug)]
pub struct Threads {
    /// By slot.
    threads: Vec<Option<ModuleThread>>,
    gate: Arc<Gate>,
    spinner: Spinner,
    options: ThreadOptions,
    has_been_refused: bool,
}

struct ModuleThread {
    seat: Arc<Seat<Run>>,
    /// `None` only during the drop.
    thread: Option<JoinHandle<()>>,
}

/// One run of a module.
struct Run {
    stage: Arc<Stage>,
    nth: usize,
}

impl Default for Threads {
    fn default() -> Self {
        Self::new()
    }
}

impl Threads {
    /// A launcher whose threads park between cycles. The threads start later.
    #[must_use]
    pub fn new() -> Self {
        Self::with_checked(ThreadOptions::default())
    }

    /// A launcher whose threads run with these options. They do not apply to the core's thread; see
    /// [`Scheduled`](crate::Scheduled).
    ///
    /// # Errors
    /// If the system does not allow the options, or they combine [`Spin::Always`] with a priority.
    pub fn with_options(options: ThreadOptions) -> Result<Self, ThreadError> {
        let thread = name(&options, 0);
        if let (Spin::Always, Some(priority)) = (options.spin, options.fifo_priority) {
            return Err(ThreadError::SpinsAtPriority { thread, priority });
        }
        options.check(&thread)?;
        Ok(Self::with_checked(options))
    }

    fn with_checked(options: ThreadOptions) -> Self {
        let spinner = Spinner::new(options.spin.or(Spin::Never));
        Self { threads: Vec::new(), gate: Arc::new(Gate::new()), spinner, options, has_been_refused: false }
    }

    /// Starts the threads of modules that run for the first time.
    fn start_new(&mut self, stage: &Stage) {
        for nth in 0..stage.runnable() {
            let slot = stage.slot(nth);
            if slot >= self.threads.len() {
                self.threads.resize_with(slot + 1, || None);
            }
            if self.threads[slot].is_none() {
                match ModuleThread::start(&name(&self.options, slot), &self.gate, &self.options) {
                    Ok(thread) => self.threads[slot] = Some(thread),
                    Err(error) if !self.has_been_refused => {
                        self.has_been_refused = true;
                        tracing::error!("{error}; modules without a thread run on the core's thread");
                    }
                    Err(_) => {}
                }
            }
        }
    }
}

fn name(options: &ThreadOptions, slot: usize) -> String {
    format!("{}-{slot}", options.prefix("module"))
}

impl Launcher for Threads {
    fn process(&mut self, stage: &mut Arc<Stage>) {
        self.start_new(stage);
        let Self { threads, gate, spinner, .. } = self;
        gate.expect(stage.runnable());
        let _meeting = Meeting { gate, spinner };
        let mut without_thread = Vec::new();
        for nth in 0..stage.runnable() {
            let run = Run { stage: Arc::clone(stage), nth };
            let thread = threads[stage.slot(nth)].as_ref();
            if !thread.is_some_and(|thread| thread.give(run)) {
                gate.arrive();
                without_thread.push(nth);
            }
        }
        without_thread.into_iter().for_each(|nth| stage.run_nth(nth));
    }

    fn slot_freed(&mut self, slot: usize) {
        if let Some(thread) = self.threads.get_mut(slot) {
            *thread = None;
        }
    }
}

impl ModuleThread {
    fn start(name: &str, gate: &Arc<Gate>, options: &ThreadOptions) -> Result<Self, ThreadError> {
        let seat = Arc::new(Seat::new(Arc::clone(gate)));
        let (served, mut spinner) = (Arc::clone(&seat), Spinner::new(options.spin.or(Spin::Never)));
        let run = |run: Run| run_guarded(|| run.stage.run_nth(run.nth));
        let thread = options.spawn(name, move || served.serve(&mut spinner, run))?;
        Ok(Self { seat, thread: Some(thread) })
    }

    /// False if the thread has ended.
    fn give(&self, run: Run) -> bool {
        self.thread.as_ref().is_some_and(|thread| self.seat.give(run, thread.thread()).is_ok())
    }
}

impl Drop for ModuleThread {
    fn drop(&mut self) {
        if let Some(thread) = self.thread.take() {
            self.seat.close(thread.thread());
            let _ = thread.join();
        }
    }
}

/// Waits at the end of a process phase until no thread holds the stage, also if the phase panics.
struct Meeting<'a> {
    gate: &'a Gate,
    spinner: &'a mut Spinner,
}

impl Drop for Meeting<'_> {
    fn drop(&mut self) {
        self.gate.wait(self.spinner);
    }
}

impl std::fmt::Debug for ModuleThread {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("ModuleThread").field("thread", &self.thread).finish_non_exhaustive()
    }
}
