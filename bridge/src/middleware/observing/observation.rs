//! What can be told of an endpoint from the times and numbers of its samples: no clock, no thread, no engine.

use crate::middleware::{Aliveness, EndpointEvent, Gid};
use downbeat_msgs::qos::{Liveliness, QosProfile};
use std::collections::HashMap;
use std::time::{Duration, Instant};

/// Writers that one reader keeps account of. Samples of more are not looked at.
const MOST_WRITERS: usize = 1024;

/// The times of one writer of ours.
#[derive(Debug)]
pub(super) struct WriterObservation {
    deadline: Option<Deadline>,
    /// Of a writer that shows by its samples that it is alive.
    lease: Option<Lease>,
}

/// The times of one reader of ours, and of the writers it hears.
#[derive(Debug)]
pub(super) struct ReaderObservation {
    deadline: Option<Deadline>,
    /// How long a writer may be silent, where the reader requests to know.
    lease: Option<Duration>,
    /// Whether only samples show that a writer is alive.
    is_manual: bool,
    writers: HashMap<Gid, Heard>,
}

#[derive(Debug, Default)]
struct Heard {
    is_matched: bool,
    /// The number of its last sample.
    last: Option<i64>,
    lease: Option<Lease>,
}

/// It runs from the first sample on.
#[derive(Debug)]
struct Deadline {
    period: Duration,
    due: Option<Instant>,
}

#[derive(Debug)]
struct Lease {
    time: Duration,
    /// Nothing once it has run out.
    due: Option<Instant>,
}

impl WriterObservation {
    /// Nothing where there is no time to keep.
    pub(super) fn new(qos: &QosProfile, now: Instant) -> Option<Self> {
        let deadline = qos.deadline.map(Deadline::new);
        let is_manual = qos.liveliness == Liveliness::ManualByTopic;
        let lease = qos.liveliness_lease_duration.filter(|_| is_manual).map(|time| Lease::new(time, now));
        (deadline.is_some() || lease.is_some()).then_some(Self { deadline, lease })
    }

    /// A sample was written; true if a time runs now that did not before.
    pub(super) fn wrote(&mut self, now: Instant) -> bool {
        let before = self.due();
        if let Some(deadline) = &mut self.deadline {
            deadline.met(now);
        }
        if let Some(lease) = &mut self.lease {
            lease.renew(now);
        }
        self.due().is_some_and(|due| before.is_none_or(|before| due < before))
    }

    pub(super) fn due(&self) -> Option<Instant> {
        let deadline = self.deadline.as_ref().and_then(|deadline| deadline.due);
        let lease = self.lease.as_ref().and_then(|lease| lease.due);
        earliest(deadline, lease)
    }

    /// What has run out by `now`.
    pub(super) fn expire(&mut self, now: Instant, events: &mut Vec<EndpointEvent>) {
        events.extend(self.deadline.as_mut().and_then(|deadline| deadline.missed(now)));
        if self.lease.as_mut().is_some_and(|lease| lease.ran_out(now)) {
            events.push(EndpointEvent::LivelinessLost);
        }
    }
}

impl ReaderObservation {
    pub(super) fn new(qos: &QosProfile) -> Self {
        Self {
            deadline: qos.deadline.map(Deadline::new),
            lease: qos.liveliness_lease_duration,
            is_manual: qos.liveliness == Liveliness::ManualByTopic,
            writers: HashMap::new(),
        }
    }

    /// A sample came; true if a time runs now that did not before.
    pub(super) fn heard(
        &mut self,
        writer: Gid,
        number: i64,
        now: Instant,
        events: &mut Vec<EndpointEvent>,
    ) -> bool {
        let before = self.due();
        if let Some(deadline) = &mut self.deadline {
            deadline.met(now);
        }
        if let Some(heard) = self.writer(writer) {
            let expected = heard.last.map_or(number, |last| last.saturating_add(1));
            if let Ok(count @ 1..) = u64::try_from(number.saturating_sub(expected)) {
                events.push(EndpointEvent::MessagesLost { peer: writer, count });
            }
            heard.last = heard.last.max(Some(number));
            if heard.lease.as_mut().is_some_and(|lease| lease.renew(now)) {
                events.push(EndpointEvent::LivelinessChanged { peer: writer, now: Aliveness::Alive });
            }
        }
        self.due().is_some_and(|due| before.is_none_or(|before| due < before))
    }

    /// An event of the engine, which is passed on with what follows from it; true if a time runs now that did not before.
    pub(super) fn told(
        &mut self,
        event: EndpointEvent,
        now: Instant,
        events: &mut Vec<EndpointEvent>,
    ) -> bool {
        events.push(event);
        let (lease, is_manual) = (self.lease, self.is_manual);
        let alive = |peer, now| EndpointEvent::LivelinessChanged { peer, now };
        match event {
            EndpointEvent::Matched { peer } => {
                let Some(heard) = self.writer(peer).filter(|heard| !heard.is_matched) else { return false };
                heard.is_matched = true;
                if let Some(time) = lease {
                    events.push(alive(peer, Aliveness::Alive));
                    heard.lease = is_manual.then(|| Lease::new(time, now));
                }
                lease.is_some() && is_manual
            }
            EndpointEvent::Unmatched { peer } => {
                if self.writers.remove(&peer).is_some_and(|heard| heard.is_matched) && lease.is_some() {
                    events.push(alive(peer, Aliveness::Gone));
                }
                false
            }
            _ => false,
        }
    }

    pub(super) fn due(&self) -> Option<Instant> {
        let leases = self.writers.values().filter_map(|heard| heard.lease.as_ref()?.due);
        earliest(self.deadline.as_ref().and_then(|deadline| deadline.due), leases.min())
    }

    /// What has run out by `now`.
    pub(super) fn expire(&mut self, now: Instant, events: &mut Vec<EndpointEvent>) {
        events.extend(self.deadline.as_mut().and_then(|deadline| deadline.missed(now)));
        for (&peer, heard) in &mut self.writers {
            if heard.lease.as_mut().is_some_and(|lease| lease.ran_out(now)) {
                events.push(EndpointEvent::LivelinessChanged { peer, now: Aliveness::NotAlive });
            }
        }
    }

    fn writer(&mut self, writer: Gid) -> Option<&mut Heard> {
        if self.writers.len() >= MOST_WRITERS && !self.writers.contains_key(&writer) {
            return None;
        }
        Some(self.writers.entry(writer).or_default())
    }
}

impl Deadline {
    fn new(period: Duration) -> Self {
        // No time at all would be missed without end.
        Self { period: period.max(Duration::from_micros(1)), due: None }
    }

    fn met(&mut self, now: Instant) {
        self.due = now.checked_add(self.period);
    }

    /// As in DDS each further period without a sample counts again.
    fn missed(&mut self, now: Instant) -> Option<EndpointEvent> {
        let due = self.due.filter(|due| *due <= now)?;
        let more = now.duration_since(due).as_nanos() / self.period.as_nanos();
        let count = u32::try_from(more).unwrap_or(u32::MAX - 1) + 1;
        self.due = self.period.checked_mul(count).and_then(|time| due.checked_add(time));
        Some(EndpointEvent::DeadlineMissed { count })
    }
}

impl Lease {
    fn new(time: Duration, now: Instant) -> Self {
        Self { time, due: now.checked_add(time) }
    }

    /// True if it had run out.
    fn renew(&mut self, now: Instant) -> bool {
        std::mem::replace(&mut self.due, now.checked_add(self.time)).is_none()
    }

    /// True once.
    fn ran_out(&mut self, now: Instant) -> bool {
        self.due.take_if(|due| *due <= now).is_some()
    }
}

fn earliest(one: Option<Instant>, other: Option<Instant>) -> Option<Instant> {
    [one, other].into_iter().flatten().min()
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use EndpointEvent::{
        DeadlineMissed, LivelinessChanged, LivelinessLost, Matched, MessagesLost, Unmatched,
    };

    const MS: Duration = Duration::from_millis(1);
    const ALICE: Gid = Gid([1; 16]);
    const BOB: Gid = Gid([2; 16]);

    fn expired(due: Option<Instant>, expire: impl FnOnce(&mut Vec<EndpointEvent>)) -> Vec<EndpointEvent> {
        assert!(due.is_some(), "a time runs");
        let mut events = Vec::new();
        expire(&mut events);
        events
    }

    #[test]
    fn a_deadline_runs_from_the_first_sample_and_counts_each_period() {
        let start = Instant::now();
        let qos = QosProfile { deadline: Some(10 * MS), ..QosProfile::DEFAULT };
        let mut writer = WriterObservation::new(&qos, start).unwrap();
        assert_eq!(writer.due(), None);
        assert!(writer.wrote(start));
        assert!(!writer.wrote(start + 5 * MS));
        assert_eq!(writer.due(), Some(start + 15 * MS));
        let missed = expired(writer.due(), |events| writer.expire(start + 15 * MS, events));
        assert_eq!(missed, [DeadlineMissed { count: 1 }]);
        let missed = expired(writer.due(), |events| writer.expire(start + 52 * MS, events));
        assert_eq!(missed, [DeadlineMissed { count: 3 }]);
        assert_eq!(writer.due(), Some(start + 55 * MS));

        let mut reader = ReaderObservation::new(&qos);
        let mut events = Vec::new();
        assert!(reader.heard(ALICE, 1, start, &mut events));
        reader.heard(BOB, 1, start + 5 * MS, &mut events);
        reader.expire(start + 14 * MS, &mut events);
        assert_eq!(events, [], "a sample of any writer meets it");
        reader.expire(start + 15 * MS, &mut events);
        assert_eq!(events, [DeadlineMissed { count: 1 }]);
    }

    #[test]
    fn numbers_that_do_not_come_are_lost_and_those_before_the_first_are_not() {
        let (now, mut events) = (Instant::now(), Vec::new());
        let mut reader = ReaderObservation::new(&QosProfile::DEFAULT);
        for (writer, number) in [(ALICE, 7), (BOB, 1), (ALICE, 8), (ALICE, 12), (ALICE, 11), (BOB, 2)] {
            reader.heard(writer, number, now, &mut events);
        }
        assert_eq!(events, [MessagesLost { peer: ALICE, count: 3 }]);
        events.clear();
        reader.told(Unmatched { peer: ALICE }, now, &mut events);
        reader.heard(ALICE, 100, now, &mut events);
        reader.heard(BOB, i64::MIN, now, &mut events);
        assert_eq!(events, [Unmatched { peer: ALICE }], "one that comes back begins anew");
    }

    #[test]
    fn a_writer_that_shows_by_hand_that_it_is_alive_is_not_when_it_is_silent() {
        let start = Instant::now();
        let manual = QosProfile {
            liveliness: Liveliness::ManualByTopic,
            liveliness_lease_duration: Some(10 * MS),
            ..QosProfile::DEFAULT
        };
        let mut events = Vec::new();
        let mut reader = ReaderObservation::new(&manual);
        assert!(reader.told(Matched { peer: ALICE }, start, &mut events));
        reader.expire(start + 10 * MS, &mut events);
        reader.expire(start + 30 * MS, &mut events);
        reader.heard(ALICE, 1, start + 31 * MS, &mut events);
        reader.told(Unmatched { peer: ALICE }, start + 32 * MS, &mut events);
        let changed = |now| LivelinessChanged { peer: ALICE, now };
        assert_eq!(
            events,
            [
                Matched { peer: ALICE },
                changed(Aliveness::Alive),
                changed(Aliveness::NotAlive),
                changed(Aliveness::Alive),
                Unmatched { peer: ALICE },
                changed(Aliveness::Gone),
            ]
        );

        let mut writer = WriterObservation::new(&manual, start).unwrap();
        let lost = expired(writer.due(), |events| writer.expire(start + 10 * MS, events));
        assert_eq!(lost, [LivelinessLost]);
        assert_eq!(writer.due(), None, "it is told once");
        assert!(writer.wrote(start + 20 * MS));
    }

    #[test]
    fn a_writer_that_is_alive_by_itself_is_so_until_it_is_unmatched() {
        let (start, mut events) = (Instant::now(), Vec::new());
        let lease = QosProfile { liveliness_lease_duration: Some(10 * MS), ..QosProfile::DEFAULT };
        let mut reader = ReaderObservation::new(&lease);
        assert!(!reader.told(Matched { peer: ALICE }, start, &mut events));
        assert_eq!(reader.due(), None);
        assert!(WriterObservation::new(&lease, start).is_none(), "it needs no watching");
        assert_eq!(events.len(), 2);
    }
}
