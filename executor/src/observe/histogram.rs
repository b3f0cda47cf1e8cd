//! Distributions of durations.

use std::time::Duration;

use hdrhistogram::Histogram;

use super::TimeStatistics;

/// The longest distinguished time; longer ones count as this.
const LONGEST: Duration = Duration::from_secs(60);

/// A distribution of times from 1 ns to 60 s with two significant digits, in 15 KiB of memory.
///
/// All memory is allocated at construction; recording allocates nothing.
pub(crate) struct TimeHistogram {
    counts: Histogram<u32>,
    count: u64,
    sum_ns: u64,
    max_ns: u64,
}

impl TimeHistogram {
    pub(crate) fn new() -> Self {
        #[expect(clippy::expect_used, reason = "the bounds are constants that the library accepts")]
        let counts = Histogram::new_with_bounds(1, nanoseconds(LONGEST), 2).expect("valid bounds");
        Self { counts, count: 0, sum_ns: 0, max_ns: 0 }
    }

    #[inline]
    pub(crate) fn record(&mut self, time: Duration) {
        let time_ns = nanoseconds(time);
        if self.counts.len() == u64::from(u32::MAX) {
            // A counter could overflow from here on, so the distribution starts again. Percentiles then cover
            // the times since.
            self.counts.reset();
        }
        self.counts.saturating_record(time_ns.max(1));
        self.count += 1;
        self.sum_ns = self.sum_ns.saturating_add(time_ns);
        self.max_ns = self.max_ns.max(time_ns);
    }

    /// Takes a few hundred nanoseconds, since it iterates over the distribution.
    pub(crate) fn statistics(&self) -> TimeStatistics {
        TimeStatistics {
            count: self.count,
            sum_ns: self.sum_ns,
            p50_ns: self.quantile(0.5),
            p99_ns: self.quantile(0.99),
            max_ns: self.max_ns,
        }
    }

    /// The upper end of the bucket that contains the quantile, but at most the maximum.
    fn quantile(&self, quantile: f64) -> u64 {
        if self.counts.is_empty() {
            return 0;
        }
        self.counts.value_at_quantile(quantile).min(self.max_ns)
    }
}

/// The time in nanoseconds; saturates after 584 years.
#[inline]
pub(crate) fn nanoseconds(time: Duration) -> u64 {
    time.as_secs().saturating_mul(1_000_000_000).saturating_add(u64::from(time.subsec_nanos()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(times_ns: impl IntoIterator<Item = u64>) -> TimeStatistics {
        let mut histogram = TimeHistogram::new();
        times_ns.into_iter().for_each(|time_ns| histogram.record(Duration::from_nanos(time_ns)));
        histogram.statistics()
    }

    #[test]
    fn percentiles_have_two_significant_digits() {
        for scale in [1, 1_000, 1_000_000] {
            let statistics = of((1..=1000).map(|time_ns| time_ns * scale));
            assert_eq!(statistics.count, 1000);
            assert_eq!(statistics.max_ns, 1000 * scale);
            assert_eq!(statistics.sum_ns, 500_500 * scale);
            let is_near = |actual: u64, exact: u64| actual.abs_diff(exact * scale) * 100 <= exact * scale;
            assert!(is_near(statistics.p50_ns, 500), "{statistics:?}");
            assert!(is_near(statistics.p99_ns, 990), "{statistics:?}");
        }
    }

    #[test]
    fn nothing_recorded_is_all_zero() {
        assert_eq!(of([]), TimeStatistics::default());
    }

    #[test]
    fn a_time_beyond_the_range_is_kept_as_the_maximum() {
        let hour_ns = 3_600_000_000_000;
        let statistics = of([5, hour_ns]);
        assert_eq!((statistics.max_ns, statistics.p50_ns), (hour_ns, 5));
        assert!(statistics.p99_ns >= nanoseconds(LONGEST) && statistics.p99_ns < nanoseconds(LONGEST) * 2);
    }

    #[test]
    fn a_percentile_is_never_above_the_maximum() {
        let statistics = of([1_000_003; 10]);
        assert_eq!((statistics.p50_ns, statistics.p99_ns), (1_000_003, 1_000_003));
    }

    #[test]
    fn the_memory_is_what_the_documentation_says() {
        let bytes = TimeHistogram::new().counts.distinct_values() * size_of::<u32>();
        assert!((14 * 1024..=15 * 1024).contains(&bytes), "{bytes} bytes");
    }
}
