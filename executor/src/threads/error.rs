//! Errors of threads.

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
