//! CPU affinity and priority of threads.

use std::cell::Cell;
use std::sync::mpsc::channel;
use std::thread::JoinHandle;

use super::system::{self, Scheduling};
use crate::{Spin, ThreadError};

/// The CPUs and the priority of a thread: of a launcher, of a detached module, or of the core.
///
/// ```
/// use downbeat_executor::{Pool, ThreadOptions};
///
/// let options = ThreadOptions { cpus: vec![0], ..ThreadOptions::default() };
/// let pool = Pool::with_options(2, options)?;
/// # Ok::<(), downbeat_executor::PoolError>(())
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct ThreadOptions {
    /// The numbers of the CPUs on which the thread may run, from 0. Empty: all CPUs of the program.
    pub cpus: Vec<usize>,
    /// 1 to 99: the thread is scheduled with `SCHED_FIFO` at this priority, and no thread of a lower priority
    /// preempts it. `None`: the scheduling of the program, usually `SCHED_OTHER`.
    pub fifo_priority: Option<u8>,
    /// The behaviour of a launcher's thread between cycles. Ignored for the thread of a detached module.
    pub spin: Spin,
    /// The prefix of the names of a launcher's threads. Empty: the default of the launcher, "pool" or
    /// "module". Linux shows the first 15 bytes of a name.
    pub name_prefix: String,
}

thread_local! {
    /// The scheduling of this thread before options were applied to it. Threads started by it inherit the
    /// changed scheduling, and first restore this one.
    static BEFORE: Cell<Option<Scheduling>> = const { Cell::new(None) };
}

impl ThreadOptions {
    /// Applies the options to the calling thread, in place of options applied before.
    ///
    /// # Errors
    /// If the system refuses or does not support the options; changes made until then are undone.
    pub fn apply(&self) -> Result<(), ThreadError> {
        let name = std::thread::current().name().unwrap_or("without a name").to_owned();
        if let Some(before) = BEFORE.take() {
            before.restore();
        }
        if self.cpus.is_empty() && self.fifo_priority.is_none() {
            return Ok(());
        }
        let before = Scheduling::of_this_thread();
        let applied = self.schedule(&name);
        match applied {
            Ok(()) => BEFORE.set(Some(before)),
            Err(_) => before.restore(),
        }
        applied
    }

    /// Starts a thread with these options. It does not inherit options that were applied to the calling
    /// thread.
    ///
    /// # Errors
    /// If the system refuses the thread or its options; `life` then does not run.
    pub fn spawn(
        &self,
        name: impl Into<String>,
        life: impl FnOnce() + Send + 'static,
    ) -> Result<JoinHandle<()>, ThreadError> {
        let (name, options, inherited) = (name.into(), self.clone(), BEFORE.get());
        let (report, reported) = channel();
        let start = move || {
            BEFORE.set(inherited);
            let applied = options.apply();
            let is_applied = applied.is_ok();
            // The spawning thread waits for this report.
            let _ = report.send(applied);
            if is_applied {
                life();
            }
        };
        let thread = std::thread::Builder::new()
            .name(name.clone())
            .spawn(start)
            .map_err(|source| ThreadError::Start { thread: name, source })?;
        match reported.recv() {
            Ok(Err(error)) => {
                let _ = thread.join();
                Err(error)
            }
            Ok(Ok(())) | Err(_) => Ok(thread),
        }
    }

    /// Checks, in a temporary thread, whether the system allows the options.
    pub(crate) fn check(&self, name: &str) -> Result<(), ThreadError> {
        let _ = self.spawn(name, || {})?.join();
        Ok(())
    }

    /// The prefix of the names, or the launcher's default.
    pub(crate) fn prefix<'a>(&'a self, default: &'a str) -> &'a str {
        if self.name_prefix.is_empty() { default } else { &self.name_prefix }
    }

    fn schedule(&self, thread: &str) -> Result<(), ThreadError> {
        if !self.cpus.is_empty() {
            system::set_cpus(thread, &self.cpus)?;
        }
        match self.fifo_priority {
            None => Ok(()),
            Some(priority @ 1..=99) => system::set_fifo_priority(thread, priority),
            Some(priority) => Err(ThreadError::PriorityOutOfRange { thread: thread.to_owned(), priority }),
        }
    }
}
