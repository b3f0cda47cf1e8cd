//! Snapshots of a running core.

use crate::Time;

/// The state of a core between two cycles, as plain numbers counted since its start.
///
/// Rates follow from two snapshots: the difference of two counters divided by the difference of
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
    /// The core's time in the last cycle; serialised as nanoseconds.
    #[cfg_attr(feature = "serde", serde(rename = "time_ns", with = "time_ns"))]
    pub time: Time,
    /// Nanoseconds of steady time since the core's start, for the computation of rates. It also advances
    /// under a clock that is moved by hand.
    pub uptime_ns: u64,
    /// The number of cycles so far.
    pub cycle: u64,
    /// True while the core is paused by a request.
    pub is_paused: bool,
    /// Durations of the cycles.
    pub cycles: CycleStatistics,
    /// The modules, in the order of registration.
    pub modules: Vec<ModuleStatistics>,
    /// The topics, in the order in which they were first declared.
    pub topics: Vec<TopicStatistics>,
    /// The inboxes of outlets, in the order in which they were first used.
    #[cfg_attr(feature = "serde", serde(default))]
    pub outlets: Vec<OutletStatistics>,
}

/// Durations of the measured runs or cycles. All values are zero if nothing was measured.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TimeStatistics {
    /// The number of measurements.
    pub count: u64,
    /// Their sum, in nanoseconds.
    pub sum_ns: u64,
    /// The median in nanoseconds, with two significant digits.
    pub p50_ns: u64,
    /// The 99th percentile in nanoseconds, with two significant digits.
    pub p99_ns: u64,
    /// The exact maximum in nanoseconds.
    pub max_ns: u64,
}

impl TimeStatistics {
    /// The mean in nanoseconds; 0 without measurements.
    #[must_use]
    pub fn mean_ns(&self) -> f64 {
        if self.count == 0 { 0.0 } else { self.sum_ns as f64 / self.count as f64 }
    }
}

/// Durations of the cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct CycleStatistics {
    /// The process phase, in which the modules run.
    pub process: TimeStatistics,
    /// The sync phase.
    pub sync: TimeStatistics,
    /// Both phases together.
    pub total: TimeStatistics,
    /// The delay of cycles after the timers for which they began.
    pub lateness: TimeStatistics,
    /// The cost of measuring, in nanoseconds.
    pub measuring_ns: u64,
}

/// The state of a module, with the reason if it does not run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum ModuleState {
    /// Set up, not yet configured.
    Unconfigured,
    /// Configured, not active.
    Inactive,
    /// Running.
    #[default]
    Active,
    /// Paused by a request.
    Paused,
    /// Panicked, and waiting for its restart.
    Restarting,
    /// Panicked, and stays stopped.
    Failed,
    /// Ended by a shutdown.
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

/// The counters of a module.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct ModuleStatistics {
    /// The name.
    pub name: String,
    /// The state of the module.
    pub state: ModuleState,
    /// True if the module runs on a separate thread.
    pub is_detached: bool,
    /// The number of runs.
    pub runs: u64,
    /// Messages received.
    pub received: u64,
    /// Messages published.
    pub published: u64,
    /// Runs that exceeded the deadline.
    pub overruns: u64,
    /// The number of panics.
    pub panics: u64,
    /// The number of restarts after a panic.
    pub restarts: u64,
    /// Messages in the inbox of a detached module.
    pub inbox: u64,
    /// Messages dropped from a bounded inbox.
    pub dropped: u64,
    /// Processor time of the runs, in nanoseconds; only for a detached module, and if the system reports it.
    /// The module spent the rest of its runs' time waiting, for example for a device.
    #[cfg_attr(feature = "serde", serde(default))]
    pub processor_ns: Option<u64>,
    /// Durations of the measured runs.
    pub run_time: TimeStatistics,
}

impl ModuleStatistics {
    /// The estimated total duration of all runs in nanoseconds: unmeasured runs count with the mean of the
    /// measured ones.
    #[must_use]
    pub fn busy_ns(&self) -> f64 {
        self.run_time.mean_ns() * self.runs as f64
    }
}

/// The counters of a topic.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct TopicStatistics {
    /// The name, without a leading slash.
    pub name: String,
    /// The Rust path of the message type.
    pub message_type: String,
    /// The number of modules and outlets that subscribe to the topic.
    pub subscribers: u64,
    /// Messages carried.
    pub messages: u64,
    /// Messages dropped by bounded queues of inlets, outlets and detached modules before delivery.
    pub dropped: u64,
    /// The number of cycles in which the topic carried messages.
    pub batches: u64,
    /// The number of messages in the last such cycle.
    pub last_batch: u64,
    /// The largest number of messages in one cycle.
    pub largest_batch: u64,
    /// The core's time of the last message in nanoseconds; `None` if there was none.
    pub last_time_ns: Option<i64>,
}

/// The counters of the outlets of one inbox.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct OutletStatistics {
    /// The name of the inbox; the name of the topic if the inbox belongs to a single outlet.
    pub name: String,
    /// The number of topics.
    pub topics: u64,
    /// Messages that the sinks received.
    pub received: u64,
    /// Messages that wait in the inbox.
    pub inbox: u64,
    /// Messages dropped from a bounded inbox.
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
