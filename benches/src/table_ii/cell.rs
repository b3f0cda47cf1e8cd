//! One cell of the grid: all contestants in the same run.

use std::time::Duration;

use anyhow::ensure;
use serde::Serialize;

use super::published;
use crate::Load;
use crate::contestants::{Contestant, Downbeat, Limit, LimitOnTwoThreads, LockFree, Locked, Queues};
use crate::launchers::{LAUNCHERS, LINEAR, POOL_2};
use crate::measure::{Effort, best_of_rounds, ratio};

/// The times of one trial of each contestant.
#[derive(Clone, Debug)]
pub struct CellResult {
    /// The load of a trial.
    pub load: Load,
    /// The time of downbeat under each launcher, by the launcher's name.
    pub ours: Vec<(&'static str, Duration)>,
    /// The time of the plain loop.
    pub limit: Duration,
    /// The time of the plain loop on two threads.
    pub limit_on_two_threads: Duration,
    /// The time of the published design with lock-free queues.
    pub lock_free_queues: Duration,
    /// The time of the published design with queues behind locks.
    pub locked_queues: Duration,
}

/// downbeat under one launcher, compared with the others.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The number of subscribing modules.
    pub modules: u64,
    /// The number of messages.
    pub messages: u64,
    /// The launcher of the process phase.
    pub launcher: &'static str,
    /// From the first publish to the last delivery.
    pub ms: f64,
    /// The time divided by the number of deliveries.
    pub ns_per_delivery: f64,
    /// The time divided by that of the limit.
    pub ratio_to_limit: f64,
    /// The time of the faster form of the published design, divided by ours.
    pub ratio_to_queue_design: f64,
    /// The published time divided by ours, if a time is published. If the published time is "less than", this
    /// is an upper bound.
    pub ratio_to_published: Option<f64>,
}

/// Runs the trials of a cell.
///
/// # Errors
/// If a launcher cannot start its threads, or if a contestant did not deliver each message to each
/// subscriber.
pub fn measure(load: Load, effort: Effort) -> anyhow::Result<CellResult> {
    let mut contestants: Vec<Box<dyn Contestant>> = vec![
        Box::new(Limit::new(load)),
        Box::new(LimitOnTwoThreads::new(load)),
        Box::new(Queues::<LockFree>::new(load)),
        Box::new(Queues::<Locked>::new(load)),
    ];
    for launcher in LAUNCHERS {
        contestants.push(Box::new(Downbeat::new(load, launcher)?));
    }
    let times = best_of_rounds(&mut contestants, effort);
    let [limit, limit_on_two_threads, lock_free_queues, locked_queues] =
        [times[0], times[1], times[2], times[3]];
    let ours = LAUNCHERS.iter().map(|launcher| launcher.name).zip(times[4..].iter().copied()).collect();
    for contestant in contestants {
        let (sum, of_a_trial) = (contestant.finish(), load.expected_sum());
        // The sum of a trial stays below 2^44, and a trial is repeated at most 2^20 times in each of a few
        // turns.
        let is_whole = sum > 0 && sum.is_multiple_of(of_a_trial);
        ensure!(
            is_whole,
            "{load:?}: the sums add up to {sum}, not to a multiple of {of_a_trial}: messages were lost"
        );
    }
    Ok(CellResult { load, ours, limit, limit_on_two_threads, lock_free_queues, locked_queues })
}

impl CellResult {
    /// The gain of Pool(2) over one thread, divided by the gain of the limit on two threads over one.
    #[must_use]
    pub fn gain_of_pool(&self) -> Option<f64> {
        let time_of = |name| self.ours.iter().find(|(known, _)| *known == name).map(|&(_, time)| time);
        let gain = ratio(time_of(LINEAR)?, time_of(POOL_2)?);
        Some(gain / ratio(self.limit, self.limit_on_two_threads))
    }

    /// The faster of the two forms of the published design.
    #[must_use]
    pub fn queue_design(&self) -> Duration {
        self.lock_free_queues.min(self.locked_queues)
    }

    /// The results of downbeat, one row per launcher.
    pub fn rows(&self) -> impl Iterator<Item = Row> {
        self.ours.iter().map(|&(launcher, time)| Row {
            modules: self.load.modules,
            messages: self.load.messages,
            launcher,
            ms: time.as_secs_f64() * 1e3,
            ns_per_delivery: time.as_secs_f64() * 1e9 / self.load.deliveries() as f64,
            ratio_to_limit: ratio(time, self.limit),
            ratio_to_queue_design: ratio(self.queue_design(), time),
            ratio_to_published: published(self.load).map(|published| ratio(published.bound(), time)),
        })
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::num::NonZeroU64;

    use super::*;

    fn result(modules: u64, messages: u64) -> CellResult {
        let load = Load { modules, messages, batch: NonZeroU64::new(1000).unwrap() };
        let ms = Duration::from_millis;
        let ours = vec![("Linear", ms(200))];
        CellResult {
            load,
            ours,
            limit: ms(100),
            limit_on_two_threads: ms(50),
            lock_free_queues: ms(9000),
            locked_queues: ms(8000),
        }
    }

    #[test]
    fn the_ratios_say_how_much_slower_than_the_limit_and_how_much_faster_than_the_others() {
        let rows: Vec<Row> = result(1000, 100_000).rows().collect();
        assert_eq!((rows[0].ms, rows[0].ns_per_delivery), (200.0, 2.0));
        assert_eq!((rows[0].ratio_to_limit, rows[0].ratio_to_queue_design), (2.0, 40.0));
        assert_eq!(rows[0].ratio_to_published, Some(13.508 / 0.2));
    }

    #[test]
    fn a_cell_that_is_not_known_from_the_publication_has_no_ratio_to_it() {
        let result = result(10, 1000);
        assert!(result.rows().all(|row| row.ratio_to_published.is_none()));
    }
}
