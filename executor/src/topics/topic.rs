//! Topics: a name, a message type, the batch of the last cycle, and the subscribers.

use std::any::{Any, TypeId, type_name};
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use super::batch::{AnyBatch, Batch};
use super::names::canonical_name;
use super::outbox::{AnyMessage, AnyOutbox, Outbox};
use crate::observe::TopicMeter;
use crate::threads::drop_guarded;
use crate::{SetupError, Time, TopicStatistics};

/// A description of a topic, see [`Core::topics`](crate::Core::topics).
#[derive(Clone, Debug)]
pub struct TopicInfo {
    /// The name, without a leading slash.
    pub name: Arc<str>,
    /// The Rust path of the message type, or its [name](crate::MessageType::named).
    pub message_type: &'static str,
    /// The identity of the message type.
    pub message_type_id: TypeId,
    /// True if a module publishes on the topic.
    pub is_published: bool,
    /// Counts the messages of the topic while the core runs.
    pub counter: TopicCounter,
}

/// Counts the messages of a topic; clones share the count.
#[derive(Clone, Debug, Default)]
pub struct TopicCounter(Arc<AtomicU64>);

impl TopicCounter {
    /// The number of messages that the topic has carried.
    #[must_use]
    pub fn messages(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }

    /// Only the thread of the core writes the counter, so a read-modify-write operation is not needed.
    #[inline]
    pub(super) fn add(&self, messages: usize) {
        self.0.store(self.messages() + messages as u64, Ordering::Relaxed);
    }
}

/// A receiver of a topic's batches.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Subscriber {
    /// A module that runs inside the cycle, by its slot. It is woken, and reads the topic itself.
    Attached(usize),
    /// A detached module, which receives one batch for all its callbacks.
    Detached(usize),
    /// An outlet, by its slot.
    Outlet(usize),
}

pub(crate) struct Topic<T> {
    batch: Arc<Batch<T>>,
    counter: TopicCounter,
}

/// A [`Topic`] whose message type is known only to its publishers and subscribers.
pub(crate) trait AnyTopic: Any + Send + Sync {
    /// Drops the messages of an earlier cycle, unless the batch is still shared.
    fn retire(&mut self);
    /// Takes the messages out of an outbox of this topic. The first ones of a cycle replace the messages of
    /// the earlier cycle. Returns the number of messages taken.
    fn absorb(&mut self, outbox: &mut dyn AnyOutbox, now: Time, is_first: bool) -> usize;
    /// The batch, for use on another thread, and the number of messages in it.
    fn share(&self) -> (Arc<dyn AnyBatch>, u32);
    /// The number of messages in the batch.
    fn messages(&self) -> usize;
    /// Takes the messages out of a topic that carries them in boxes; `None` for a typed one.
    fn take_boxed(&mut self) -> Option<Carried> {
        None
    }
}

/// The messages of a topic that becomes a typed one.
#[derive(Default)]
pub(crate) struct Carried {
    pub(super) time: Time,
    pub(super) messages: Vec<AnyMessage>,
}

/// How to create a topic of a type.
pub(crate) struct NewTopic<'a> {
    /// The identity of the message type, and its path.
    pub(super) identity: (TypeId, &'static str),
    pub(super) needs_drop: bool,
    /// False if the messages are in boxes.
    pub(super) is_typed: bool,
    pub(super) make: &'a dyn Fn(TopicCounter, Carried) -> Box<dyn AnyTopic>,
}

/// The batch, emptied; a new one if the old one is still shared.
#[inline(always)]
fn renewed<T>(batch: &mut Arc<Batch<T>>) -> Option<&mut Batch<T>> {
    if Arc::strong_count(batch) > 1 {
        *batch = Arc::default();
    }
    let batch = Arc::get_mut(batch)?;
    if !std::mem::needs_drop::<T>() {
        batch.forget();
    } else if !drop_guarded("a message", || batch.clear()) {
        // The remaining messages are leaked, because dropping them could panic again.
        std::mem::forget(std::mem::take(batch));
    }
    Some(batch)
}

impl<T: Send + Sync + 'static> Topic<T> {
    fn carrying(counter: TopicCounter, mut carried: Carried) -> Box<dyn AnyTopic> {
        let mut batch = Batch::<T>::default();
        if !carried.messages.is_empty() {
            batch.stamp(carried.time);
            batch.unbox(&mut carried.messages);
        }
        Box::new(Self { batch: Arc::new(batch), counter })
    }
}

impl<T: Send + Sync + 'static> AnyTopic for Topic<T> {
    fn retire(&mut self) {
        renewed(&mut self.batch);
    }

    fn absorb(&mut self, outbox: &mut dyn AnyOutbox, now: Time, is_first: bool) -> usize {
        let batch = if is_first { renewed(&mut self.batch) } else { Arc::get_mut(&mut self.batch) };
        // Holds by construction: a batch is shared only after the sync phase has filled it.
        let Some(batch) = batch else {
            debug_assert!(false, "an outbox reached a batch in use");
            return 0;
        };
        batch.stamp(now);
        let messages = match (outbox as &mut dyn Any).downcast_mut::<Outbox<T>>() {
            Some(outbox) => {
                let messages = outbox.messages.len();
                batch.take_over(&mut outbox.messages);
                messages
            }
            // Outboxes are opened through the topic's type check, so this one is of boxes.
            None => outbox.boxed().map_or(0, |messages| batch.unbox(messages)),
        };
        self.counter.add(messages);
        messages
    }

    fn share(&self) -> (Arc<dyn AnyBatch>, u32) {
        let messages = u32::try_from(self.batch.len()).unwrap_or(u32::MAX);
        (Arc::clone(&self.batch) as Arc<dyn AnyBatch>, messages)
    }

    fn messages(&self) -> usize {
        self.batch.len()
    }
}

/// All topics of a core.
#[derive(Default)]
pub(crate) struct Topics {
    entries: Vec<Entry>,
    by_name: HashMap<Arc<str>, usize>,
    /// No entry with a smaller index is free.
    free_from: usize,
    /// Incremented in each sync phase of messages.
    epoch: u64,
    /// True if a topic has messages of this epoch.
    is_any_fresh: bool,
    /// Topics with messages of this epoch for detached modules and outlets, in the order of the messages.
    shared: Vec<usize>,
    /// Topics with messages of this epoch that have a destructor to run in a later sync phase.
    dropping: Vec<usize>,
    /// `dropping` of the previous epoch, during the sync phase.
    stale: Vec<usize>,
    /// The topics that the executor itself publishes, by [`Report::NUMBER`].
    reports: Vec<ReportTopic>,
    has_reports: bool,
    /// The reports that have subscribers, as bits by [`Report::NUMBER`].
    heard: u32,
    /// Counts changes of the topics, their subscribers and the modules.
    version: u64,
}

/// A message that the executor itself publishes if the topic has subscribers.
pub(crate) trait Report: Send + Sync + 'static {
    const TOPIC: &'static str;
    /// The index of the topic among those of the executor.
    const NUMBER: usize;
}

struct ReportTopic {
    /// `None` if the topic exists with another type.
    topic: Option<usize>,
    outbox: Box<dyn AnyOutbox + Sync>,
}

struct Entry {
    topic: Box<dyn AnyTopic>,
    /// The last epoch in which the topic carried messages; 0 for none.
    epoch: u64,
    /// True if the messages have a destructor.
    needs_drop: bool,
    meter: TopicMeter,
    /// The slots of modules that run inside the cycle.
    attached: Vec<usize>,
    /// Detached modules and outlets.
    others: Vec<Subscriber>,
    info: TopicInfo,
    publishers: u32,
    /// The number of publications, subscriptions and inlets. An unused topic is removed.
    users: u32,
    /// True if `info.message_type` is a name, see [`MessageType::named`](crate::MessageType::named).
    is_named: bool,
}

/// Placeholder of a removed topic.
struct Forgotten;

impl AnyTopic for Forgotten {
    fn retire(&mut self) {}

    fn absorb(&mut self, outbox: &mut dyn AnyOutbox, _now: Time, _is_first: bool) -> usize {
        outbox.discard();
        0
    }

    fn share(&self) -> (Arc<dyn AnyBatch>, u32) {
        (Arc::new(Batch::<()>::default()), 0)
    }

    fn messages(&self) -> usize {
        0
    }
}

impl Topics {
    /// The index of the topic of this name; creates the topic if there is none.
    pub(crate) fn open<T: Send + Sync + 'static>(
        &mut self,
        name: &str,
        module: &str,
    ) -> Result<usize, SetupError> {
        // As a pointer, so that the closure type is one for all message types.
        let make: fn(TopicCounter, Carried) -> Box<dyn AnyTopic> = Topic::<T>::carrying;
        let new = NewTopic {
            identity: (TypeId::of::<T>(), type_name::<T>()),
            needs_drop: std::mem::needs_drop::<T>(),
            is_typed: true,
            make: &make,
        };
        self.open_of(&new, name, module)
    }

    /// Names the messages of a topic, unless they have another name.
    pub(crate) fn name_messages(
        &mut self,
        index: usize,
        name: &'static str,
        module: &str,
    ) -> Result<(), SetupError> {
        let Entry { info, is_named, .. } = &mut self.entries[index];
        if *is_named && info.message_type != name {
            return Err(SetupError::TopicType {
                module: module.into(),
                topic: info.name.to_string(),
                asked: name,
                known: info.message_type,
            });
        }
        (info.message_type, *is_named) = (name, true);
        Ok(())
    }

    /// As [`open`](Self::open), for a type given by identity and name; compiled once for all message types.
    pub(super) fn open_of(
        &mut self,
        new: &NewTopic<'_>,
        name: &str,
        module: &str,
    ) -> Result<usize, SetupError> {
        let (message_type_id, message_type) = new.identity;
        let name = canonical_name(name)
            .ok_or_else(|| SetupError::InvalidTopicName { module: module.into(), topic: name.into() })?;
        if let Some(&index) = self.by_name.get(name) {
            let entry = &mut self.entries[index];
            let known = &entry.info;
            if known.message_type_id != message_type_id {
                return Err(SetupError::TopicType {
                    module: module.into(),
                    topic: name.into(),
                    asked: message_type,
                    known: known.message_type,
                });
            }
            if new.is_typed
                && let Some(carried) = entry.topic.take_boxed()
            {
                let is_fresh = entry.epoch == self.epoch;
                let (carried, old) =
                    if is_fresh { (carried, Carried::default()) } else { (Carried::default(), carried) };
                entry.topic = (new.make)(entry.info.counter.clone(), carried);
                entry.needs_drop = new.needs_drop;
                drop_guarded("a message", || drop(old));
            }
            return Ok(index);
        }
        let (name, counter) = (Arc::<str>::from(name), TopicCounter::default());
        let topic = (new.make)(counter.clone(), Carried::default());
        let info = TopicInfo {
            name: Arc::clone(&name),
            message_type,
            message_type_id,
            is_published: false,
            counter,
        };
        let entry = Entry {
            topic,
            epoch: 0,
            needs_drop: new.needs_drop,
            meter: TopicMeter::default(),
            attached: Vec::new(),
            others: Vec::new(),
            info,
            publishers: 0,
            users: 0,
            is_named: false,
        };
        let candidates = self.entries.get(self.free_from..).unwrap_or_default();
        let index = match candidates.iter().position(|entry| entry.users == 0) {
            Some(position) => {
                let free = self.free_from + position;
                self.entries[free] = entry;
                free
            }
            None => {
                self.entries.push(entry);
                self.entries.len() - 1
            }
        };
        self.free_from = index;
        self.by_name.insert(name, index);
        self.version += 1;
        Ok(index)
    }

    /// Changes whenever topics or modules come or go.
    pub(crate) fn version(&self) -> u64 {
        self.version
    }

    /// Notes that a module has come or gone.
    pub(crate) fn module_changed(&mut self) {
        self.version += 1;
    }

    /// The names by index, including those of topics that are no longer in use.
    pub(crate) fn names(&self) -> impl Iterator<Item = &Arc<str>> {
        self.entries.iter().map(|entry| &entry.info.name)
    }

    pub(crate) fn subscribe(&mut self, topic: usize, subscriber: Subscriber) {
        let Entry { attached, others, .. } = &mut self.entries[topic];
        match subscriber {
            Subscriber::Attached(slot) if !attached.contains(&slot) => attached.push(slot),
            Subscriber::Detached(_) | Subscriber::Outlet(_) if !others.contains(&subscriber) => {
                others.push(subscriber);
            }
            _ => {}
        }
        self.note_heard();
    }

    pub(crate) fn unsubscribe(&mut self, topic: usize, subscriber: Subscriber) {
        let Entry { attached, others, .. } = &mut self.entries[topic];
        match subscriber {
            Subscriber::Attached(slot) => attached.retain(|known| *known != slot),
            Subscriber::Detached(_) | Subscriber::Outlet(_) => others.retain(|known| *known != subscriber),
        }
        self.note_heard();
    }

    pub(crate) fn add_user(&mut self, topic: usize) {
        self.entries[topic].users += 1;
    }

    pub(crate) fn add_publisher(&mut self, topic: usize) {
        let entry = &mut self.entries[topic];
        entry.users += 1;
        entry.publishers += 1;
        entry.info.is_published = true;
    }

    pub(crate) fn release_publisher(&mut self, topic: usize) {
        let entry = &mut self.entries[topic];
        entry.publishers -= 1;
        entry.info.is_published = entry.publishers > 0;
        self.release(topic);
    }

    /// Ends one use of the topic. The last one removes the topic and drops its messages.
    pub(crate) fn release(&mut self, topic: usize) {
        let entry = &mut self.entries[topic];
        entry.users -= 1;
        if entry.users == 0 {
            self.free_from = self.free_from.min(topic);
            self.by_name.remove(&entry.info.name);
            let forgotten = std::mem::replace(&mut entry.topic, Box::new(Forgotten));
            drop_guarded("a message", || drop(forgotten));
        }
    }

    /// Opens the next topic of the executor itself. If the topic exists with another type, the executor
    /// publishes nothing on it.
    pub(crate) fn open_report<R: Report>(&mut self) {
        debug_assert_eq!(self.reports.len(), R::NUMBER);
        let topic = self.open::<R>(R::TOPIC, "executor").ok();
        topic.iter().for_each(|&topic| self.add_user(topic));
        let outbox = Outbox::<R> { topic: topic.unwrap_or_default(), messages: Vec::new() };
        self.reports.push(ReportTopic { topic, outbox: Box::new(outbox) });
        self.note_heard();
    }

    fn note_heard(&mut self) {
        let is_heard = |report: &ReportTopic| {
            report.topic.is_some_and(|topic| {
                let Entry { attached, others, .. } = &self.entries[topic];
                !(attached.is_empty() && others.is_empty())
            })
        };
        let bits =
            self.reports.iter().enumerate().map(|(number, report)| u32::from(is_heard(report)) << number);
        self.heard = bits.sum();
    }

    /// True if these reports have a subscriber.
    #[inline]
    pub(crate) fn hears<R: Report>(&self) -> bool {
        self.heard & (1 << R::NUMBER) != 0
    }

    /// Publishes a report in the next sync phase.
    pub(crate) fn report<R: Report>(&mut self, report: R) {
        let topic = self.reports.get_mut(R::NUMBER).map(|known| &mut *known.outbox as &mut dyn Any);
        if let Some(outbox) = topic.and_then(|outbox| outbox.downcast_mut::<Outbox<R>>()) {
            outbox.messages.push(report);
            self.has_reports = true;
        }
    }

    /// The reports that are published in the next sync phase.
    pub(crate) fn waiting_reports<R: Report>(&self) -> &[R] {
        let outbox = self.reports.get(R::NUMBER).map(|known| &*known.outbox as &dyn Any);
        outbox.and_then(|outbox| outbox.downcast_ref::<Outbox<R>>()).map_or(&[], |outbox| &outbox.messages)
    }

    #[inline]
    pub(crate) fn has_reports(&self) -> bool {
        self.has_reports
    }

    /// Publishes the waiting reports as messages of this cycle.
    #[cold]
    pub(crate) fn take_reports(&mut self, now: Time, wake: &mut dyn FnMut(usize)) {
        self.has_reports = false;
        let mut reports = std::mem::take(&mut self.reports);
        for report in reports.iter_mut().filter(|report| !report.outbox.is_empty()) {
            self.absorb(&mut *report.outbox, now, wake);
        }
        self.reports = reports;
    }

    pub(crate) fn infos(&self) -> impl Iterator<Item = &TopicInfo> {
        self.entries.iter().filter(|entry| entry.users > 0).map(|entry| &entry.info)
    }

    #[inline]
    pub(crate) fn meter_mut(&mut self, topic: usize) -> &mut TopicMeter {
        &mut self.entries[topic].meter
    }

    /// The statistics of all topics in use.
    pub(crate) fn statistics(&self) -> impl Iterator<Item = TopicStatistics> {
        self.entries.iter().filter(|entry| entry.users > 0).map(
            |Entry { info, meter, attached, others, .. }| {
                let (messages, subscribers) = (info.counter.messages(), attached.len() + others.len());
                meter.statistics(&info.name, info.message_type, messages, subscribers)
            },
        )
    }

    pub(crate) fn name(&self, topic: usize) -> &Arc<str> {
        &self.entries[topic].info.name
    }

    /// The detached modules and outlets that receive the topic.
    pub(crate) fn others(&self, topic: usize) -> &[Subscriber] {
        &self.entries[topic].others
    }

    /// The messages that the topic carries in this cycle.
    #[inline]
    pub(crate) fn batch<T: Send + Sync + 'static>(&self, topic: usize) -> Option<&Arc<Batch<T>>> {
        let entry = &self.entries[topic];
        if entry.epoch != self.epoch {
            return None;
        }
        (&*entry.topic as &dyn Any).downcast_ref::<Topic<T>>().map(|topic| &topic.batch)
    }

    /// As [`batch`](Self::batch), for a type known only to the topic, and the number of messages in it.
    pub(crate) fn batch_of(&self, topic: usize) -> Option<(Arc<dyn AnyBatch>, u32)> {
        (self.entries[topic].epoch == self.epoch).then(|| self.share(topic))
    }

    pub(crate) fn share(&self, topic: usize) -> (Arc<dyn AnyBatch>, u32) {
        self.entries[topic].topic.share()
    }

    /// The number of messages that [`share`](Self::share) would return.
    pub(crate) fn messages(&self, topic: usize) -> u32 {
        u32::try_from(self.entries[topic].topic.messages()).unwrap_or(u32::MAX)
    }

    /// The first step of messaging in the sync phase: marks the messages of the last cycle as stale.
    #[inline]
    pub(crate) fn begin(&mut self) {
        self.epoch += 1;
        self.is_any_fresh = false;
        self.shared.clear();
        if !self.dropping.is_empty() {
            std::mem::swap(&mut self.dropping, &mut self.stale);
        }
    }

    /// Takes the messages out of an outbox, and calls `wake` with the slots of the modules that receive them
    /// inside the cycle. Returns the number of messages.
    #[inline]
    pub(crate) fn absorb(
        &mut self,
        outbox: &mut dyn AnyOutbox,
        now: Time,
        wake: &mut dyn FnMut(usize),
    ) -> usize {
        let index = outbox.topic();
        self.absorb_for(index, outbox, now, wake)
    }

    /// As [`absorb`](Self::absorb), for an outbox of this topic.
    #[inline]
    pub(crate) fn absorb_for(
        &mut self,
        index: usize,
        outbox: &mut dyn AnyOutbox,
        now: Time,
        mut wake: impl FnMut(usize),
    ) -> usize {
        let entry = &mut self.entries[index];
        let is_first = entry.epoch != self.epoch;
        let messages = entry.topic.absorb(outbox, now, is_first);
        if is_first {
            entry.epoch = self.epoch;
            self.is_any_fresh = true;
            entry.meter.begin_batch(messages, now);
            for &slot in &entry.attached {
                wake(slot);
            }
            if !entry.others.is_empty() {
                self.shared.push(index);
            }
            if entry.needs_drop {
                self.dropping.push(index);
            }
        } else {
            entry.meter.carried(messages);
        }
        messages
    }

    /// The last step: drops the messages that are still stale.
    #[inline]
    pub(crate) fn finish(&mut self) {
        if !self.stale.is_empty() {
            self.drop_stale();
        }
    }

    fn drop_stale(&mut self) {
        for &index in &self.stale {
            let entry = &mut self.entries[index];
            if entry.epoch != self.epoch {
                entry.topic.retire();
            }
        }
        self.stale.clear();
    }

    /// True if a topic carries messages after the last sync phase.
    #[inline]
    pub(crate) fn is_any_fresh(&self) -> bool {
        self.is_any_fresh
    }

    /// The modules inside the cycle, by slot, that receive messages in the next process phase, each with the
    /// topic.
    pub(crate) fn fresh(&self) -> impl Iterator<Item = (usize, &Arc<str>)> {
        self.carrying().flat_map(|entry| entry.attached.iter().map(|&slot| (slot, &entry.info.name)))
    }

    /// The topics with messages of the last sync phase, and the number of these messages.
    pub(crate) fn carried(&self) -> impl Iterator<Item = (&Arc<str>, usize)> {
        self.carrying().map(|entry| (&entry.info.name, entry.topic.messages()))
    }

    fn carrying(&self) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(|entry| entry.users > 0 && entry.epoch == self.epoch)
    }

    /// The topics with messages of the last sync phase for detached modules and outlets, in the order of the
    /// messages.
    #[inline]
    pub(crate) fn shared(&self) -> &[usize] {
        &self.shared
    }
}

impl Drop for Topics {
    /// Drops all messages, guarded against panics in their destructors.
    fn drop(&mut self) {
        self.begin();
        self.finish();
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_topic_that_nobody_uses_is_forgotten_and_its_place_used_again() {
        let mut topics = Topics::default();
        let speed = topics.open::<u8>("speed", "first").unwrap();
        topics.add_publisher(speed);
        topics.add_user(speed);
        topics.release_publisher(speed);
        assert_eq!(topics.infos().map(|info| info.is_published).collect::<Vec<_>>(), [false]);
        topics.release(speed);
        assert_eq!(topics.infos().count(), 0);
        let other = topics.open::<f32>("speed", "second").unwrap();
        assert_eq!(other, speed);
    }

    #[test]
    fn one_topic_cannot_have_two_types() {
        let mut topics = Topics::default();
        let index = topics.open::<u8>("speed", "first").unwrap();
        topics.add_user(index);
        assert_eq!(topics.open::<u8>("/speed", "second").unwrap(), index);
        let error = topics.open::<f32>("speed", "third").unwrap_err().to_string();
        assert!(error.contains("third") && error.contains("speed") && error.contains("u8"), "{error}");
    }
}
