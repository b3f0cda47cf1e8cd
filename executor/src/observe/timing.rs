//! How long cycles take and how regular loops are, for threads that look at a core without waking it.

use std::collections::BTreeMap;
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use super::TimeStatistics;
use super::histogram::TimeHistogram;
use crate::Time;
use crate::threads::unpoisoned;

/// How long the cycles of a core take and how regular its detached modules are, see
/// [`CoreHandle::timing`](crate::CoreHandle::timing).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Timing {
    /// How many cycles there have been.
    pub cycles: u64,
    /// Process and sync phase together, of the cycles that were measured.
    pub cycle: TimeStatistics,
    /// The detached modules that run by a timer, by name.
    pub loops: Vec<LoopTiming>,
}

/// The runs of a detached module for which a time was due.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct LoopTiming {
    /// The module's name.
    pub module: String,
    /// From one to the next.
    pub period: TimeStatistics,
    /// How long they took.
    pub busy: TimeStatistics,
}

/// A [`Timing`] in the making. Its lock is taken in measured cycles only, and for runs of detached modules.
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

    /// A cycle was measured.
    pub(crate) fn cycle_took(&self, time: Duration) {
        unpoisoned(self.measured.lock()).cycle.record(time);
    }

    pub(crate) fn cycle(&self) -> TimeStatistics {
        unpoisoned(self.measured.lock()).cycle.statistics()
    }

    /// A detached module ran at `time`, which was due.
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
