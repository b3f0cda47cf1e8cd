//! On which CPUs and at which priority threads run.

use std::cell::Cell;
use std::sync::mpsc::channel;
use std::thread::JoinHandle;

use super::system::{self, Scheduling};
use crate::Spin;

/// Where and how a thread runs: of a launcher, of a detached module, or the core's own.
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
    /// The numbers of the CPUs on which the thread may run, from 0. Empty: wherever the program may.
    pub cpus: Vec<usize>,
    /// From 1 to 99: the thread is scheduled with `SCHED_FIFO` at this priority and yields to no thread of a lower
    /// one. None: as the program is, `SCHED_OTHER` as a rule.
    pub fifo_priority: Option<u8>,
    /// What a launcher's thread does between cycles. Without meaning for the thread of a detached module.
    pub spin: Spin,
    /// What the names of a launcher's threads begin with. Empty: the launcher's own, "pool" or "module". Linux
    /// shows the first 15 bytes of a name.
    pub name_prefix: String,
}

/// Why a thread cannot run as asked.
#[derive(Debug, thiserror::Error)]
pub enum ThreadError {
    /// The system gave no thread.
    #[error(
        "cannot start the thread \"{thread}\": {source}; run fewer threads or raise the limit (ulimit -u)"
    )]
    Start {
        /// The thread's name.
        thread: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A CPU that is not there, or not for this program.
    #[error("cannot run the thread \"{thread}\" on CPU {cpu}: this program can use the CPUs {usable}")]
    NoSuchCpu {
        /// The thread's name.
        thread: String,
        /// The CPU asked for.
        cpu: usize,
        /// Those there are, as in "0-3,6".
        usable: String,
    },
    /// Other trouble with the CPUs.
    #[error("cannot run the thread \"{thread}\" on the CPUs {cpus}: {source}")]
    Cpus {
        /// The thread's name.
        thread: String,
        /// The CPUs asked for, as in "0-3,6".
        cpus: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// A priority out of range.
    #[error(
        "cannot give the thread \"{thread}\" the SCHED_FIFO priority {priority}: priorities go from 1, the lowest, \
         to 99"
    )]
    PriorityOutOfRange {
        /// The thread's name.
        thread: String,
        /// The priority asked for.
        priority: u8,
    },
    /// The user may not use this priority.
    #[error(
        "the system does not allow the SCHED_FIFO priority {priority} for the thread \"{thread}\": {source}; \
         allow it with the line \"{user} - rtprio {priority}\" in /etc/security/limits.conf and log in again, or \
         with \"sudo setcap cap_sys_nice+ep {program}\"; a container needs --cap-add=SYS_NICE"
    )]
    PriorityNotAllowed {
        /// The thread's name.
        thread: String,
        /// The priority asked for.
        priority: u8,
        /// Who may not.
        user: String,
        /// The program that runs.
        program: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Other trouble with the priority.
    #[error("cannot give the thread \"{thread}\" the SCHED_FIFO priority {priority}: {source}")]
    Priority {
        /// The thread's name.
        thread: String,
        /// The priority asked for.
        priority: u8,
        /// What the system said.
        source: std::io::Error,
    },
    /// A launcher's threads that never park, at a priority above that of the thread that gives them work.
    #[error(
        "the thread \"{thread}\" cannot spin always at the SCHED_FIFO priority {priority}: it would take its CPU from \
         the core; let it spin for a time, or leave the priority out"
    )]
    SpinsAtPriority {
        /// The thread's name.
        thread: String,
        /// The priority asked for.
        priority: u8,
    },
    /// Only Linux is supported.
    #[error(
        "cannot set the {what} of the thread \"{thread}\": not supported on this system, {system}, only on linux"
    )]
    NotSupported {
        /// The thread's name.
        thread: String,
        /// CPUs or `SCHED_FIFO` priority.
        what: &'static str,
        /// The system.
        system: &'static str,
    },
}

thread_local! {
    /// How this thread was scheduled before options were applied to it. Threads that it starts inherit what the
    /// options made of it, and begin by undoing that.
    static BEFORE: Cell<Option<Scheduling>> = const { Cell::new(None) };
}

impl ThreadOptions {
    /// Makes the calling thread run as the options say, whatever options were applied to it before.
    ///
    /// # Errors
    /// If the system does not allow it, or not at all; what was changed before that is undone.
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

    /// Starts a thread that runs as the options say. It inherits nothing that options made of the calling thread.
    ///
    /// # Errors
    /// If the system gives no thread, or does not allow what the options say; then `life` does not run.
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
            // The other side waits for it.
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

    /// Finds out in a thread of its own whether the system allows the options.
    pub(crate) fn check(&self, name: &str) -> Result<(), ThreadError> {
        let _ = self.spawn(name, || {})?.join();
        Ok(())
    }

    /// The prefix of the names, or the launcher's own.
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
