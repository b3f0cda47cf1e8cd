//! Goals, and the check whether they are reached.

use std::time::Duration;

use super::{CellResult, Row};
use crate::launchers::{LINEAR, POOL_2};

/// A goal and the measured value.
#[derive(Clone, Debug)]
pub struct Goal {
    /// The condition.
    pub claim: &'static str,
    /// The measured value with its unit; `None` if the cell was not measured.
    pub measured: Option<String>,
    /// True if the condition holds.
    pub is_reached: bool,
}

/// Compares each goal with the results.
#[must_use]
pub fn goals(results: &[CellResult]) -> Vec<Goal> {
    let (largest, smallest) = ((1000, 100_000), (10, 100));
    let largest_linear = row(results, largest, LINEAR);
    let largest_pool = row(results, largest, POOL_2);
    let to_limit = largest_linear.as_ref().map(|row| row.ratio_to_limit);
    let largest_cell = results.iter().find(|cell| (cell.load.modules, cell.load.messages) == largest);
    let times_linear = |time: Duration| largest_linear.as_ref().map(|row| time.as_secs_f64() * 1e3 / row.ms);
    let to_lock_free = largest_cell.and_then(|cell| times_linear(cell.lock_free_queues));
    let to_locked = largest_cell.and_then(|cell| times_linear(cell.locked_queues));
    let to_published = largest_linear.as_ref().and_then(|row| row.ratio_to_published);
    let pool_to_published = largest_pool.as_ref().and_then(|row| row.ratio_to_published);
    let gain_of_pool = largest_cell.and_then(CellResult::gain_of_pool);
    let smallest_to_limit = row(results, smallest, LINEAR).map(|row| row.ratio_to_limit);
    let smallest_us = row(results, smallest, LINEAR).map(|row| row.ms * 1e3);
    vec![
        at_most(1.2, "x", "1000 x 100000, Linear: at most 1.2 times the limit", to_limit),
        at_least(35.0, "1000 x 100000, Linear: at least 35 times faster than queues, SegQueue", to_lock_free),
        at_least(35.0, "1000 x 100000, Linear: at least 35 times faster than queues, Mutex", to_locked),
        at_least(60.0, "1000 x 100000, Linear: at least 60 times faster than published", to_published),
        at_least(
            100.0,
            "1000 x 100000, Pool(2): at least 100 times faster than published",
            pool_to_published,
        ),
        at_least(
            0.9,
            "1000 x 100000, Pool(2): at least 0.9 of the limit's gain with two threads",
            gain_of_pool,
        ),
        at_most(1.3, "x", "10 x 100, Linear: at most 1.3 times the limit", smallest_to_limit),
        at_most(15.0, " µs", "10 x 100, Linear: at most 15 µs all in", smallest_us),
    ]
}

fn row(results: &[CellResult], (modules, messages): (u64, u64), launcher: &str) -> Option<Row> {
    let mut rows = results.iter().flat_map(CellResult::rows);
    rows.find(|row| (row.modules, row.messages, row.launcher) == (modules, messages, launcher))
}

fn at_most(bound: f64, unit: &str, claim: &'static str, measured: Option<f64>) -> Goal {
    let is_reached = measured.is_some_and(|measured| measured <= bound);
    Goal { claim, measured: measured.map(|measured| format!("{measured:.2}{unit}")), is_reached }
}

fn at_least(bound: f64, claim: &'static str, measured: Option<f64>) -> Goal {
    let is_reached = measured.is_some_and(|measured| measured >= bound);
    Goal { claim, measured: measured.map(|measured| format!("{measured:.2}x")), is_reached }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use std::num::NonZeroU64;
    use std::time::Duration;

    use super::*;
    use crate::Load;

    #[test]
    fn a_goal_is_reached_by_what_was_measured_and_not_otherwise() {
        let ms = Duration::from_millis;
        let result = CellResult {
            load: Load { modules: 1000, messages: 100_000, batch: NonZeroU64::new(1000).unwrap() },
            ours: vec![(LINEAR, ms(220)), (POOL_2, ms(140))],
            limit: ms(200),
            limit_on_two_threads: ms(110),
            lock_free_queues: ms(7000),
            locked_queues: ms(8000),
        };
        let reached: Vec<bool> = goals(&[result]).iter().map(|goal| goal.is_reached).collect();
        assert_eq!(reached, [true, false, true, true, false, false, false, false]);
        assert!(goals(&[]).iter().all(|goal| !goal.is_reached && goal.measured.is_none()));
    }
}
