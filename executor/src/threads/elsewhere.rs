//! Systems without support for CPU affinity and priorities.

use std::time::Duration;

use crate::ThreadError;

#[derive(Clone, Copy)]
pub(super) struct Scheduling;

impl Scheduling {
    pub(super) fn of_this_thread() -> Self {
        Self
    }

    pub(super) fn restore(self) {}
}

pub(crate) struct PromptTimers;

impl PromptTimers {
    pub(crate) fn start() -> Self {
        Self
    }
}

pub(crate) fn processor_time() -> Option<Duration> {
    None
}

pub(super) fn set_cpus(thread: &str, _: &[usize]) -> Result<(), ThreadError> {
    Err(not_supported(thread, "CPUs"))
}

pub(super) fn set_fifo_priority(thread: &str, _: u8) -> Result<(), ThreadError> {
    Err(not_supported(thread, "SCHED_FIFO priority"))
}

fn not_supported(thread: &str, what: &'static str) -> ThreadError {
    ThreadError::NotSupported { thread: thread.to_owned(), what, system: std::env::consts::OS }
}
