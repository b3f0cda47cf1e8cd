//! Periodic timers on the time of the core.

use std::time::Duration;

use crate::Time;

/// When a timer fires next. Its due times are multiples of the period after the start, so that a late
/// cycle does not shift the later ones; due times that were missed are skipped, not made up for.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Timer {
    period: Duration,
    due: Time,
}

impl Timer {
    /// A timer that has not started; `period` is longer than zero.
    pub(crate) fn new(period: Duration) -> Self {
        Self { period, due: Time::MAX }
    }

    pub(crate) fn start(&mut self, now: Time) {
        self.due = now + self.period;
    }

    /// Time has gone back to `now`. A timer whose last due time lies ahead then would be silent until it has come again: it is
    /// due after one period, as those of rcl are (`rcl/src/rcl/timer.c`).
    pub(crate) fn go_back(&mut self, now: Time) {
        if self.due < Time::MAX && self.due > now + self.period {
            self.start(now);
        }
    }

    pub(crate) fn stop(&mut self) {
        self.due = Time::MAX;
    }

    pub(crate) fn due(&self) -> Time {
        self.due
    }

    /// True if the timer is due; it is then set to the next multiple of its period after `now`.
    pub(crate) fn fire(&mut self, now: Time) -> bool {
        if now < self.due {
            return false;
        }
        self.due = self.due + self.period;
        if self.due <= now {
            // The periods may be more than a `Duration` can be multiplied with: a clock that is set may
            // jump by decades.
            let periods = now.saturating_since(self.due).as_nanos() / self.period.as_nanos() + 1;
            let step = periods.saturating_mul(self.period.as_nanos());
            self.due = self.due + Duration::from_nanos(u64::try_from(step).unwrap_or(u64::MAX));
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_late_timer_keeps_its_phase_and_skips_what_it_missed() {
        let mut timer = Timer::new(Duration::from_nanos(10));
        timer.start(Time::from_nanos(100));
        assert!(!timer.fire(Time::from_nanos(109)));
        assert!(timer.fire(Time::from_nanos(113)));
        assert_eq!(timer.due(), Time::from_nanos(120));
        assert!(timer.fire(Time::from_nanos(150)));
        assert_eq!(timer.due(), Time::from_nanos(160));
        assert!(!timer.fire(Time::from_nanos(159)));
    }

    #[test]
    fn a_timer_is_due_after_one_period_when_time_has_gone_back() {
        let mut timer = Timer::new(Duration::from_nanos(10));
        timer.go_back(Time::ZERO);
        assert_eq!(timer.due(), Time::MAX, "it has not started");
        timer.start(Time::from_nanos(100));
        timer.go_back(Time::from_nanos(105));
        assert_eq!(timer.due(), Time::from_nanos(110), "not further than to its last due time");
        timer.go_back(Time::from_nanos(3));
        assert_eq!(timer.due(), Time::from_nanos(13));
    }

    #[test]
    fn a_timer_fires_once_when_the_clock_is_set_from_the_epoch_to_today() {
        let mut timer = Timer::new(Duration::from_millis(8));
        timer.start(Time::ZERO);
        let today = Time::from_nanos(1_795_000_000_000_000_001);
        assert!(timer.fire(today));
        assert!(!timer.fire(today));
        assert_eq!(timer.due(), Time::from_nanos(1_795_000_000_008_000_000));
    }
}
