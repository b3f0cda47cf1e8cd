//! How much of a topic passes: fewer messages than the robot has, for a network or a display that needs fewer.

use downbeat_executor::Time;
use std::time::Duration;

/// How much of a topic passes. The three can be had together: the latest of a cycle, of these each n-th, of these no
/// more than the rate allows.
///
/// The time is that of the executor, so the same run lets the same messages pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Limits {
    /// The least time between two messages that pass, on average; 100 ms for 10 Hz.
    pub period: Option<Duration>,
    /// Each how many messages one passes, the first among them: 0 and 1 let all pass.
    pub every: u32,
    /// Which messages of one cycle pass.
    pub of_a_cycle: OfACycle,
}

/// Which of the messages that a topic carries in one cycle pass.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum OfACycle {
    /// All.
    #[default]
    All,
    /// Only the last.
    Latest,
}

/// Decides for the messages of one topic.
#[derive(Debug)]
pub(super) struct Limiter {
    limits: Limits,
    /// How many messages came, modulo `every`.
    count: u32,
    last: Option<Time>,
    next: Time,
}

impl Limiter {
    pub(super) fn new(limits: Limits) -> Self {
        Self { limits, count: 0, last: None, next: Time::ZERO }
    }

    /// True if a message of that time passes.
    pub(super) fn lets_pass(&mut self, time: Time) -> bool {
        self.is_nth() && self.is_in_time(time)
    }

    fn is_nth(&mut self) -> bool {
        let is_first = self.count == 0;
        self.count = (self.count + 1) % self.limits.every.max(1);
        is_first
    }

    /// Keeps the average rate where messages come a little late, and does not catch up after a pause.
    fn is_in_time(&mut self, time: Time) -> bool {
        let Some(period) = self.limits.period else { return true };
        // A clock that is set back, as by a bag that begins again, starts anew.
        let is_due = self.last.is_none_or(|last| time < last || time >= self.next);
        if is_due {
            let is_behind = self.last.is_none_or(|last| time < last) || time >= self.next + period;
            self.next = if is_behind { time + period } else { self.next + period };
        }
        self.last = Some(time);
        is_due
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn passing(limits: Limits, times_ms: impl IntoIterator<Item = i64>) -> Vec<i64> {
        let mut limiter = Limiter::new(limits);
        times_ms.into_iter().filter(|&ms| limiter.lets_pass(Time::from_nanos(ms * 1_000_000))).collect()
    }

    fn at_most_every(milliseconds: u64) -> Limits {
        Limits { period: Some(Duration::from_millis(milliseconds)), ..Limits::default() }
    }

    #[test]
    fn a_rate_is_kept_on_average() {
        let times = (0..125).map(|number| number * 8);
        assert_eq!(
            passing(at_most_every(100), times.clone()),
            [0, 104, 200, 304, 400, 504, 600, 704, 800, 904]
        );
        assert_eq!(passing(at_most_every(8), times.clone()).len(), 125);
        assert_eq!(passing(at_most_every(1), times).len(), 125);
    }

    #[test]
    fn after_a_pause_nothing_is_caught_up() {
        assert_eq!(passing(at_most_every(100), [0, 1000, 1010, 1090, 1100]), [0, 1000, 1100]);
    }

    #[test]
    fn a_clock_that_was_set_back_starts_anew() {
        assert_eq!(passing(at_most_every(100), [1000, 1050, 10, 50, 110]), [1000, 10, 110]);
    }

    #[test]
    fn each_nth_passes_the_first_among_them() {
        let every = |every| Limits { every, ..Limits::default() };
        assert_eq!(passing(every(3), 0..8), [0, 3, 6]);
        assert_eq!(passing(every(1), 0..3), [0, 1, 2]);
        assert_eq!(passing(Limits::default(), 0..3), [0, 1, 2]);
        let both = Limits { every: 2, ..at_most_every(5) };
        assert_eq!(passing(both, 0..16), [0, 6, 10]);
    }
}
