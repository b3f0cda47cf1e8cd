//! The launcher with a fixed number of threads.

use std::collections::BTreeSet;
use std::num::NonZeroUsize;
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::Duration;

use super::run_guarded;
use crate::threads::Spinner;
use crate::threads::gate::{Gate, Seat};
use crate::{Launcher, Spin, Stage, ThreadError, ThreadOptions};

/// Errors of the construction of a pool.
#[derive(Debug, thiserror::Error)]
pub enum PoolError {
    /// The pool has 0 threads, not even the core's own.
    #[error(
        "a pool of 0 threads cannot run modules: give it at least 1, the core's own \
         (this machine runs {} at once)",
        available()
    )]
    NoThreads,
    /// Threads that never park would take the CPU from the threads for which they wait.
    #[error(
        "the {threads} threads of a pool cannot all spin always: each needs a separate CPU, and {sharing} of them \
         have to share {cpus}; use fewer threads, give them more CPUs, or let them spin for a time"
    )]
    TooFewCpus {
        /// The number of requested threads.
        threads: usize,
        /// How many of them are restricted to the same CPUs.
        sharing: usize,
        /// The number of these CPUs.
        cpus: usize,
    },
    /// A thread could not be started, or its options could not be applied.
    #[error("cannot make a pool of {threads} threads: {source}")]
    Thread {
        /// The number of requested threads.
        threads: usize,
        /// The error of one of them.
        source: ThreadError,
    },
}

/// Divides the modules of a cycle among `n` threads, including that of the core. Each thread takes the next
/// module that is not taken, so a long run does not delay the rest.
///
/// ```
/// use downbeat_executor::{Core, Pool};
///
/// let core = Core::new().with_launcher(Pool::new(2)?);
/// # Ok::<(), downbeat_executor::PoolError>(())
/// ```
///
/// A cycle wakes at most one thread per module beyond the first. Work that a woken thread has not begun when
/// the core's thread has finished is withdrawn, so cheap modules do not wait for a wake-up.
///
/// Waking threads has a price: on eight modules that do little, as most of a robot do, `Pool(2)` takes 1.6 to
/// 1.8 times the time of [`Linear`](crate::Linear). A pool is for cycles in which several modules each work
/// for much longer than a wake-up takes, some 50 µs. For one slow module, run that one detached.
pub struct Pool {
    workers: Vec<Worker>,
    gate: Arc<Gate>,
    spinner: Spinner,
    /// The options of the core's thread.
    core: ThreadOptions,
}

struct Worker {
    seat: Arc<Seat<Arc<Stage>>>,
    /// `None` only during the drop.
    thread: Option<JoinHandle<()>>,
}

impl Pool {
    /// A pool of `threads` threads, including the core's. The others spin for a moment after a cycle, so that
    /// they need no wake-up between cycles in quick succession.
    ///
    /// # Errors
    /// If `threads` is 0, or the system refuses a thread.
    pub fn new(threads: usize) -> Result<Self, PoolError> {
        Self::with_options(threads, ThreadOptions::default())
    }

    /// A pool of `threads` threads, including the core's, all with the same options.
    ///
    /// # Errors
    /// If `threads` is 0, or the system refuses a thread or the options.
    pub fn with_options(threads: usize, options: ThreadOptions) -> Result<Self, PoolError> {
        Self::with_each(vec![options; threads])
    }

    /// A pool with one thread for each of the options. The first options apply to the core's thread.
    ///
    /// # Errors
    /// If `options` is empty, or the system refuses a thread or its options.
    pub fn with_each(options: Vec<ThreadOptions>) -> Result<Self, PoolError> {
        let threads = options.len();
        // A spinning thread would take its CPU from another thread of the pool.
        let spin = match shared_cpus(&options) {
            Some((sharing, cpus)) if options.iter().any(|options| options.spin == Spin::Always) => {
                return Err(PoolError::TooFewCpus { threads, sharing, cpus });
            }
            Some(_) => Spin::Never,
            None => Spin::For(USUAL_SPIN),
        };
        let mut options = options.into_iter();
        let core = options.next().ok_or(PoolError::NoThreads)?;
        let spinner = Spinner::new(core.spin.or(spin));
        let mut pool = Self { workers: Vec::new(), gate: Arc::new(Gate::new()), spinner, core };
        for (index, options) in options.enumerate() {
            let worker = Worker::start(index + 1, &pool.gate, &options, spin);
            pool.workers.push(worker.map_err(|source| PoolError::Thread { threads, source })?);
        }
        Ok(pool)
    }
}

/// Longer than the pause between two cycles in a row, and short compared with a period of milliseconds.
const USUAL_SPIN: Duration = Duration::from_micros(20);

fn available() -> usize {
    std::thread::available_parallelism().map_or(1, NonZeroUsize::get)
}

/// How many threads share how many CPUs, if there are fewer CPUs than threads.
fn shared_cpus(options: &[ThreadOptions]) -> Option<(usize, usize)> {
    let is_within = |inner: &ThreadOptions, outer: &ThreadOptions| {
        outer.cpus.is_empty()
            || (!inner.cpus.is_empty() && inner.cpus.iter().all(|cpu| outer.cpus.contains(cpu)))
    };
    options.iter().find_map(|outer| {
        let sharing = options.iter().filter(|inner| is_within(inner, outer)).count();
        let cpus = if outer.cpus.is_empty() { available() } else { BTreeSet::from_iter(&outer.cpus).len() };
        (sharing > cpus).then_some((sharing, cpus))
    })
}

impl Launcher for Pool {
    fn attach(&mut self) -> Result<(), ThreadError> {
        self.core.apply()
    }

    fn process(&mut self, stage: &mut Arc<Stage>) {
        // One helper for each module beyond the first, which saves wake-ups in a cycle with little work.
        let helpers = stage.runnable().saturating_sub(1).min(self.workers.len());
        if helpers == 0
            && let Some(stage) = Arc::get_mut(stage)
        {
            return stage.run_all();
        }
        let Self { workers, gate, spinner, .. } = self;
        gate.expect(helpers);
        let _meeting = Meeting { helpers: &workers[..helpers], gate, spinner };
        for worker in &workers[..helpers] {
            worker.give(stage, gate);
        }
        while stage.run_next() {}
    }
}

impl Worker {
    fn start(
        number: usize,
        gate: &Arc<Gate>,
        options: &ThreadOptions,
        spin: Spin,
    ) -> Result<Self, ThreadError> {
        let seat = Arc::new(Seat::new(Arc::clone(gate)));
        let (served, mut spinner) = (Arc::clone(&seat), Spinner::new(options.spin.or(spin)));
        let run = |stage: Arc<Stage>| run_guarded(|| while stage.run_next() {});
        let name = format!("{}-{number}", options.prefix("pool"));
        let thread = options.spawn(name, move || served.serve(&mut spinner, run))?;
        Ok(Self { seat, thread: Some(thread) })
    }

    fn give(&self, stage: &Arc<Stage>, gate: &Gate) {
        let Some(thread) = &self.thread else { return gate.arrive() };
        if self.seat.give(Arc::clone(stage), thread.thread()).is_err() {
            gate.arrive();
        }
    }
}

/// Waits at the end of a process phase until no helper holds the stage, also if the phase panics.
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

#[cfg(test)]
mod tests {
    use super::*;

    fn on(cpus: &[usize]) -> ThreadOptions {
        ThreadOptions { cpus: cpus.to_vec(), spin: Spin::Always, ..ThreadOptions::default() }
    }

    #[test]
    fn threads_that_have_to_share_cpus_are_counted() {
        assert_eq!(shared_cpus(&[on(&[0]), on(&[1]), on(&[2, 3])]), None);
        assert_eq!(shared_cpus(&[on(&[0]), on(&[1]), on(&[1, 1])]), Some((2, 1)));
        assert_eq!(shared_cpus(&[on(&[0, 1]), on(&[1]), on(&[0])]), Some((3, 2)));
        let more = available() + 1;
        assert_eq!(shared_cpus(&vec![on(&[]); more]), Some((more, more - 1)));
    }

    #[test]
    fn threads_that_always_spin_are_refused_where_they_would_wait_for_each_others_cpu() {
        let refused = Err(PoolError::TooFewCpus { threads: 2, sharing: 2, cpus: 1 }.to_string());
        assert_eq!(Pool::with_options(2, on(&[0])).map(drop).map_err(|error| error.to_string()), refused);
    }
}
