//! Time as an input: the executor reads a [`Clock`] once per cycle, and modules read the time from their
//! context.

use std::sync::atomic::{AtomicI64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

use crate::Time;

/// The source of the executor's time.
pub trait Clock: Send + Sync {
    /// The current time. It may go back only if the time comes from outside, for example from a simulator
    /// that restarts. Timers whose last time then lies ahead are next due one period after the new time;
    /// tasks and the time-outs of calls keep their times.
    ///
    /// If the clock moves by other steps than the machine's clock, its owner calls
    /// [`CoreHandle::clock_moved`](crate::CoreHandle::clock_moved) after each step.
    fn now(&self) -> Time;

    /// True if this clock advances by itself. If it does not, the executor never waits for it, and modules
    /// registered as detached run inside the cycle.
    fn runs_by_itself(&self) -> bool;
}

/// The machine's clock as one timeline that never goes back.
///
/// It follows the monotonic clock and is drawn towards the system clock by at most one part in a thousand, so
/// that the corrections of a time server neither repeat nor skip timer ticks. If the system clock is more
/// than a second ahead (it was set after boot, or the machine was suspended), this clock jumps to it.
pub struct SystemClock {
    last: Mutex<Reading>,
}

#[derive(Clone, Copy)]
struct Reading {
    steady: Instant,
    time_ns: i64,
}

const JUMP_NS: i64 = 1_000_000_000;

impl SystemClock {
    /// A clock that starts at the current system time.
    #[must_use]
    pub fn new() -> Self {
        Self { last: Mutex::new(Reading { steady: Instant::now(), time_ns: system_time_ns() }) }
    }
}

impl Default for SystemClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for SystemClock {
    fn now(&self) -> Time {
        // Nothing panics while it is locked.
        let mut last = self.last.lock().unwrap_or_else(PoisonError::into_inner);
        let steady = Instant::now();
        let elapsed = i64::try_from((steady - last.steady).as_nanos()).unwrap_or(i64::MAX);
        let time_ns = follow(last.time_ns, elapsed, system_time_ns());
        *last = Reading { steady, time_ns };
        Time::from_nanos(time_ns)
    }

    fn runs_by_itself(&self) -> bool {
        true
    }
}

fn follow(last_ns: i64, elapsed_ns: i64, system_ns: i64) -> i64 {
    let predicted = last_ns.saturating_add(elapsed_ns);
    let error = system_ns.saturating_sub(predicted);
    if error > JUMP_NS { system_ns } else { predicted + error.clamp(-elapsed_ns / 1000, elapsed_ns / 1000) }
}

fn system_time_ns() -> i64 {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or(Duration::ZERO);
    i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX)
}

/// A clock that stands still until it is set, for replay and for tests. Clones share the time.
#[derive(Clone, Debug, Default)]
pub struct ManualClock {
    time_ns: Arc<AtomicI64>,
}

impl ManualClock {
    /// A clock that shows `time`.
    #[must_use]
    pub fn new(time: Time) -> Self {
        Self { time_ns: Arc::new(AtomicI64::new(time.as_nanos())) }
    }

    /// Moves the clock to `time`; an earlier time is ignored.
    pub fn set(&self, time: Time) {
        self.time_ns.fetch_max(time.as_nanos(), Ordering::SeqCst);
    }

    /// Moves the clock on by `step`.
    pub fn advance(&self, step: Duration) {
        self.set(self.now() + step);
    }
}

impl Clock for ManualClock {
    fn now(&self) -> Time {
        Time::from_nanos(self.time_ns.load(Ordering::SeqCst))
    }

    fn runs_by_itself(&self) -> bool {
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_corrections_of_the_system_clock_are_followed_slowly() {
        assert_eq!(follow(1_000_000, 100_000, 1_100_000), 1_100_000);
        assert_eq!(follow(1_000_000, 100_000, 9_000_000), 1_100_100);
        assert_eq!(follow(1_000_000, 100_000, -9_000_000), 1_099_900);
    }

    #[test]
    fn a_system_clock_far_ahead_is_jumped_to_and_one_far_behind_is_not() {
        assert_eq!(follow(0, 10, 5_000_000_000), 5_000_000_000);
        assert_eq!(follow(5_000_000_000, 1000, 0), 5_000_000_999);
    }

    #[test]
    fn a_manual_clock_never_goes_back() {
        let clock = ManualClock::new(Time::from_nanos(10));
        clock.set(Time::from_nanos(5));
        assert_eq!(clock.now(), Time::from_nanos(10));
        clock.advance(Duration::from_nanos(1));
        assert_eq!(clock.now(), Time::from_nanos(11));
    }
}
