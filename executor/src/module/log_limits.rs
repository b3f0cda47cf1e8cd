//! When the limited log lines of a module were last written.

use std::time::Duration;

use crate::Time;

/// The limited log lines of a module, with the time at which each was last written.
#[derive(Default)]
pub(crate) struct LogLimits(Vec<Limit>);

struct Limit {
    /// The place in the source.
    site: &'static str,
    written: Time,
    suppressed: u64,
}

impl LogLimits {
    /// Returns `None` if the line of a call site has been written within `period` (or at all, without a
    /// period), otherwise the number of lines suppressed since then.
    pub(crate) fn is_due(&mut self, site: &'static str, now: Time, period: Option<Duration>) -> Option<u64> {
        let Some(limit) = self.0.iter_mut().find(|limit| limit.site == site) else {
            self.0.push(Limit { site, written: now, suppressed: 0 });
            return Some(0);
        };
        // A clock that went back starts a new period.
        let is_due = period.is_some_and(|period| now < limit.written || now >= limit.written + period);
        if !is_due {
            limit.suppressed += 1;
            return None;
        }
        limit.written = now;
        Some(std::mem::take(&mut limit.suppressed))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_place_counts_what_it_leaves_out_and_a_clock_that_goes_back_starts_again() {
        let mut limits = LogLimits::default();
        let second = Some(Duration::from_secs(1));
        let at = |ms: i64| Time::from_nanos(ms * 1_000_000);
        let due: Vec<_> = [0, 400, 999, 1000, 1500, 300].map(|ms| limits.is_due("a", at(ms), second)).into();
        assert_eq!(due, [Some(0), None, None, Some(2), None, Some(1)]);
        assert_eq!([0, 5000].map(|ms| limits.is_due("b", at(ms), None)), [Some(0), None]);
    }
}
