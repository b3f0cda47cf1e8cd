//! What a look at a running core shows.

use crate::Time;

/// The state of a core between two cycles: plain numbers, counted since its start.
///
/// Rates come from two snapshots: the difference of two counts over the difference of
/// [`uptime_ns`](Self::uptime_ns).
///
/// ```
/// use downbeat_executor::Snapshot;
///
/// fn cycles_per_second(earlier: &Snapshot, later: &Snapshot) -> f64 {
///     let cycles = later.cycle - earlier.cycle;
///     cycles as f64 * 1e9 / later.uptime_ns.saturating_sub(earlier.uptime_ns).max(1) as f64
/// }
///
/// let earlier = Snapshot { cycle: 100, uptime_ns: 1_000_000_000, ..Snapshot::default() };
/// let later = Snapshot { cycle: 350, uptime_ns: 3_000_000_000, ..Snapshot::default() };
/// assert_eq!(cycles_per_second(&earlier, &later), 125.0);
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Snapshot {
    /// The core's time in the last cycle; nanoseconds where it is serialised.
    #[cfg_attr(feature = "serde", serde(rename = "time_ns", with = "time_ns"))]
    pub time: Time,
    /// Nanoseconds of steady time since the core's start, to compute rates with. Where the clock is moved by hand,
    /// this goes on by itself all the same.
    pub uptime_ns: u64,
    /// How many cycles there have been.
    pub cycle: u64,
    /// True while no cycles run because somebody asked for that.
    pub is_paused: bool,
    /// What the cycles took.
    pub cycles: CycleStatistics,
    /// The modules, in the order of registration.
    pub modules: Vec<ModuleStatistics>,
    /// The topics, in the order in which they were first declared.
    pub topics: Vec<TopicStatistics>,
    /// The inboxes of outlets, in the order in which they were first used.
    #[cfg_attr(feature = "serde", serde(default))]
    pub outlets: Vec<OutletStatistics>,
}

/// Times of the measured part of many runs or cycles. All zero where nothing was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TimeStatistics {
    /// How many were measured.
    pub count: u64,
    /// Their sum, in nanoseconds.
    pub sum_ns: u64,
    /// The median of those measured, in nanoseconds, with two significant digits.
    pub p50_ns: u64,
    /// The 99th percentile of those measured, in nanoseconds, with two significant digits.
    pub p99_ns: u64,
    /// The longest of those measured, in nanoseconds, exactly.
    pub max_ns: u64,
}

impl TimeStatistics {
    /// The mean of those measured, in nanoseconds; 0 where nothing was.
    #[must_use]
    pub fn mean_ns(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum_ns as f64 / self.count as f64 }
    }
}

/// What the cycles took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CycleStatistics {
    /// The process phase, in which the modules run.
    pub process: TimeStatistics,
    /// The sync phase.
    pub sync: TimeStatistics,
    /// Both phases together.
    pub total: TimeStatistics,
    /// How long cycles that were begun for a timer began after its time.
    pub lateness: TimeStatistics,
    /// What measuring itself has cost, in nanoseconds.
    pub measuring_ns: u64,
}

/// Whether a module runs, and if not, why.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum ModuleState {
    /// Set up, not yet configured.
    Unconfigured,
    /// Configured, not active.
    Inactive,
    /// Runs.
    #[default]
    Active,
    /// Held by a request to pause it.
    Paused,
    /// It panicked and waits for the time at which it is started again.
    Restarting,
    /// It panicked and stays stopped.
    Failed,
    /// At its end.
    Finalized,
}

impl std::fmt::Display for ModuleState {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.pad(match self {
            Self::Unconfigured => "unconfigured",
            Self::Inactive => "inactive",
            Self::Active => "active",
            Self::Paused => "paused",
            Self::Restarting => "restarting",
            Self::Failed => "failed",
            Self::Finalized => "finalized",
        })
    }
}

/// What a module has done.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ModuleStatistics {
    /// The name.
    pub name: String,
    /// Whether it runs.
    pub state: ModuleState,
    /// True if it runs on a thread and at a pace of its own.
    pub is_detached: bool,
    /// How often it ran.
    pub runs: u64,
    /// Messages it was given.
    pub received: u64,
    /// Messages it published.
    pub published: u64,
    /// Runs that took longer than its deadline.
    pub overruns: u64,
    /// How often it panicked.
    pub panics: u64,
    /// How often it was started again after a panic.
    pub restarts: u64,
    /// Messages that wait for it now, where it is detached.
    pub inbox: u64,
    /// Messages that its bounded inbox dropped.
    pub dropped: u64,
    /// How much time its runs spent on a processor, where it is detached and the system tells: the rest of the time of its runs
    /// it waited, for a device for example.
    #[cfg_attr(feature = "serde", serde(default))]
    pub processor_ns: Option<u64>,
    /// How long its measured runs took.
    pub run_time: TimeStatistics,
}

impl ModuleStatistics {
    /// How long all its runs took together, in nanoseconds: the measured ones, and the same mean for the others.
    #[must_use]
    pub fn busy_ns(&self) -> f64 {
        self.run_time.mean_ns() * self.runs as f64
    }
}

/// What a topic has carried.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TopicStatistics {
    /// The name, without a leading slash.
    pub name: String,
    /// The Rust path of the message type.
    pub message_type: String,
    /// How many modules and outlets subscribe to it.
    pub subscribers: u64,
    /// Messages it has carried.
    pub messages: u64,
    /// Messages that bounded queues of inlets, outlets and detached modules dropped before they were delivered.
    pub dropped: u64,
    /// The cycles in which it carried messages.
    pub batches: u64,
    /// Messages of the last cycle in which there were any.
    pub last_batch: u64,
    /// The most messages of one cycle.
    pub largest_batch: u64,
    /// The core's time when it last carried a message, in nanoseconds; nothing if it never did.
    pub last_time_ns: Option<i64>,
}

/// What the outlets of one inbox have taken.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OutletStatistics {
    /// The name of the inbox; that of the topic where an outlet has an inbox of its own.
    pub name: String,
    /// How many topics are taken from.
    pub topics: u64,
    /// Messages that sinks took.
    pub received: u64,
    /// Messages that wait now.
    pub inbox: u64,
    /// Messages that the bounded inbox dropped.
    pub dropped: u64,
    /// Sinks that panicked.
    pub failed: u64,
}

#[cfg(feature = "serde")]
mod time_ns {
    use serde::{Deserialize, Deserializer, Serializer};

    use crate::Time;

    pub(super) fn serialize<S: Serializer>(time: &Time, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_i64(time.as_nanos())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Time, D::Error> {
        i64::deserialize(deserializer).map(Time::from_nanos)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_that_were_not_measured_count_with_the_mean_of_the_others() {
        let run_time = TimeStatistics { count: 4, sum_ns: 400, ..TimeStatistics::default() };
        let module = ModuleStatistics { runs: 1000, run_time, ..ModuleStatistics::default() };
        assert_eq!(module.busy_ns(), 100_000.0);
        assert_eq!(ModuleStatistics { runs: 5, ..ModuleStatistics::default() }.busy_ns(), 0.0);
    }

    #[cfg(feature = "serde")]
    #[test]
    fn a_snapshot_survives_json() {
        let snapshot = Snapshot {
            time: Time::from_nanos(-5),
            cycle: 7,
            modules: vec![ModuleStatistics {
                name: "a \"b\"".into(),
                state: ModuleState::Restarting,
                ..ModuleStatistics::default()
            }],
            topics: vec![TopicStatistics { last_time_ns: Some(3), ..TopicStatistics::default() }],
            ..Snapshot::default()
        };
        let json = serde_json::to_value(&snapshot).expect("plain data");
        assert_eq!(json["time_ns"], -5);
        assert_eq!(json["modules"][0]["state"], "restarting");
        assert_eq!(serde_json::from_value::<Snapshot>(json).expect("the same type"), snapshot);
    }
}
