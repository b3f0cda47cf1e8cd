//! Statistics of the duration and regularity of cycles.

use std::collections::BTreeSet;
use std::fmt;
use std::time::Duration;

use downbeat_executor::{CoreHandle, TimeStatistics, Timing};

/// The times of a core, and of the loops of the robot's own modules.
#[derive(Default)]
pub(crate) struct Statistics {
    core: Option<CoreHandle>,
    modules: BTreeSet<String>,
}

impl Statistics {
    /// Reads the times of a core's cycles, and of the loops of these modules.
    pub(crate) fn of(core: CoreHandle, modules: impl IntoIterator<Item = String>) -> Self {
        Self { core: Some(core), modules: modules.into_iter().collect() }
    }

    pub(crate) fn collected(&self) -> Timing {
        let mut timing = self.core.as_ref().map(CoreHandle::timing).unwrap_or_default();
        timing.loops.retain(|known| self.modules.contains(&known.module));
        timing
    }
}

/// Shows median, 99th percentile and maximum.
pub(crate) struct Times(pub(crate) TimeStatistics);

impl fmt::Display for Times {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let TimeStatistics { p50_ns, p99_ns, max_ns, .. } = self.0;
        let [p50, p99, max] = [p50_ns, p99_ns, max_ns].map(Duration::from_nanos).map(short);
        write!(f, "p50 {p50}  p99 {p99}  max {max}")
    }
}

/// Three digits and a unit.
pub(crate) fn short(time: Duration) -> String {
    let nanoseconds = time.as_nanos() as f64;
    let (value, unit) = match time.as_nanos() {
        0..1_000 => (nanoseconds, "ns"),
        1_000..1_000_000 => (nanoseconds / 1e3, "µs"),
        1_000_000..1_000_000_000 => (nanoseconds / 1e6, "ms"),
        _ => (nanoseconds / 1e9, "s"),
    };
    let decimals = if value < 10.0 {
        2
    } else if value < 100.0 {
        1
    } else {
        0
    };
    format!("{value:.decimals$} {unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_short() {
        let times = [7, 1_500, 23_456_789, 8_000_000_000, 123_456].map(Duration::from_nanos).map(short);
        assert_eq!(times, ["7.00 ns", "1.50 µs", "23.5 ms", "8.00 s", "123 µs"]);
    }

    #[test]
    fn times_are_shown_as_median_percentile_and_maximum() {
        let times =
            TimeStatistics { p50_ns: 1_500, p99_ns: 23_500_000, max_ns: 8_000_000_000, ..Default::default() };
        assert_eq!(Times(times).to_string(), "p50 1.50 µs  p99 23.5 ms  max 8.00 s");
    }
}
