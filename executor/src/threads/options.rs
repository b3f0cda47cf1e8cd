//! CPU affinity and priority of threads.

use std::cell::Cell;
use std::sync::mpsc::channel;
use std::thread::JoinHandle;

use super::system::{self, Scheduling};
use crate::Spin;

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

/// Errors of starting a thread with options.
#[derive(Debug, thiserror::Error)]
pub enum ThreadError {
    /// The system refused the thread.
    #[error(
        "cannot start the thread \"{thread}\": {source}; run fewer threads or raise the limit (ulimit -u)"
    )]
    Start {
        /// The thread's name.
        thread: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The CPU does not exist, or is not available to this program.
    #[error("cannot run the thread \"{thread}\" on CPU {cpu}: this program can use the CPUs {usable}")]
    NoSuchCpu {
        /// The thread's name.
        thread: String,
        /// The requested CPU.
        cpu: usize,
        /// The available CPUs, in the form "0-3,6".
        usable: String,
    },
    /// Another error of CPU affinity.
    #[error("cannot run the thread \"{thread}\" on the CPUs {cpus}: {source}")]
    Cpus {
        /// The thread's name.
        thread: String,
        /// The requested CPUs, in the form "0-3,6".
        cpus: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The priority is out of range.
    #[error(
        "cannot give the thread \"{thread}\" the SCHED_FIFO priority {priority}: priorities go from 1, the lowest, \
         to 99"
    )]
    PriorityOutOfRange {
        /// The thread's name.
        thread: String,
        /// The requested priority.
        priority: u8,
    },
    /// The user has no permission for this priority.
    #[error(
        "the system does not allow the SCHED_FIFO priority {priority} for the thread \"{thread}\": {source}; \
         allow it with the line \"{user} - rtprio {priority}\" in /etc/security/limits.conf and log in again, or \
         with \"sudo setcap cap_sys_nice+ep {program}\"; a container needs --cap-add=SYS_NICE"
    )]
    PriorityNotAllowed {
        /// The thread's name.
        thread: String,
        /// The requested priority.
        priority: u8,
        /// The user name.
        user: String,
        /// The path of the running program.
        program: String,
        /// The error of the system.
        source: std::io::Error,
    },
    /// Another error of the priority.
    #[error("cannot give the thread \"{thread}\" the SCHED_FIFO priority {priority}: {source}")]
    Priority {
        /// The thread's name.
        thread: String,
        /// The requested priority.
        priority: u8,
        /// The error of the system.
        source: std::io::Error,
    },
    /// The launcher's threads would never park, at a priority above that of the thread that gives them work.
    #[error(
        "the thread \"{thread}\" cannot spin always at the SCHED_FIFO priority {priority}: it would take its CPU from \
         the core; let it spin for a time, or leave the priority out"
    )]
    SpinsAtPriority {
        /// The thread's name.
        thread: String,
        /// The requested priority.
        priority: u8,
    },
    /// The operation is supported only on Linux.
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
