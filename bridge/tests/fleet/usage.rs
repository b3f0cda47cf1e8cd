//! What processes cost, as Linux says under `/proc`.

use std::fmt::{Display, Formatter, Result};
use std::time::Duration;

/// Linux counts processor time in units of 10 ms.
const TICK: Duration = Duration::from_millis(10);

/// The processor time and the memory of some processes.
pub struct Usage {
    processes: usize,
    processor: Duration,
    /// Each process's share of what several have in common.
    kilobytes: u64,
}

impl Usage {
    pub fn of_all(ids: &[u32]) -> Self {
        let mut usage = Self { processes: ids.len(), processor: Duration::ZERO, kilobytes: 0 };
        for id in ids {
            let stat = std::fs::read_to_string(format!("/proc/{id}/stat")).unwrap();
            // After the name, which may have spaces: state, then ten numbers, then user and system time.
            let after_name = stat.rsplit_once(") ").unwrap().1;
            let ticks = after_name.split(' ').skip(11).take(2).map(|ticks| ticks.parse::<u32>().unwrap());
            usage.processor += TICK * ticks.sum::<u32>();
            let memory = std::fs::read_to_string(format!("/proc/{id}/smaps_rollup")).unwrap();
            let pss = memory.lines().find_map(|line| line.strip_prefix("Pss:")).unwrap();
            usage.kilobytes += pss.trim().trim_end_matches(" kB").parse::<u64>().unwrap();
        }
        usage
    }

    /// What each of them costs on average.
    pub fn since(&self, before: &Self, wall: Duration) -> impl Display {
        let processes = self.processes as f64;
        let processor = (self.processor - before.processor).as_secs_f64() / wall.as_secs_f64() / processes;
        Cost { percent: 100.0 * processor, megabytes: self.kilobytes as f64 / 1000.0 / processes }
    }
}

struct Cost {
    percent: f64,
    megabytes: f64,
}

impl Display for Cost {
    fn fmt(&self, formatter: &mut Formatter<'_>) -> Result {
        write!(formatter, "{:.1} % of a core, {:.1} MB", self.percent, self.megabytes)
    }
}
