//! Selects the cycles that are measured.

use std::hint::black_box;
use std::time::{Duration, Instant};

use super::histogram::nanoseconds;

/// The cost of measuring as a share of the core's busy time.
pub(crate) const SHARE: f64 = 0.005;

/// The minimum cost of a sleep before a cycle, for two context switches.
const SLEEP_NS: f64 = 2_000.0;

/// The approximate number of measured cycles in the running means.
const MEMORY: f64 = 32.0;

/// At least one of this number of cycles is measured.
const LONGEST_INTERVAL: f64 = 4096.0;

/// Selects the cycles that are measured, so that measuring costs at most one part in 200 of the core's busy
/// time.
///
/// The duration of a cycle and the cost of measuring it are averaged over the measured cycles; they determine
/// the mean interval between measured cycles. The interval varies at random around this mean, because modules
/// are periodic and might never run in a measured cycle at a fixed interval. The content of a cycle has no
/// influence on its selection, so the percentiles of measured cycles represent all cycles.
pub(crate) struct Sampler {
    /// The number of cycles until the next measured one.
    skip: u32,
    cost_ns: f64,
    busy_ns: f64,
    random: u64,
}

impl Sampler {
    pub(crate) fn new() -> Self {
        Self { skip: 0, cost_ns: 0.0, busy_ns: 0.0, random: 0x9E37_79B9_7F4A_7C15 }
    }

    /// True if the beginning cycle is to be measured.
    #[inline]
    pub(crate) fn takes_next(&mut self) -> bool {
        if self.skip == 0 {
            return true;
        }
        self.skip -= 1;
        false
    }

    /// Records a measured cycle that took `busy` without the `cost` of measuring it. `has_slept` is true if
    /// the core slept before it.
    pub(crate) fn measured(&mut self, busy: Duration, cost: Duration, has_slept: bool) {
        let busy_ns = nanoseconds(busy) as f64 + if has_slept { SLEEP_NS } else { 0.0 };
        let cost_ns = nanoseconds(cost) as f64;
        if self.busy_ns == 0.0 {
            (self.busy_ns, self.cost_ns) = (busy_ns, cost_ns);
        } else {
            self.busy_ns += (busy_ns - self.busy_ns) / MEMORY;
            self.cost_ns += (cost_ns - self.cost_ns) / MEMORY;
        }
        let interval = (self.cost_ns / (SHARE * self.busy_ns.max(1.0))).clamp(1.0, LONGEST_INTERVAL);
        // Uniform from 0 to twice the mean number of cycles to skip.
        self.skip = (self.next_random() * (2.0 * (interval - 1.0) + 1.0)) as u32;
    }

    /// A number from 0 to 1, by xorshift (Marsaglia 2003).
    fn next_random(&mut self) -> f64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        (self.random >> 11) as f64 / (1_u64 << 53) as f64
    }
}

/// The time that this machine takes to read the steady clock: 20 to 50 ns with the processor's counter, about
/// a microsecond without.
pub(crate) fn clock_reading_time() -> Duration {
    const READINGS: u32 = 64;
    let mut shortest = Duration::MAX;
    for _ in 0..3 {
        let begin = Instant::now();
        for _ in 1..READINGS {
            black_box(Instant::now());
        }
        shortest = shortest.min(begin.elapsed());
    }
    shortest / READINGS
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simulates cycles of the given durations; returns the share of time spent on measuring, and the number
    /// of measured cycles.
    fn share(cycles: u32, cost_ns: u64, has_slept: bool, busy_ns: impl Fn(u32) -> u64) -> (f64, u32) {
        let mut sampler = Sampler::new();
        let (mut cost, mut busy, mut measured) = (0, 0, 0);
        for cycle in 0..cycles {
            busy += busy_ns(cycle);
            if sampler.takes_next() {
                cost += cost_ns;
                measured += 1;
                let nanoseconds = Duration::from_nanos;
                sampler.measured(nanoseconds(busy_ns(cycle)), nanoseconds(cost_ns), has_slept);
            }
        }
        (cost as f64 / busy as f64, measured)
    }

    #[test]
    fn long_cycles_are_all_measured() {
        let (share, measured) = share(1000, 1_000, false, |_| 400_000);
        assert_eq!(measured, 1000);
        assert!(share < SHARE, "{share}");
    }

    #[test]
    fn short_cycles_cost_their_share() {
        for busy_ns in [30, 100, 1_000, 20_000] {
            let (share, measured) = share(1_000_000, 300, false, |_| busy_ns);
            assert!((0.5 * SHARE..1.2 * SHARE).contains(&share), "{busy_ns} ns: {share}");
            assert!(measured > 200, "{busy_ns} ns: {measured}");
        }
    }

    #[test]
    fn rare_long_cycles_among_short_ones_cost_their_share_too() {
        let (share, _) = share(1_000_000, 300, false, |cycle| if cycle % 97 == 0 { 50_000 } else { 100 });
        assert!((0.3 * SHARE..1.6 * SHARE).contains(&share), "{share}");
    }

    #[test]
    fn a_long_first_cycle_is_soon_forgotten() {
        let (share, _) = share(1_000_000, 300, false, |cycle| if cycle == 0 { 5_000_000 } else { 100 });
        assert!(share < 1.6 * SHARE, "{share}");
    }

    #[test]
    fn cycles_after_a_sleep_are_measured_more_often() {
        let (_, awake) = share(10_000, 100, false, |_| 100);
        let (_, slept) = share(10_000, 100, true, |_| 100);
        assert!(slept > 10 * awake, "{slept} {awake}");
    }

    #[test]
    fn modules_of_any_period_come_up_in_measured_cycles_as_often_as_they_run() {
        let mut sampler = Sampler::new();
        let (mut measured, mut with_module) = (0_u32, [0_u32; 12]);
        for cycle in 0..2_000_000_u32 {
            if !sampler.takes_next() {
                continue;
            }
            measured += 1;
            for (index, count) in with_module.iter_mut().enumerate() {
                *count += u32::from(cycle.is_multiple_of(index as u32 + 1));
            }
            sampler.measured(Duration::from_nanos(300), Duration::from_nanos(90), false);
        }
        for (index, count) in with_module.iter().enumerate() {
            let relative = f64::from(*count) * (index as f64 + 1.0) / f64::from(measured);
            assert!((0.9..1.1).contains(&relative), "period {}: {relative}", index + 1);
        }
    }

    #[test]
    fn the_time_to_read_the_clock_is_more_than_nothing() {
        assert!(clock_reading_time() > Duration::ZERO);
    }
}
