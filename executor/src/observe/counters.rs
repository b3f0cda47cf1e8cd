//! Counters of modules and topics.

use std::time::Duration;

use super::histogram::TimeHistogram;
use super::{ModuleState, ModuleStatistics, TimeStatistics, TopicStatistics};
use crate::Time;

/// Counts the activity of a module. It belongs to the module's cell, or to the core's side of a detached
/// module, so that it is not shared between threads.
#[derive(Default)]
pub(crate) struct ModuleMeter {
    runs: u64,
    received: u64,
    published: u64,
    overruns: u64,
    panics: u64,
    restarts: u64,
    dropped: u64,
    inbox: u64,
    run_time: Option<Box<TimeHistogram>>,
    processor_ns: Option<u64>,
}

impl ModuleMeter {
    /// A meter that also measures times, which needs 15 KiB of memory.
    pub(crate) fn with_times() -> Self {
        Self { run_time: Some(Box::new(TimeHistogram::new())), ..Self::default() }
    }

    /// Counts a run with this number of received messages.
    #[inline]
    pub(crate) fn ran(&mut self, received: usize) {
        self.runs += 1;
        self.received += received as u64;
    }

    #[inline]
    pub(crate) fn published(&mut self, messages: usize) {
        self.published += messages as u64;
    }

    /// Records the duration of a measured run.
    #[inline]
    pub(crate) fn took(&mut self, time: Duration) {
        if let Some(run_time) = &mut self.run_time {
            run_time.record(time);
        }
    }

    /// Records the processor time of a run.
    pub(crate) fn was_on_processor(&mut self, time: Option<Duration>) {
        if let Some(time) = time {
            let time_ns = u64::try_from(time.as_nanos()).unwrap_or(u64::MAX);
            self.processor_ns = Some(self.processor_ns.unwrap_or(0).saturating_add(time_ns));
        }
    }

    pub(crate) fn overran(&mut self, runs: u64) {
        self.overruns += runs;
    }

    /// Takes the overruns so far, to move them to another meter.
    pub(crate) fn take_overruns(&mut self) -> u64 {
        std::mem::take(&mut self.overruns)
    }

    /// True if the module panicked and has not been restarted since.
    pub(crate) fn has_failed(&self) -> bool {
        self.panics > self.restarts
    }

    pub(crate) fn panicked(&mut self) {
        self.panics += 1;
    }

    pub(crate) fn restarted(&mut self) {
        self.restarts += 1;
    }

    /// Adds messages that were dropped from the inbox since the last report.
    pub(crate) fn dropped(&mut self, messages: u64) {
        self.dropped += messages;
    }

    /// Sets the number of messages in the inbox.
    pub(crate) fn inbox(&mut self, messages: u64) {
        self.inbox = messages;
    }

    pub(crate) fn statistics(&self, name: &str, state: ModuleState, is_detached: bool) -> ModuleStatistics {
        ModuleStatistics {
            name: name.to_owned(),
            state,
            is_detached,
            runs: self.runs,
            received: self.received,
            published: self.published,
            overruns: self.overruns,
            panics: self.panics,
            restarts: self.restarts,
            inbox: self.inbox,
            dropped: self.dropped,
            processor_ns: self.processor_ns,
            run_time: self
                .run_time
                .as_ref()
                .map_or_else(TimeStatistics::default, |run_time| run_time.statistics()),
        }
    }
}

/// Counts the messages of a topic.
#[derive(Clone, Debug, Default)]
pub(crate) struct TopicMeter {
    dropped: u64,
    batches: u64,
    last_batch: u64,
    largest_batch: u64,
    last_time: Time,
}

impl TopicMeter {
    /// Counts the first messages of the cycle at `now`.
    #[inline]
    pub(crate) fn begin_batch(&mut self, messages: usize, now: Time) {
        self.batches += 1;
        self.last_batch = 0;
        self.last_time = now;
        self.carried(messages);
    }

    /// Counts further messages of the cycle's batch.
    #[inline]
    pub(crate) fn carried(&mut self, messages: usize) {
        self.last_batch += messages as u64;
        self.largest_batch = self.largest_batch.max(self.last_batch);
    }

    /// Adds messages that a bounded queue dropped since the last report.
    pub(crate) fn dropped(&mut self, messages: u64) {
        self.dropped += messages;
    }

    pub(crate) fn statistics(
        &self,
        name: &str,
        message_type: &str,
        messages: u64,
        subscribers: usize,
    ) -> TopicStatistics {
        TopicStatistics {
            name: name.to_owned(),
            message_type: message_type.to_owned(),
            subscribers: subscribers as u64,
            messages,
            dropped: self.dropped,
            batches: self.batches,
            last_batch: self.last_batch,
            largest_batch: self.largest_batch,
            last_time_ns: (self.batches > 0).then_some(self.last_time.as_nanos()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_module_is_counted_whether_or_not_its_times_are_taken() {
        let mut meter = ModuleMeter::default();
        meter.ran(3);
        meter.ran(0);
        meter.published(2);
        meter.took(Duration::from_secs(1));
        meter.dropped(4);
        meter.dropped(1);
        meter.inbox(6);
        meter.inbox(2);
        meter.panicked();
        meter.restarted();
        meter.overran(1);
        for time in [None, Some(Duration::from_nanos(100)), Some(Duration::from_nanos(200))] {
            meter.was_on_processor(time);
        }
        let statistics = meter.statistics("motion", ModuleState::Active, true);
        let expected = ModuleStatistics {
            name: "motion".into(),
            state: ModuleState::Active,
            is_detached: true,
            runs: 2,
            received: 3,
            published: 2,
            overruns: 1,
            panics: 1,
            restarts: 1,
            inbox: 2,
            dropped: 5,
            processor_ns: Some(300),
            run_time: TimeStatistics::default(),
        };
        assert_eq!(statistics, expected);
    }

    #[test]
    fn a_module_with_times_tells_how_long_its_measured_runs_took() {
        let mut meter = ModuleMeter::with_times();
        meter.took(Duration::from_micros(3));
        let run_time = meter.statistics("a", ModuleState::Active, false).run_time;
        assert_eq!((run_time.count, run_time.p50_ns, run_time.max_ns), (1, 3_000, 3_000));
    }

    #[test]
    fn a_topic_tells_its_last_and_its_largest_batch() {
        let mut meter = TopicMeter::default();
        meter.begin_batch(4, Time::from_nanos(10));
        meter.carried(1);
        meter.begin_batch(2, Time::from_nanos(20));
        assert_eq!(meter.last_batch, 2);
        meter.dropped(1);
        let expected = TopicStatistics {
            name: "imu/data".into(),
            message_type: "Imu".into(),
            subscribers: 3,
            messages: 7,
            dropped: 1,
            batches: 2,
            last_batch: 2,
            largest_batch: 5,
            last_time_ns: Some(20),
        };
        assert_eq!(meter.statistics("imu/data", "Imu", 7, 3), expected);
    }
}
