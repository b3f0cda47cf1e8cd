//! The writer: its history and its matched readers.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use bytes::Bytes;

use crate::qos::{Durability, History as HistoryQos, Liveliness, Qos};
use crate::wire::{AckNack, Guid, InlineQos, MessageBuilder, NackFragment, SequenceNumber, Timestamp};

use super::Now;
use super::history::History;
use super::lane::Lane;
use super::links::{Emitted, LinkId, Links};
use super::outgoing::{MatchedReader, Outgoing, Sending};

/// Configuration of a writer.
#[derive(Debug, Clone)]
pub struct WriterConfig {
    pub guid: Guid,
    pub qos: Qos,
    /// The most waiting samples: unacknowledged ones if the writer keeps all, otherwise those beyond its
    /// depth that a pacer has not let through yet.
    pub send_window: usize,
    /// The most bytes of waiting samples: a window that counts samples only would hold gigabytes of images.
    /// One sample always fits.
    pub send_window_bytes: u64,
}

/// Options of a sample.
#[derive(Debug, Clone, Copy, Default)]
pub struct WriteOptions {
    pub inline_qos: InlineQos,
    /// The only reader that receives the sample; for all others its number is a gap.
    pub only_to: Option<Guid>,
}

/// The sample was not written because the send window is full. [`Writer::can_write`] returns true when there
/// is room again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("the send window is full of samples that wait to be sent or acknowledged")]
pub struct WindowFull;

/// An event of a writer.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum WriterEvent {
    /// No sample was written for `count` further periods.
    DeadlineMissed { count: u64 },
    /// The application did not assert the writer within its lease.
    LivelinessLost,
    /// All reliable readers have acknowledged all samples.
    Acknowledged,
    /// A reader that had acknowledged samples knows none any more.
    BegunAnew { reader: Guid },
}

/// The state of a writer, builtin or of the user.
#[derive(Debug)]
pub struct Writer {
    guid: Guid,
    qos: Qos,
    send_window: usize,
    send_window_bytes: u64,
    history: History,
    lanes: BTreeMap<LinkId, Lane>,
    /// The link of each matched reader.
    readers: BTreeMap<Guid, LinkId>,
    /// Number of reliable readers that have not acknowledged all samples.
    behind: usize,
    /// The count of the last heartbeat.
    heartbeats: u32,
    deadline_at: Option<Instant>,
    lease_ends: Option<Instant>,
    /// At or before the next timeout.
    timeout: Option<Instant>,
    events: VecDeque<WriterEvent>,
}

impl Writer {
    pub fn new(config: WriterConfig) -> Self {
        Self {
            guid: config.guid,
            qos: config.qos,
            send_window: config.send_window.max(1),
            send_window_bytes: config.send_window_bytes,
            history: History::new(),
            lanes: BTreeMap::new(),
            readers: BTreeMap::new(),
            behind: 0,
            heartbeats: 0,
            deadline_at: None,
            lease_ends: None,
            timeout: None,
            events: VecDeque::new(),
        }
    }

    pub fn guid(&self) -> Guid {
        self.guid
    }

    pub fn qos(&self) -> &Qos {
        &self.qos
    }

    /// The number of the first sample in the history; that of the next one if there is none.
    pub(super) fn first(&self) -> SequenceNumber {
        self.history.first()
    }

    /// The number of the next sample.
    pub(super) fn next(&self) -> SequenceNumber {
        self.history.next()
    }

    /// Writes a sample. An empty `payload` means a sample without payload.
    ///
    /// # Errors
    /// Returns [`WindowFull`] if the writer keeps all samples and too many are not acknowledged, or if it
    /// keeps the last samples and too many were never sent. In the second case, peers that have stopped
    /// acknowledging are ignored.
    pub fn write(
        &mut self,
        now: Now,
        payload: Bytes,
        options: WriteOptions,
        links: &mut Links,
    ) -> Result<SequenceNumber, WindowFull> {
        self.expire(now.steady);
        self.make_room(now.steady, links)?;
        let stamp = Timestamp::from_nanos(now.wall_ns);
        let (inline_qos, only_to) = (options.inline_qos, options.only_to);
        let number = self.history.push(payload, inline_qos, only_to, stamp, now.steady);
        match only_to {
            None => self.offer_to_all(now.steady, links),
            Some(reader) => self.offer_to_one(now.steady, number, reader, links),
        }
        if let Some(deadline) = self.qos.deadline {
            self.deadline_at = Some(now.steady + deadline);
            self.set_timeout(self.deadline_at);
        }
        if let Some(lifespan) = self.qos.lifespan {
            self.set_timeout(Some(now.steady + lifespan));
        }
        self.renew_lease(now.steady);
        self.trim();
        Ok(number)
    }

    /// Returns whether [`Writer::write`] would accept a sample.
    pub fn can_write(&self, now: Now, links: &Links) -> bool {
        !self.is_full() || !self.is_waited_for(self.history.first(), now.steady, links)
    }

    /// Removes a sample from the history. Readers that lack it receive a GAP.
    pub fn discard(&mut self, number: SequenceNumber) {
        self.history.remove(number);
    }

    /// Matches a reader. If it is already matched, its link and QoS are updated and its acknowledgements are
    /// kept.
    pub fn match_reader(&mut self, now: Now, matched: MatchedReader, links: &mut Links) {
        if self.readers.get(&matched.guid) == Some(&matched.link) {
            let readers = self.lanes.get_mut(&matched.link).into_iter().flat_map(|lane| &mut lane.readers);
            for reader in readers.filter(|reader| reader.guid == matched.guid) {
                if reader.is_reliable == matched.is_reliable {
                    reader.wants_history = matched.wants_history;
                    return;
                }
            }
        }
        let moved = self.remove_reader(now, matched.guid, links);
        let depth = self.depth();
        let lane = self
            .lanes
            .entry(matched.link)
            .or_insert_with(|| Lane::new(matched.link, &self.history, now.steady));
        let sending = Sending {
            now: now.steady,
            writer: self.guid.entity,
            history: &self.history,
            heartbeats: &mut self.heartbeats,
        };
        lane.add_reader(&matched, moved, &sending, depth, links);
        let is_behind = lane.readers.last().is_some_and(|reader| reader.is_behind(&self.history));
        let heartbeat_at = lane.heartbeat_at;
        self.readers.insert(matched.guid, matched.link);
        self.behind += usize::from(is_behind);
        self.set_timeout(heartbeat_at);
    }

    /// Removes a matched reader.
    pub fn unmatch_reader(&mut self, now: Now, guid: Guid, links: &mut Links) {
        let removed = self.remove_reader(now, guid, links);
        if removed.is_some_and(|reader| reader.is_behind(&self.history)) {
            self.note_acknowledged();
        }
        self.trim();
    }

    fn remove_reader(&mut self, now: Now, guid: Guid, links: &mut Links) -> Option<Outgoing> {
        let link = self.readers.remove(&guid)?;
        let lane = self.lanes.get_mut(&link)?;
        let removed = lane.remove_reader(guid, now.steady, links)?;
        if lane.readers.is_empty() {
            lane.close(links);
            self.lanes.remove(&link);
        }
        self.behind -= usize::from(removed.is_behind(&self.history));
        Some(removed)
    }

    /// The matched readers.
    pub fn matched(&self) -> impl Iterator<Item = Guid> {
        self.readers.keys().copied()
    }

    pub fn is_matched(&self, reader: Guid) -> bool {
        self.readers.contains_key(&reader)
    }

    /// Returns whether all matched reliable readers have acknowledged all samples.
    pub fn is_acknowledged(&self) -> bool {
        self.behind == 0
    }

    /// Handles an acknowledgement. Readers that are not matched are ignored.
    pub fn handle_ack_nack(&mut self, now: Now, reader: Guid, ack_nack: &AckNack, links: &mut Links) {
        let depth = self.depth();
        let was_behind = self.behind;
        let mut begins_anew = false;
        self.with_reader(now, reader, |lane, index, sending| {
            let was_behind = lane.readers[index].is_behind(sending.history);
            begins_anew = lane.handle_ack_nack(index, ack_nack, sending, depth, links);
            isize::from(lane.readers[index].is_behind(sending.history)) - isize::from(was_behind)
        });
        if begins_anew {
            self.events.push_back(WriterEvent::BegunAnew { reader });
        }
        if self.behind < was_behind {
            self.note_acknowledged();
            self.trim();
        }
    }

    /// Sends what could not be sent on a link before.
    pub(super) fn resume(&mut self, now: Now, link: LinkId, links: &mut Links) {
        if let Some(lane) = self.lanes.get_mut(&link) {
            lane.resume(now.steady, &self.history);
            links.request(link, self.guid.entity);
        }
    }

    /// Requests an answer of a matched reader.
    pub(super) fn ask(&mut self, now: Now, reader: Guid, links: &mut Links) {
        self.with_reader(now, reader, |lane, index, sending| {
            lane.ask(index, sending, links);
            0
        });
    }

    /// Requests acknowledgements of all readers that lack samples.
    pub(super) fn ask_all(&mut self, now: Now, links: &mut Links) {
        let sending = Sending {
            now: now.steady,
            writer: self.guid.entity,
            history: &self.history,
            heartbeats: &mut self.heartbeats,
        };
        self.lanes.values_mut().for_each(|lane| lane.ask_all(&sending, links));
    }

    /// Handles a request for fragments. Readers that are not matched are ignored.
    pub fn handle_nack_fragment(&mut self, now: Now, reader: Guid, nack: &NackFragment, links: &mut Links) {
        self.with_reader(now, reader, |lane, index, sending| {
            lane.handle_nack_fragment(index, nack, sending, links);
            0
        });
    }

    /// Sends an assertion of the application that the writer is alive, without a sample.
    pub fn assert_liveliness(&mut self, now: Now, links: &mut Links) {
        self.renew_lease(now.steady);
        for (link, lane) in &mut self.lanes {
            lane.wish_liveliness();
            links.request(*link, self.guid.entity);
        }
    }

    /// Runs the timers that are due.
    pub fn handle_timeout(&mut self, now: Now, links: &mut Links) {
        if self.timeout.is_none_or(|timeout| timeout > now.steady) {
            return;
        }
        self.expire(now.steady);
        let sending = Sending {
            now: now.steady,
            writer: self.guid.entity,
            history: &self.history,
            heartbeats: &mut self.heartbeats,
        };
        self.lanes.values_mut().for_each(|lane| lane.handle_timeout(&sending, links));
        if let Some((deadline, at)) = self.qos.deadline.zip(self.deadline_at) {
            let (count, next) = missed_periods(at, deadline, now.steady);
            self.deadline_at = Some(next);
            if count > 0 {
                self.events.push_back(WriterEvent::DeadlineMissed { count });
            }
        }
        if self.lease_ends.is_some_and(|ends| ends <= now.steady) {
            self.lease_ends = None;
            self.events.push_back(WriterEvent::LivelinessLost);
        }
        let expires = self.qos.lifespan.zip(self.history.oldest()).map(|(span, entry)| entry.written + span);
        let own = [self.deadline_at, self.lease_ends, expires];
        let heartbeats = self.lanes.values().map(|lane| lane.heartbeat_at);
        self.timeout = own.into_iter().chain(heartbeats).flatten().min();
    }

    /// When to call [`Writer::handle_timeout`]. May be too early, but never too late.
    pub fn next_timeout(&self) -> Option<Instant> {
        self.timeout
    }

    /// Returns the oldest event that has not been returned yet.
    pub fn poll_event(&mut self) -> Option<WriterEvent> {
        self.events.pop_front()
    }

    /// Fills a datagram for `link`.
    pub fn emit(
        &mut self,
        now: Now,
        link: LinkId,
        links: &mut Links,
        builder: &mut MessageBuilder<'_>,
    ) -> Emitted {
        self.expire(now.steady);
        let is_pressed = self.is_half_full();
        let Some(lane) = self.lanes.get_mut(&link) else { return Emitted::Done };
        let mut sending = Sending {
            now: now.steady,
            writer: self.guid.entity,
            history: &self.history,
            heartbeats: &mut self.heartbeats,
        };
        let behind =
            |lane: &Lane| lane.readers.iter().filter(|reader| reader.is_behind(&self.history)).count();
        let before = behind(lane);
        let emitted = lane.emit(&mut sending, is_pressed, links, builder);
        // Samples for others need no acknowledgement.
        let acknowledged = before - behind(lane);
        let heartbeat_at = lane.heartbeat_at;
        self.behind -= acknowledged;
        if acknowledged > 0 {
            self.note_acknowledged();
        }
        self.set_timeout(heartbeat_at);
        if emitted == Emitted::Done {
            self.trim();
        }
        emitted
    }

    fn offer_to_all(&mut self, now: Instant, links: &mut Links) {
        self.behind = 0;
        for (link, lane) in &mut self.lanes {
            self.behind += lane.readers.iter().filter(|reader| reader.is_reliable).count();
            lane.note_written(now);
            links.request(*link, self.guid.entity);
        }
        self.set_timeout(self.lanes.values().filter_map(|lane| lane.heartbeat_at).min());
    }

    fn offer_to_one(&mut self, now: Instant, number: SequenceNumber, reader: Guid, links: &mut Links) {
        let link = self.readers.get(&reader).copied();
        for (id, lane) in &mut self.lanes {
            if Some(*id) == link || !lane.pass_over(number, &self.history, links) {
                lane.note_written(now);
                links.request(*id, self.guid.entity);
            }
        }
        let readers = self.lanes.values().flat_map(|lane| &lane.readers);
        self.behind = readers.filter(|reader| reader.is_behind(&self.history)).count();
        self.set_timeout(self.lanes.values().filter_map(|lane| lane.heartbeat_at).min());
    }

    /// Calls `handle` with the lane and the index of a reader, and updates the number of readers that are
    /// behind.
    fn with_reader(
        &mut self,
        now: Now,
        guid: Guid,
        handle: impl FnOnce(&mut Lane, usize, &Sending<'_>) -> isize,
    ) {
        let Some(lane) = self.readers.get(&guid).and_then(|link| self.lanes.get_mut(link)) else { return };
        let Some(index) = lane.readers.iter().position(|reader| reader.guid == guid) else { return };
        let sending = Sending {
            now: now.steady,
            writer: self.guid.entity,
            history: &self.history,
            heartbeats: &mut self.heartbeats,
        };
        self.behind = self.behind.saturating_add_signed(handle(lane, index, &sending));
        let heartbeat_at = lane.heartbeat_at;
        self.set_timeout(heartbeat_at);
    }

    fn note_acknowledged(&mut self) {
        if self.behind == 0 && self.events.back() != Some(&WriterEvent::Acknowledged) {
            self.events.push_back(WriterEvent::Acknowledged);
        }
    }

    /// The most samples that a late joiner receives.
    fn depth(&self) -> usize {
        match self.qos.history {
            HistoryQos::KeepLast(depth) => (depth as usize).max(1),
            HistoryQos::KeepAll => usize::MAX,
        }
    }

    fn keeps_all(&self) -> bool {
        self.qos.history == HistoryQos::KeepAll
    }

    /// The most samples in the history.
    fn limit(&self) -> usize {
        if self.keeps_all() { self.send_window } else { self.send_window.max(self.depth()) }
    }

    /// Returns whether the window is full, of samples or of bytes. The depth of a history is not limited by
    /// bytes.
    fn is_full(&self) -> bool {
        let kept = if self.keeps_all() { 1 } else { self.depth() };
        let len = self.history.len();
        len >= self.limit() || len >= kept && self.history.bytes() >= self.send_window_bytes
    }

    /// Returns whether samples that are not acknowledged take up half of the window.
    fn is_half_full(&self) -> bool {
        self.keeps_all()
            && (self.history.len() >= self.limit() / 2 || self.history.bytes() >= self.send_window_bytes / 2)
    }

    /// Removes old samples to make room for a new one.
    fn make_room(&mut self, now: Instant, links: &Links) -> Result<(), WindowFull> {
        let kept = self.depth().min(self.limit());
        while self.history.len() >= kept || self.is_full() {
            if self.is_waited_for(self.history.first(), now, links) {
                return if self.is_full() { Err(WindowFull) } else { Ok(()) };
            }
            self.history.remove_oldest();
        }
        Ok(())
    }

    /// Returns whether `number` has yet to be sent on some link or, if the writer keeps all samples, to be
    /// acknowledged.
    fn is_waited_for(&self, number: SequenceNumber, now: Instant, links: &Links) -> bool {
        let keeps_all = self.keeps_all();
        self.lanes.values().any(|lane| {
            let is_unsent = lane.next() <= number;
            let lacks = |reader: &Outgoing| reader.lacks(number);
            if keeps_all {
                is_unsent || lane.readers.iter().any(lacks)
            } else {
                is_unsent && !lane.is_stalled(now, links)
            }
        })
    }

    /// Drops samples that are no longer needed.
    fn trim(&mut self) {
        let is_volatile = self.qos.durability == Durability::Volatile;
        if is_volatile
            && self.behind == 0
            && self.history.len() > 0
            && self.lanes.values().all(|lane| lane.next() == self.history.next())
        {
            self.history.clear();
        }
    }

    fn expire(&mut self, now: Instant) {
        let Some(lifespan) = self.qos.lifespan else { return };
        while self.history.oldest().is_some_and(|entry| entry.written + lifespan <= now) {
            self.history.remove_oldest();
        }
    }

    fn renew_lease(&mut self, now: Instant) {
        if self.qos.liveliness == Liveliness::ManualByTopic
            && let Some(lease) = self.qos.lease
        {
            self.lease_ends = Some(now + lease);
            self.set_timeout(self.lease_ends);
        }
    }

    fn set_timeout(&mut self, at: Option<Instant>) {
        if let Some(at) = at {
            self.timeout = Some(self.timeout.map_or(at, |timeout| timeout.min(at)));
        }
    }
}

/// Returns how many periods have ended at `now` if the first one ends at `at`, and when the next one ends.
pub(super) fn missed_periods(at: Instant, period: Duration, now: Instant) -> (u64, Instant) {
    let period = period.max(Duration::from_nanos(1));
    let Some(late) = now.checked_duration_since(at) else { return (0, at) };
    let missed = late.as_nanos() / period.as_nanos();
    let rest = Duration::from_nanos((late.as_nanos() % period.as_nanos()) as u64);
    (missed as u64 + 1, now - rest + period)
}
