//! A limit on expensive steps that others can cause.

use std::time::{Duration, Instant};

/// Permits a number of steps at once, and then one each time a period has passed.
#[derive(Debug)]
pub(super) struct Flood {
    most: u32,
    period: Duration,
    left: u32,
    since: Instant,
}

impl Flood {
    pub(super) fn new(most: u32, period: Duration, now: Instant) -> Self {
        Self { most, period, left: most, since: now }
    }

    /// Returns whether a step is permitted now.
    pub(super) fn permits(&mut self, now: Instant) -> bool {
        let passed = now.saturating_duration_since(self.since).as_nanos() / self.period.as_nanos().max(1);
        if passed > 0 {
            self.left = self.left.saturating_add(u32::try_from(passed).unwrap_or(u32::MAX)).min(self.most);
            self.since = now;
        }
        let is_permitted = self.left > 0;
        self.left = self.left.saturating_sub(1);
        is_permitted
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_burst_is_permitted_and_then_one_in_each_period() {
        let start = Instant::now();
        let mut flood = Flood::new(3, Duration::from_millis(10), start);
        let mut permitted = |ms| flood.permits(start + Duration::from_millis(ms));
        assert_eq!([0, 0, 0, 0, 9].map(&mut permitted), [true, true, true, false, false]);
        assert_eq!([10, 11, 1000, 1000, 1000, 1000].map(permitted), [true, false, true, true, true, false]);
    }
}
