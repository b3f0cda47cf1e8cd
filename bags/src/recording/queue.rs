//! The queue between producers, which must not wait for a disk, and the writing thread.
//!
//! Bounded in bytes, since one camera image is as large as ten thousand joint states. Producers hold the lock
//! only for a push.

use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

use bytes::Bytes;
use parking_lot::{Condvar, Mutex, MutexGuard};

use super::RecordError;
use super::options::{RecordingOptions, SnapshotLimits, WhenSlow};
use super::request::{ControlError, Done};
use crate::topic::{TopicDescription, TopicId};
use crate::writer::FileSplit;

/// The memory of a queued message besides its data.
const OVERHEAD: usize = size_of::<Item>();

/// How many items the writing thread takes at a time.
const BATCH: usize = 256;

/// How long the writing thread waits for a batch to fill: waking for each message costs more than writing it.
const LINGER: Duration = Duration::from_millis(5);

pub(super) enum Item {
    /// Boxed, since every message takes as much memory in the queue as the largest item.
    Topic(Box<TopicDescription>),
    Message {
        topic: TopicId,
        log_time: i64,
        publish_time: i64,
        data: Bytes,
    },
    /// Continue in a new file.
    Split(Done<FileSplit>),
    /// Pass all earlier messages to the operating system.
    Flush(Done<()>),
}

impl Item {
    pub(super) fn cost(&self) -> usize {
        match self {
            Self::Message { data, .. } => OVERHEAD + data.len(),
            Self::Topic(_) | Self::Split(_) | Self::Flush(_) => OVERHEAD,
        }
    }

    /// Returns whether a caller may wait for it.
    fn is_urgent(&self) -> bool {
        !matches!(self, Self::Message { .. })
    }

    /// The receive time of a message.
    pub(super) fn log_time(&self) -> Option<i64> {
        match self {
            Self::Message { log_time, .. } => Some(*log_time),
            Self::Topic(_) | Self::Split(_) | Self::Flush(_) => None,
        }
    }
}

pub(super) struct Queue {
    state: Mutex<State>,
    /// An item was added, or the queue was closed.
    filled: Condvar,
    /// Something was written, or the queue was closed.
    drained: Condvar,
    limit: usize,
    when_slow: WhenSlow,
}

#[derive(Default)]
pub(super) struct State {
    items: VecDeque<Item>,
    /// Bytes of queued items, including those taken by the thread but not yet written.
    pub(super) queued_bytes: usize,
    /// Names and types of the topics, in the order of their ids, and their lost messages.
    pub(super) topics: Vec<QueuedTopic>,
    /// The number of lost messages of all topics.
    pub(super) lost: u64,
    /// Keeps messages for snapshots instead of writing them.
    ring: Option<Ring>,
    pub(super) is_paused: bool,
    /// Whether it was closed because a message did not fit.
    pub(super) is_overrun: bool,
    is_closed: bool,
    /// The number of items that wakes the writing thread; `None` while it is not waiting.
    wakes_at: Option<usize>,
    /// The number of producers waiting for room.
    blocked: usize,
    /// The number of topics, splits and flushes in the queue, for which callers may wait.
    urgent: usize,
}

impl State {
    /// Bytes of items kept for a snapshot or to be written.
    pub(super) fn held_bytes(&self) -> usize {
        self.queued_bytes + self.ring.as_ref().map_or(0, Ring::bytes)
    }
}

pub(super) struct QueuedTopic {
    pub(super) name: String,
    pub(super) type_name: String,
    pub(super) lost: u64,
    /// How many of its messages a late subscriber receives.
    pub(super) latched_depth: usize,
}

impl QueuedTopic {
    pub(super) fn of(info: &TopicDescription) -> Self {
        let (name, type_name) = (info.name.clone(), info.type_name.clone());
        Self { name, type_name, lost: 0, latched_depth: info.latched_depth() }
    }
}

/// The next task of the writing thread.
pub(super) enum Work {
    Write,
    /// The time-out expired without items.
    TimedOut,
    /// The queue is closed and empty.
    End,
}

impl Queue {
    pub(super) fn new(options: &RecordingOptions, topics: Vec<QueuedTopic>) -> Self {
        let (limit, when_slow) = (options.cache_bytes, options.when_slow);
        let ring = options.snapshot.map(|limits| Ring::new(limits, options.repeats_latched));
        let state = State { topics, ring, is_paused: options.is_paused, ..State::default() };
        Self { state: Mutex::new(state), filled: Condvar::new(), drained: Condvar::new(), limit, when_slow }
    }

    pub(super) fn limit(&self) -> usize {
        self.limit
    }

    /// Ignores poisoning: a panic elsewhere leaves the counts usable.
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock()
    }

    pub(super) fn add_topic(&self, info: TopicDescription) -> Result<TopicId, RecordError> {
        let mut state = self.lock();
        if state.is_closed {
            return Err(RecordError::Stopped);
        }
        if let Some(index) = state.topics.iter().position(|topic| topic.name == info.name) {
            let first = &state.topics[index].type_name;
            if *first != info.type_name {
                return Err(RecordError::TypeConflict {
                    topic: info.name,
                    first: first.clone(),
                    second: info.type_name,
                });
            }
            return TopicId::from_index(index).ok_or(RecordError::TooManyTopics);
        }
        let id = TopicId::from_index(state.topics.len()).filter(|id| id.index() < usize::from(u16::MAX) - 1);
        let id = id.ok_or(RecordError::TooManyTopics)?;
        state.topics.push(QueuedTopic::of(&info));
        self.push(&mut state, Item::Topic(Box::new(info)));
        Ok(id)
    }

    /// Queues the message if there is room; else counts it as lost.
    pub(super) fn try_add(&self, topic: TopicId, item: Item) -> Result<(), RecordError> {
        let mut state = self.lock();
        if state.topics.get(topic.index()).is_none() {
            return Err(RecordError::UnknownTopic);
        }
        if state.is_closed {
            lose(&mut state, topic);
            return Err(RecordError::Stopped);
        }
        if state.is_paused {
            return Ok(());
        }
        if !self.has_room(&state, &item) {
            let (name, lost) = lose(&mut state, topic);
            if self.when_slow == WhenSlow::Stop {
                state.is_overrun = true;
                self.close_locked(&mut state);
            }
            return Err(RecordError::QueueFull { topic: name, lost });
        }
        self.push(&mut state, item);
        Ok(())
    }

    /// Waits until there is room, and queues the message.
    pub(super) fn add(&self, topic: TopicId, item: Item) -> Result<(), RecordError> {
        let mut state = self.lock();
        if state.ring.is_some() {
            drop(state);
            // The ring drops the oldest messages instead of waiting.
            return self.try_add(topic, item);
        }
        let waiting =
            |state: &mut State| !state.is_closed && !state.is_paused && !self.has_room(state, &item);
        if waiting(&mut state) {
            state.blocked += 1;
            self.wake_if(&mut state, |_| true);
            self.drained.wait_while(&mut state, waiting);
            state.blocked -= 1;
        }
        if state.topics.get(topic.index()).is_none() {
            return Err(RecordError::UnknownTopic);
        }
        if state.is_closed {
            lose(&mut state, topic);
            return Err(RecordError::Stopped);
        }
        if !state.is_paused {
            self.push(&mut state, item);
        }
        Ok(())
    }

    /// Queues an item that is not a message, regardless of the limit. Returns it if the queue is closed.
    pub(super) fn ask(&self, item: Item) -> Result<(), Item> {
        let mut state = self.lock();
        if state.is_closed {
            return Err(item);
        }
        self.put(&mut state, item);
        Ok(())
    }

    /// Queues the messages kept for snapshots, followed by the request, which reports completion. Returns the
    /// request if there are no snapshots, or the queue is closed.
    pub(super) fn snapshot(&self, request: Item) -> Result<(), Item> {
        let mut state = self.lock();
        if state.ring.is_none() || state.is_closed {
            return Err(request);
        }
        self.take_snapshot(&mut state, request);
        Ok(())
    }

    /// Queues the messages kept for snapshots once a later message than `until` arrives, or at the end.
    /// Messages are kept as at the time `trigger` until then. Returns false if there are no snapshots, or the
    /// queue is closed.
    pub(super) fn snapshot_around(&self, trigger: i64, until: i64) -> bool {
        let mut state = self.lock();
        let State { ring: Some(ring), is_closed: false, .. } = &mut *state else { return false };
        ring.trigger(trigger, until);
        if ring.is_complete(ring.latest) {
            self.take_snapshot(&mut state, Item::Flush(Done::new(report_snapshot)));
        }
        true
    }

    fn take_snapshot(&self, state: &mut State, request: Item) {
        if let Some(ring) = &mut state.ring {
            let before = state.items.len();
            state.items.extend(ring.drain());
            let cost: usize = state.items.iter().skip(before).map(Item::cost).sum();
            state.queued_bytes += cost;
        }
        self.put(state, request);
    }

    pub(super) fn keeps_snapshots(&self) -> bool {
        self.lock().ring.is_some()
    }

    pub(super) fn is_closed(&self) -> bool {
        self.lock().is_closed
    }

    /// Releases producers that wait for room: their messages are not recorded.
    pub(super) fn set_paused(&self, change: impl FnOnce(bool) -> bool) -> bool {
        let mut state = self.lock();
        state.is_paused = change(state.is_paused);
        self.drained.notify_all();
        state.is_paused
    }

    /// Rejects new items; queued items can still be taken.
    pub(super) fn close(&self) {
        let mut state = self.lock();
        if !state.is_closed && state.ring.as_ref().is_some_and(Ring::is_triggered) {
            self.take_snapshot(&mut state, Item::Flush(Done::new(report_snapshot)));
        }
        self.close_locked(&mut state);
    }

    /// Closes the queue and counts its items, and the rest of a batch, as lost.
    pub(super) fn abandon(&self, rest: impl IntoIterator<Item = Item>) {
        // Dropped after releasing the lock, since dropping a request completes it.
        let mut items: Vec<Item> = rest.into_iter().collect();
        let mut state = self.lock();
        items.extend(state.items.drain(..));
        for item in &items {
            if let Item::Message { topic, .. } = item {
                lose(&mut state, *topic);
            }
        }
        state.queued_bytes = 0;
        state.urgent = 0;
        // Under the same lock, otherwise a message could be added in between and never be counted.
        self.close_locked(&mut state);
    }

    /// Waits for items, at most `timeout`, and moves some into `batch`. Releases the room of the previous
    /// batch.
    pub(super) fn take(&self, batch: &mut Vec<Item>, written: usize, timeout: Option<Duration>) -> Work {
        let mut state = self.lock();
        state.queued_bytes = state.queued_bytes.saturating_sub(written);
        if written > 0 && state.blocked > 0 {
            self.drained.notify_all();
        }
        self.wait_for(1, &mut state, timeout);
        if !state.items.is_empty() {
            let linger = timeout.map_or(LINGER, |timeout| timeout.min(LINGER));
            self.wait_for(BATCH, &mut state, Some(linger));
        }
        let count = state.items.len().min(BATCH);
        batch.extend(state.items.drain(..count));
        state.urgent = state.urgent.saturating_sub(batch.iter().filter(|item| item.is_urgent()).count());
        match (count, state.is_closed) {
            (0, true) => Work::End,
            (0, false) => Work::TimedOut,
            _ => Work::Write,
        }
    }

    /// Waits until there are enough items, an urgent one, or little room for more.
    fn wait_for(&self, count: usize, state: &mut MutexGuard<'_, State>, timeout: Option<Duration>) {
        let is_waiting = |state: &mut State| {
            let is_pressing = state.urgent > 0 || state.blocked > 0 || self.is_half_full(state);
            let is_waiting = state.items.len() < count && !is_pressing && !state.is_closed;
            state.wakes_at = is_waiting.then_some(count);
            is_waiting
        };
        match timeout {
            Some(timeout) => drop(self.filled.wait_while_for(state, is_waiting, timeout)),
            None => self.filled.wait_while(state, is_waiting),
        }
        state.wakes_at = None;
    }

    pub(super) fn cost(batch: &[Item]) -> usize {
        batch.iter().map(Item::cost).sum()
    }

    /// A message larger than the limit is accepted if the queue is empty.
    fn has_room(&self, state: &State, item: &Item) -> bool {
        if let Some(ring) = &state.ring {
            return ring.fits(item);
        }
        state.queued_bytes == 0 || state.queued_bytes + item.cost() <= self.limit
    }

    fn is_half_full(&self, state: &State) -> bool {
        state.queued_bytes >= self.limit / 2 && !state.items.is_empty()
    }

    fn close_locked(&self, state: &mut State) {
        state.is_closed = true;
        self.filled.notify_all();
        self.drained.notify_all();
    }

    fn push(&self, state: &mut State, item: Item) {
        let (Some(ring), Item::Message { log_time, .. }) = (&state.ring, &item) else {
            return self.put(state, item);
        };
        if ring.is_complete(*log_time) {
            self.take_snapshot(state, Item::Flush(Done::new(report_snapshot)));
        }
        if let Some(ring) = &mut state.ring {
            ring.push(item, &state.topics);
        }
    }

    fn put(&self, state: &mut State, item: Item) {
        state.queued_bytes += item.cost();
        state.urgent += usize::from(item.is_urgent());
        state.items.push_back(item);
        self.wake_if(state, |state| {
            let is_enough = state.wakes_at.is_some_and(|count| state.items.len() >= count);
            is_enough || state.urgent > 0 || self.is_half_full(state)
        });
    }

    /// Wakes the writing thread if it is waiting and work is due: notifying costs a system call even if
    /// nobody waits.
    fn wake_if(&self, state: &mut State, is_due: impl FnOnce(&State) -> bool) {
        if state.wakes_at.is_some() && is_due(state) {
            state.wakes_at = None;
            self.filled.notify_one();
        }
    }
}

/// Counts a message as lost; returns the name of its topic and the number of its losses.
fn lose(state: &mut State, topic: TopicId) -> (String, u64) {
    let Some(entry) = state.topics.get_mut(topic.index()) else { return (String::new(), 0) };
    entry.lost += 1;
    state.lost += 1;
    (entry.name.clone(), entry.lost)
}

fn report_snapshot(written: Result<(), ControlError>) {
    match written {
        Ok(()) => tracing::info!("a snapshot is written"),
        Err(error) => tracing::error!("a snapshot is not complete: {error}"),
    }
}

/// Messages within the limits; the oldest are dropped first.
pub(super) struct Ring {
    limits: SnapshotLimits,
    items: VecDeque<Item>,
    bytes: usize,
    /// The latest receive time.
    latest: i64,
    /// The snapshot to take.
    triggered: Option<Triggered>,
    /// Whether the last messages of latched topics are kept beyond the limits.
    repeats_latched: bool,
    /// The last messages of latched topics of those that were dropped, and their size.
    dropped: BTreeMap<TopicId, VecDeque<Item>>,
    dropped_bytes: usize,
}

/// A snapshot of the messages before and after a time.
struct Triggered {
    at: i64,
    /// The receive time of its last message, at most.
    until: i64,
}

impl Ring {
    pub(super) fn new(limits: SnapshotLimits, repeats_latched: bool) -> Self {
        Self {
            limits,
            items: VecDeque::new(),
            bytes: 0,
            latest: i64::MIN,
            triggered: None,
            repeats_latched,
            dropped: BTreeMap::new(),
            dropped_bytes: 0,
        }
    }

    /// Another trigger before the snapshot is taken makes it longer.
    fn trigger(&mut self, at: i64, until: i64) {
        self.triggered = Some(match &self.triggered {
            None => Triggered { at, until },
            Some(first) => Triggered { at: first.at.min(at), until: first.until.max(until) },
        });
    }

    fn is_triggered(&self) -> bool {
        self.triggered.is_some()
    }

    /// Returns whether a message of that time does not belong to the snapshot to take.
    fn is_complete(&self, log_time: i64) -> bool {
        self.triggered.as_ref().is_some_and(|triggered| log_time > triggered.until)
    }

    pub(super) fn bytes(&self) -> usize {
        self.bytes
    }

    /// Returns whether a message can be kept at all.
    pub(super) fn fits(&self, item: &Item) -> bool {
        item.cost() <= self.limits.max_bytes
    }

    pub(super) fn push(&mut self, item: Item, topics: &[QueuedTopic]) {
        self.latest = self.latest.max(item.log_time().unwrap_or(i64::MIN));
        self.bytes += item.cost();
        self.items.push_back(item);
        while self.items.front().is_some_and(|oldest| self.is_over(oldest)) {
            if let Some(oldest) = self.items.pop_front() {
                self.bytes -= oldest.cost();
                self.keep_dropped(oldest, topics);
            }
        }
    }

    /// Keeps the last messages of latched topics, which may take as much memory as the others.
    fn keep_dropped(&mut self, item: Item, topics: &[QueuedTopic]) {
        let Item::Message { topic, .. } = item else { return };
        let depth = topics.get(topic.index()).map_or(0, |topic| topic.latched_depth);
        if depth == 0 || !self.repeats_latched {
            return;
        }
        let kept = self.dropped.entry(topic).or_default();
        self.dropped_bytes += item.cost();
        kept.push_back(item);
        while kept.len() > depth || self.dropped_bytes > self.limits.max_bytes {
            let Some(oldest) = kept.pop_front() else { break };
            self.dropped_bytes -= oldest.cost();
        }
    }

    /// Removes all messages. Those that a subscriber joining at the first one would receive come before it.
    pub(super) fn drain(&mut self) -> impl Iterator<Item = Item> + '_ {
        self.bytes = 0;
        self.dropped_bytes = 0;
        self.triggered = None;
        let first = self.items.front().and_then(Item::log_time);
        let latched = std::mem::take(&mut self.dropped).into_values().flatten();
        let latched = latched.map(move |item| match item {
            Item::Message { topic, log_time, publish_time, data } => {
                Item::Message { topic, log_time: first.unwrap_or(log_time), publish_time, data }
            }
            other => other,
        });
        latched.chain(self.items.drain(..))
    }

    fn is_over(&self, oldest: &Item) -> bool {
        // What is before a trigger stays until the snapshot is taken.
        let latest = self.triggered.as_ref().map_or(self.latest, |triggered| triggered.at.min(self.latest));
        let age = oldest.log_time().map_or(0, |time| latest.saturating_sub(time));
        let is_old = |most: Duration| u128::try_from(age).is_ok_and(|age| age > most.as_nanos());
        self.bytes > self.limits.max_bytes || self.limits.max_duration.is_some_and(is_old)
    }
}
