//! Linux: CPU affinity and `SCHED_FIFO`, see sched(7); timers, see `PR_SET_TIMERSLACK` in prctl(2).

use std::io;
use std::num::NonZeroU64;
use std::time::Duration;

use rustix::process::{getpriority_process, setpriority_process};
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity, set_current_timer_slack};
use rustix::time::{ClockId, clock_gettime};
use thread_priority::unix::{
    RealtimeThreadSchedulePolicy, ThreadSchedulePolicy, set_thread_priority_and_policy, thread_native_id,
    thread_schedule_policy_param,
};
use thread_priority::{Error, ThreadPriority, ThreadPriorityValue};

use crate::ThreadError;

/// The scheduling of a thread, as far as it could be read.
#[derive(Clone, Copy)]
pub(super) struct Scheduling {
    cpus: Option<CpuSet>,
    policy: Option<(ThreadSchedulePolicy, ThreadPriority)>,
    niceness: Option<i32>,
}

impl Scheduling {
    pub(super) fn of_this_thread() -> Self {
        let policy = thread_schedule_policy_param(thread_native_id()).ok();
        let policy = policy.map(|(policy, parameters)| (policy, ThreadPriority::from_posix(parameters)));
        // On Linux, niceness is a property of the thread, and 0 denotes the calling thread.
        Self { cpus: sched_getaffinity(None).ok(), policy, niceness: getpriority_process(None).ok() }
    }

    /// Restores the scheduling of the calling thread. It does not exceed the scheduling with which the
    /// program was started, so the system allows it.
    pub(super) fn restore(self) {
        if let Some(cpus) = self.cpus {
            let _ = sched_setaffinity(None, &cpus);
        }
        match self.policy {
            Some((policy @ ThreadSchedulePolicy::Realtime(_), priority)) => {
                let _ = set_thread_priority_and_policy(thread_native_id(), priority, policy);
            }
            Some((policy @ ThreadSchedulePolicy::Normal(_), _)) => {
                // This sets the policy together with an inexact niceness. From the lowest niceness, if the
                // system grants it, every other one can be set; if it refuses, the thread keeps its niceness.
                let _ = set_thread_priority_and_policy(thread_native_id(), ThreadPriority::Max, policy);
                let _ = self.niceness.map(|niceness| setpriority_process(None, niceness));
            }
            None => {}
        }
    }
}

/// Lets the calling thread sleep no longer than it asks for, until this is dropped. By default the system may
/// prolong each sleep by 50 µs, to wake several threads together.
pub(crate) struct PromptTimers;

impl PromptTimers {
    pub(crate) fn start() -> Self {
        // An older system refuses; sleeps then take a little longer.
        let _ = set_current_timer_slack(Some(NonZeroU64::MIN));
        Self
    }
}

impl Drop for PromptTimers {
    fn drop(&mut self) {
        // Back to what the thread was started with.
        let _ = set_current_timer_slack(None);
    }
}

/// The time that the calling thread has spent on a processor.
pub(crate) fn processor_time() -> Option<Duration> {
    Duration::try_from(clock_gettime(ClockId::ThreadCPUTime)).ok()
}

pub(super) fn set_cpus(thread: &str, cpus: &[usize]) -> Result<(), ThreadError> {
    let mut set = CpuSet::new();
    cpus.iter().filter(|&&cpu| cpu < CpuSet::MAX_CPU).for_each(|&cpu| set.set(cpu));
    // The system silently drops CPUs that the program cannot use, and fails only if none is left.
    let applied = sched_setaffinity(None, &set).and_then(|()| sched_getaffinity(None));
    let usable = match applied {
        Ok(set) => set,
        Err(rustix::io::Errno::INVAL) => CpuSet::new(),
        Err(source) => {
            let (thread, cpus) = (thread.to_owned(), ranges(cpus.iter().copied()));
            return Err(ThreadError::Cpus { thread, cpus, source: source.into() });
        }
    };
    match cpus.iter().find(|&&cpu| !contains(&usable, cpu)) {
        None => Ok(()),
        Some(&cpu) => Err(ThreadError::NoSuchCpu { thread: thread.to_owned(), cpu, usable: usable_cpus() }),
    }
}

pub(super) fn set_fifo_priority(thread: &str, priority: u8) -> Result<(), ThreadError> {
    let value = ThreadPriorityValue::try_from(priority).map(ThreadPriority::Crossplatform);
    let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
    let applied = value.map_err(|_| io::Error::from(io::ErrorKind::InvalidInput)).and_then(|value| {
        set_thread_priority_and_policy(thread_native_id(), value, policy).map_err(os_error)
    });
    let thread = thread.to_owned();
    applied.map_err(|source| match source.kind() {
        io::ErrorKind::PermissionDenied => ThreadError::PriorityNotAllowed {
            thread,
            priority,
            user: std::env::var("USER").unwrap_or_else(|_| "your_user".into()),
            program: std::env::current_exe().map_or("this program".into(), |path| path.display().to_string()),
            source,
        },
        _ => ThreadError::Priority { thread, priority, source },
    })
}

fn os_error(error: Error) -> io::Error {
    match error {
        Error::OS(number) => io::Error::from_raw_os_error(number),
        other => io::Error::other(format!("{other:?}")),
    }
}

/// The CPUs that the program can use; found by asking for all.
fn usable_cpus() -> String {
    let mut all = CpuSet::new();
    (0..CpuSet::MAX_CPU).for_each(|cpu| all.set(cpu));
    let usable = sched_setaffinity(None, &all).and_then(|()| sched_getaffinity(None));
    usable
        .map_or("unknown".into(), |usable| ranges((0..CpuSet::MAX_CPU).filter(|&cpu| contains(&usable, cpu))))
}

fn contains(set: &CpuSet, cpu: usize) -> bool {
    cpu < CpuSet::MAX_CPU && set.is_set(cpu)
}

/// Formats CPU numbers as ranges, as in "0-3,6".
fn ranges(cpus: impl Iterator<Item = usize>) -> String {
    let mut ranges: Vec<(usize, usize)> = Vec::new();
    for cpu in cpus {
        match ranges.last_mut() {
            Some((_, last)) if *last + 1 == cpu => *last = cpu,
            _ => ranges.push((cpu, cpu)),
        }
    }
    let text = |&(first, last): &(usize, usize)| match last - first {
        0 => first.to_string(),
        1 => format!("{first},{last}"),
        _ => format!("{first}-{last}"),
    };
    ranges.iter().map(text).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // a test may fail
    use super::*;

    #[test]
    fn timers_are_prompt_until_they_are_dropped() {
        use rustix::thread::current_timer_slack;
        let before = current_timer_slack().unwrap();
        let prompt = PromptTimers::start();
        assert_eq!(current_timer_slack().unwrap(), 1);
        drop(prompt);
        assert_eq!(current_timer_slack().unwrap(), before);
    }

    #[test]
    fn cpus_are_listed_as_ranges() {
        assert_eq!(ranges([0, 1, 2, 3, 6, 8, 9].into_iter()), "0-3,6,8,9");
        assert_eq!(ranges(std::iter::empty()), "");
    }
}
