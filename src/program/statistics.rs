//! Statistics of the duration and regularity of cycles.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

use downbeat_executor::{CycleReport, Probe, StepReport, Time};
use hdrhistogram::Histogram;

/// Collects the reports of a core.
#[derive(Default)]
pub(crate) struct Statistics {
    /// The modules whose loops are reported: those of the robot, without observers.
    modules: BTreeSet<String>,
    collected: Mutex<Collected>,
}

#[derive(Default, Clone)]
pub(crate) struct Collected {
    /// Cycles so far.
    pub(crate) cycles: u64,
    /// Process and sync phase together.
    pub(crate) cycle: Times,
    /// The robot's detached modules with a timer, by name.
    pub(crate) detached: BTreeMap<String, Loop>,
}

/// The runs of a detached module for which a timer was due.
#[derive(Default, Clone)]
pub(crate) struct Loop {
    last: Option<Time>,
    /// From one to the next.
    pub(crate) period: Times,
    /// How long they took.
    pub(crate) busy: Times,
}

impl Statistics {
    /// Collects the times of cycles, and of the loops of these modules.
    pub(crate) fn of(modules: impl IntoIterator<Item = String>) -> Self {
        Self { modules: modules.into_iter().collect(), ..Self::default() }
    }

    pub(crate) fn collected(&self) -> Collected {
        self.lock().clone()
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Collected> {
        self.collected.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Probe for Statistics {
    fn cycle(&self, report: &CycleReport) {
        let mut collected = self.lock();
        collected.cycles += 1;
        collected.cycle.add(report.process + report.sync);
    }

    fn step(&self, report: &StepReport<'_>) {
        if report.lateness.is_none() || !self.modules.contains(report.module) {
            return;
        }
        let mut collected = self.lock();
        if !collected.detached.contains_key(report.module) {
            collected.detached.insert(report.module.to_owned(), Loop::default());
        }
        let Some(module) = collected.detached.get_mut(report.module) else { return };
        if let Some(last) = module.last.replace(report.time) {
            module.period.add(report.time.saturating_since(last));
        }
        module.busy.add(report.duration);
    }
}

/// A distribution of times from 100 ns to 100 s, with three digits.
#[derive(Clone)]
pub(crate) struct Times(Histogram<u64>);

impl Default for Times {
    fn default() -> Self {
        #[expect(clippy::expect_used, reason = "the bounds are constants that the library accepts")]
        Self(Histogram::new_with_bounds(100, 100_000_000_000, 3).expect("valid bounds"))
    }
}

impl Times {
    fn add(&mut self, time: Duration) {
        self.0.saturating_record(u64::try_from(time.as_nanos()).unwrap_or(u64::MAX));
    }

    fn at(&self, quantile: f64) -> Duration {
        Duration::from_nanos(self.0.value_at_quantile(quantile))
    }
}

impl fmt::Display for Times {
    /// Median, 99th percentile and maximum.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [p50, p99, max] = [self.at(0.5), self.at(0.99), Duration::from_nanos(self.0.max())].map(short);
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
    fn the_period_of_a_loop_is_counted_between_runs_for_which_a_timer_was_due() {
        let statistics = Statistics::of(["hardware".to_owned()]);
        let step = |module, milliseconds: i64, lateness| StepReport {
            module,
            step: 0,
            time: Time::from_nanos(milliseconds * 1_000_000),
            lateness,
            duration: Duration::from_millis(7),
        };
        let due = Some(Duration::ZERO);
        for (milliseconds, lateness) in [(0, due), (3, None), (8, due), (16, due)] {
            statistics.step(&step("hardware", milliseconds, lateness));
            statistics.step(&step("watcher", milliseconds, lateness));
        }
        let collected = statistics.collected();
        assert_eq!(collected.detached.len(), 1);
        let hardware = &collected.detached["hardware"];
        assert_eq!(hardware.period.0.len(), 2);
        assert!(hardware.period.to_string().starts_with("p50 8.0"), "{}", hardware.period);
    }
}
