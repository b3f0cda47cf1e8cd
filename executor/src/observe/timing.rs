//! Durations of cycles and regularity of loops, readable by other threads without waking the core.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::TimeStatistics;
use super::histogram::TimeHistogram;
use crate::Time;
use crate::threads::unpoisoned;

/// The durations of a core's cycles and the regularity of its detached modules, see
/// [`CoreHandle::timing`](crate::CoreHandle::timing).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// The number of cycles so far.
    pub cycles: u64,
    /// Durations of the measured cycles, with process and sync phase together.
    pub cycle: TimeStatistics,
    /// The detached modules that run at due times, by name.
    pub loops: Vec<LoopTiming>,
}

/// The runs of a detached module at due times.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LoopTiming {
    /// The module's name.
    pub module: String,
    /// Intervals between consecutive runs.
    pub period: TimeStatistics,
    /// Durations of the runs.
    pub busy: TimeStatistics,
}

/// The shared data of a [`Timing`]. Its lock is taken only in measured cycles and for runs of detached
/// modules.
pub(crate) struct SharedTiming {
    cycles: AtomicU64,
    measured: Mutex<Measured>,
}

struct Measured {
    cycle: TimeHistogram,
    loops: BTreeMap<String, Loop>,
}

struct Loop {
    last: Time,
    period: TimeHistogram,
    busy: TimeHistogram,
}

impl SharedTiming {
    pub(crate) fn new() -> Self {
        let measured = Measured { cycle: TimeHistogram::new(), loops: BTreeMap::new() };
        Self { cycles: AtomicU64::new(0), measured: Mutex::new(measured) }
    }

    #[inline]
    pub(crate) fn count_cycles(&self, cycles: u64) {
        self.cycles.store(cycles, Ordering::Relaxed);
    }

    /// Records a measured cycle.
    pub(crate) fn cycle_took(&self, time: Duration) {
        unpoisoned(self.measured.lock()).cycle.record(time);
    }

    pub(crate) fn cycle(&self) -> TimeStatistics {
        unpoisoned(self.measured.lock()).cycle.statistics()
    }

    /// Records a run of a detached module at the due time `time`.
    pub(crate) fn looped(&self, module: &str, time: Time, busy: Duration) {
        let loops = &mut unpoisoned(self.measured.lock()).loops;
        match loops.get_mut(module) {
            Some(known) => {
                known.period.record(time.saturating_since(std::mem::replace(&mut known.last, time)));
                known.busy.record(busy);
            }
            None => {
                let mut new = Loop { last: time, period: TimeHistogram::new(), busy: TimeHistogram::new() };
                new.busy.record(busy);
                loops.insert(module.to_owned(), new);
            }
        }
    }

    pub(crate) fn timing(&self) -> Timing {
        let measured = unpoisoned(self.measured.lock());
        let loops = measured.loops.iter().map(|(module, known)| LoopTiming {
            module: module.clone(),
            period: known.period.statistics(),
            busy: known.busy.statistics(),
        });
        Timing {
            cycles: self.cycles.load(Ordering::Relaxed),
            cycle: measured.cycle.statistics(),
            loops: loops.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_period_of_a_loop_is_counted_from_run_to_run() {
        let timing = SharedTiming::new();
        for milliseconds in [0, 8, 16] {
            timing.looped("hardware", Time::from_nanos(milliseconds * 1_000_000), Duration::from_millis(7));
        }
        let loops = timing.timing().loops;
        assert_eq!(loops.len(), 1);
        assert_eq!((loops[0].period.count, loops[0].busy.count), (2, 3));
        assert!((7_900_000..=8_100_000).contains(&loops[0].period.p50_ns), "{loops:?}");
    }
}
