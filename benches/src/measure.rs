//! Measures several contestants in turns, so that the noise of a busy machine affects all of them alike.

use std::time::{Duration, Instant};

use crate::contestants::Contestant;

/// The extent of a measurement.
#[derive(Clone, Copy, Debug)]
pub struct Effort {
    /// The largest number of turns of each contestant. The best turn counts.
    pub rounds: u32,
    /// The shortest duration of a turn. Shorter trials are repeated, and their mean counts.
    pub turn: Duration,
    /// The time after which a contestant gets no more turns.
    pub budget: Duration,
}

/// Measures the time of a trial of each contestant.
///
/// The contestants take turns in several rounds, and the best turn of each counts, because disturbances only
/// make a turn longer.
pub fn best_of_rounds(contestants: &mut [Box<dyn Contestant>], effort: Effort) -> Vec<Duration> {
    let mut runners: Vec<Runner<'_>> =
        contestants.iter_mut().map(|contestant| Runner::new(&mut **contestant, effort.turn)).collect();
    for _ in 0..effort.rounds {
        for runner in runners.iter_mut().filter(|runner| runner.spent < effort.budget) {
            runner.turn();
        }
    }
    runners.iter().map(|runner| runner.best).collect()
}

/// The ratio of `time` to `other`.
#[must_use]
pub fn ratio(time: Duration, other: Duration) -> f64 {
    time.as_secs_f64() / other.as_secs_f64()
}

struct Runner<'a> {
    contestant: &'a mut dyn Contestant,
    trials_per_turn: u32,
    best: Duration,
    spent: Duration,
}

impl<'a> Runner<'a> {
    /// Determines the number of trials per turn. The first trials also allocate the memory that later ones
    /// reuse.
    fn new(contestant: &'a mut dyn Contestant, turn_length: Duration) -> Self {
        let mut runner = Self { contestant, trials_per_turn: 1, best: Duration::MAX, spent: Duration::ZERO };
        while runner.turn() < turn_length && runner.trials_per_turn < MAX_TRIALS {
            runner.trials_per_turn *= 2;
        }
        runner
    }

    fn turn(&mut self) -> Duration {
        let begin = Instant::now();
        for _ in 0..self.trials_per_turn {
            self.contestant.trial();
        }
        let elapsed = begin.elapsed();
        self.best = self.best.min(elapsed / self.trials_per_turn);
        self.spent += elapsed;
        elapsed
    }
}

const MAX_TRIALS: u32 = 1 << 20;

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    #[derive(Default)]
    struct Counting(Arc<AtomicU64>);

    impl Contestant for Counting {
        fn trial(&mut self) {
            self.0.fetch_add(1, Ordering::Relaxed);
        }

        fn finish(self: Box<Self>) -> u64 {
            self.0.load(Ordering::Relaxed)
        }
    }

    #[test]
    fn each_contestant_has_its_turn_in_each_round() {
        let counts = [Arc::default(), Arc::default()];
        let mut contestants = counts.clone().map(|count| Box::new(Counting(count)) as Box<dyn Contestant>);
        let effort = Effort { rounds: 3, turn: Duration::ZERO, budget: Duration::MAX };
        assert_eq!(best_of_rounds(&mut contestants, effort).len(), 2);
        // One more, for the turn that determines the number of trials.
        assert!(counts.iter().all(|count| count.load(Ordering::Relaxed) == 4));
    }

    #[test]
    fn a_contestant_that_has_used_up_its_time_has_no_more_turns() {
        let count = Arc::default();
        let mut contestants = [Box::new(Counting(Arc::clone(&count))) as Box<dyn Contestant>];
        best_of_rounds(&mut contestants, Effort { rounds: 3, turn: Duration::ZERO, budget: Duration::ZERO });
        assert_eq!(count.load(Ordering::Relaxed), 1);
    }
}
