//! The launcher with a fixed number of threads.

use std::num::NonZeroUsize;
use std::sync::Arc;
use std::thread::JoinHandle;

use super::gate::{Gate, Seat};
use super::run_guarded;
use super::spin::Spinner;
use crate::{Launcher, Spin, Stage};

/// Why a pool could not be made.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// Not even the core's own thread would be left.
    #[error(
        "a pool of 0 threads cannot run modules: give it at least 1, the core's own \
         (this machine runs {} at once)",
        available()
    )]
    NoThreads,
    /// The system gave no thread.
    #[error("cannot start thread {number} of a pool of {threads}: {source}; use fewer threads")]
    Thread {
        /// Which one, the core's being 0.
        number: usize,
        /// How many were asked for.
        threads: usize,
        /// What the system said.
        source: std::io::Error,
    },
}

/// Divides the modules of a cycle among `n` threads, that of the core among them. Each takes the next
/// module that none has taken, so a long one does not hold up the rest.
///
/// ```
/// use downbeat_executor::{Core, Pool};
///
/// let core = Core::new().with_launcher(Pool::new(2)?);
/// # Ok::<(), downbeat_executor::PoolError>(())
/// ```
///
/// A cycle wakes no more threads than it has modules beyond the first. What a woken thread has not begun when
/// the core's thread is through, it never gets: cheap modules do not wait for it.
pub struct Pool {
    workers: Vec<Worker>,
    gate: Arc<Gate>,
    spinner: Spinner,
}

struct Worker {
    seat: Arc<Seat<Arc<Stage>>>,
    /// There until the drop.
    thread: Option<JoinHandle<()>>,
}

impl Pool {
    /// A pool of `threads` threads, the core's included. The others spin for a moment after a cycle, so that
    /// cycles in quick succession need not wake them.
    ///
    /// # Errors
    /// If there are to be none, or the system refuses one.
    pub fn new(threads: usize) -> Result<Self, PoolError> {
        if threads == 0 {
            return Err(PoolError::NoThreads);
        }
        // Threads that take CPUs from each other make nothing faster by spinning.
        let spin = if threads > available() { Spin::Never } else { Spin::default() };
        let gate = Arc::new(Gate::new());
        let mut pool = Self { workers: Vec::new(), gate, spinner: Spinner::new(spin) };
        for number in 1..threads {
            let seat = Arc::new(Seat::new(Arc::clone(&pool.gate)));
            let (served, mut spinner) = (Arc::clone(&seat), Spinner::new(spin));
            let life = move || {
                served.serve(&mut spinner, |stage: Arc<Stage>| run_guarded(|| while stage.run_next() {}));
            };
            let thread = std::thread::Builder::new().name(format!("pool-{number}")).spawn(life);
            let thread = Some(thread.map_err(|source| PoolError::Thread { number, threads, source })?);
            pool.workers.push(Worker { seat, thread });
        }
        Ok(pool)
    }
}

fn available() -> usize {
    std::thread::available_parallelism().map_or(1, NonZeroUsize::get)
}

impl Launcher for Pool {
    fn process(&mut self, stage: &mut Arc<Stage>) {
        // A helper for each module beyond the first: fewer wake-ups in a cycle where little is due.
        let helpers = stage.runnable().saturating_sub(1).min(self.workers.len());
        if helpers == 0
            && let Some(stage) = Arc::get_mut(stage)
        {
            return stage.run_all();
        }
        let Self { workers, gate, spinner } = self;
        gate.expect(helpers);
        let _meeting = Meeting { helpers: &workers[..helpers], gate, spinner };
        for worker in &workers[..helpers] {
            worker.give(stage, gate);
        }
        while stage.run_next() {}
    }
}

impl Worker {
    fn give(&self, stage: &Arc<Stage>, gate: &Gate) {
        let Some(thread) = &self.thread else { return gate.arrive() };
        if self.seat.give(Arc::clone(stage), thread.thread()).is_err() {
            gate.arrive();
        }
    }
}

/// The end of a process phase, also of one that panics: no helper has the stage any longer.
struct Meeting<'a> {
    helpers: &'a [Worker],
    gate: &'a Gate,
    spinner: &'a mut Spinner,
}

impl Drop for Meeting<'_> {
    fn drop(&mut self) {
        for helper in self.helpers {
            if helper.seat.take_back().is_some() {
                self.gate.arrive();
            }
        }
        self.gate.wait(self.spinner);
    }
}

impl std::fmt::Debug for Pool {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.debug_struct("Pool").field("threads", &(self.workers.len() + 1)).finish_non_exhaustive()
    }
}

impl Drop for Pool {
    fn drop(&mut self) {
        for worker in &mut self.workers {
            if let Some(thread) = worker.thread.take() {
                worker.seat.close(thread.thread());
                let _ = thread.join();
            }
        }
    }
}
