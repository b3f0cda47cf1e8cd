//! Writers and readers of topics.

use super::domain::{Announcement, Domain, now_ns, of_topic};
use super::order::{MOST_WRITERS, Order, Taken};
use super::qos::{MOST_KEPT, to_zenoh};
use super::repair::{Gap, Incomplete};
use crate::middleware::rtps::is_cdr;
use crate::middleware::{
    Endpoint, EndpointEvent, EventHandler, Gid, MatchHandler, MiddlewareError, Reader, ReaderCounter, Sample,
    SampleHandler, SendOptions, WriteError, WriteOptions, Writer,
};
use bytes::Bytes;
use downbeat_msgs::qos::{Durability, History, Reliability};
use downbeat_zenoh::wire::{Attachment, EndpointToken, Role, key, keys_of_any_hash};
use downbeat_zenoh::zenoh::bytes::ZBytes;
use downbeat_zenoh::zenoh::matching::MatchingStatus;
use downbeat_zenoh::zenoh::qos::CongestionControl;
use downbeat_zenoh::zenoh::sample::{Sample as ZenohSample, SampleKind};
use downbeat_zenoh::zenoh::{Error, Session, Wait, qos};
use downbeat_zenoh::zenoh_ext::{
    AdvancedPublisher, AdvancedPublisherBuilderExt, AdvancedSubscriber, AdvancedSubscriberBuilderExt,
    CacheConfig, HistoryConfig, MissDetectionConfig, RecoveryConfig,
};
use parking_lot::Mutex;
use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;

/// How often a reliable transient local publisher says which sample is its last, as `rmw_zenoh_cpp` does.
const HEARTBEAT: Duration = Duration::from_millis(500);

pub(super) struct ZenohWriter {
    // Dropped in this order: nobody sees an endpoint that is gone.
    announcement: Announcement,
    domain: Arc<Domain>,
    sending: Arc<Sending>,
    readers: Readers,
    must_block: bool,
}

/// Who receives from a writer: endpoints that have announced themselves and, where access control hides them,
/// or for programs of Zenoh that are no nodes, at least somebody.
#[derive(Clone)]
struct Readers {
    announced: Arc<AtomicUsize>,
    is_anybody: Arc<AtomicBool>,
}

impl Readers {
    fn count(&self) -> usize {
        let anybody = usize::from(self.is_anybody.load(Ordering::Relaxed));
        self.announced.load(Ordering::Relaxed).max(anybody)
    }
}

struct Sending {
    publisher: AdvancedPublisher<'static>,
    /// The number of the last sample. Held while one is numbered and handed over, so that they stay in order.
    last: Mutex<i64>,
    gid: Gid,
}

impl ZenohWriter {
    pub(super) fn new(domain: &Arc<Domain>, endpoint: &Endpoint) -> Result<Self, MiddlewareError> {
        let refused = |error: &Error| refused("writer", endpoint, error.to_string());
        let token = of_topic(endpoint, Role::Publisher).ok_or_else(|| no_topic("writer", endpoint))?;
        let key = key(domain.domain_id, &token.name, &token.type_name, token.hash.as_deref());
        let is_reliable = endpoint.qos.reliability == Reliability::Reliable;
        let must_block = is_reliable && endpoint.qos.history == History::KeepAll;
        let reliability = if is_reliable { qos::Reliability::Reliable } else { qos::Reliability::BestEffort };
        let congestion = if must_block { CongestionControl::Block } else { CongestionControl::Drop };
        let publisher = domain.session.declare_publisher(key);
        let publisher = publisher.reliability(reliability).congestion_control(congestion);
        let SendOptions { priority, is_express } = endpoint.send;
        let mut publisher = publisher.priority(to_zenoh(priority)).express(is_express).advanced();
        if endpoint.qos.durability == Durability::TransientLocal {
            let cache = CacheConfig::default().max_samples(kept(endpoint.qos.history));
            publisher = publisher.cache(cache).publisher_detection();
            if is_reliable {
                let detection = MissDetectionConfig::default().sporadic_heartbeat(HEARTBEAT);
                publisher = publisher.sample_miss_detection(detection);
            }
        }
        let publisher = publisher.wait().map_err(|error| refused(&error))?;
        let described = domain.describe(endpoint.node.as_ref(), token);
        let sending = Sending { publisher, last: Mutex::default(), gid: described.gid };
        let is_anybody = Arc::<AtomicBool>::default();
        let changed = {
            let (domain, is_anybody, gid) = (Arc::downgrade(domain), Arc::clone(&is_anybody), sending.gid);
            move |status: MatchingStatus| {
                is_anybody.store(status.matching(), Ordering::Relaxed);
                if let Some(domain) = domain.upgrade() {
                    domain.graph.way_changed(gid);
                }
            }
        };
        let listener = sending.publisher.matching_listener().callback(changed).background().wait();
        listener.map_err(|error| refused(&error))?;
        let announcement = domain.announce(described, refused)?;
        Ok(Self {
            readers: Readers { announced: domain.graph.match_count(announcement.gid), is_anybody },
            announcement,
            domain: Arc::clone(domain),
            sending: Arc::new(sending),
            must_block,
        })
    }
}

impl Sending {
    fn put(&self, number: i64, source_time_ns: i64, cdr: Bytes) -> Result<(), WriteError> {
        let attachment = Attachment { sequence_number: number, source_time_ns, gid: self.gid.0 };
        let put = self.publisher.put(cdr).attachment(attachment.to_bytes().as_slice());
        put.wait().map_err(|error| WriteError::Engine(error.to_string()))
    }
}

impl Writer for ZenohWriter {
    fn gid(&self) -> Gid {
        self.announcement.gid
    }

    fn matched(&self) -> usize {
        // A token may come before the way to its subscription is known.
        let status = self.sending.publisher.matching_status().wait();
        if status.is_ok_and(|status| status.matching()) { self.readers() } else { 0 }
    }

    fn readers(&self) -> usize {
        self.readers.count()
    }

    fn reader_counter(&self) -> ReaderCounter {
        let readers = self.readers.clone();
        Box::new(move || readers.count())
    }

    fn matched_readers(&self) -> Vec<Gid> {
        self.domain.graph.matched(self.announcement.gid)
    }

    fn on_match(&self, handler: MatchHandler) {
        self.domain.graph.on_match(self.announcement.gid, handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.domain.graph.on_event(self.announcement.gid, handler);
    }

    fn write_with(&self, cdr: Bytes, _options: WriteOptions) -> Result<i64, WriteError> {
        if !is_cdr(&cdr) {
            return Err(WriteError::Encapsulation { found: cdr[..cdr.len().min(4)].to_vec() });
        }
        let mut last = self.sending.last.lock();
        let (number, now) = (*last + 1, now_ns());
        if self.must_block {
            let sending = Arc::clone(&self.sending);
            self.domain.outbox.send(cdr.len(), move || {
                if let Err(error) = sending.put(number, now, cdr) {
                    tracing::debug!(%error, "a sample was not sent");
                }
            })?;
        } else {
            self.sending.put(number, now, cdr)?;
        }
        *last = number;
        Ok(number)
    }

    fn flush(&self, timeout: Duration) -> bool {
        self.domain.outbox.flush(timeout)
    }
}

pub(super) struct ZenohReader {
    announcement: Announcement,
    domain: Arc<Domain>,
    receiving: Arc<Receiving>,
    _subscriber: AdvancedSubscriber<()>,
}

/// What receives for a reader.
struct Receiving {
    domain: Weak<Domain>,
    topic: String,
    gid: Gid,
    /// Whether writers keep what they sent, so that it can be asked for.
    is_kept: bool,
    /// Held over the handler, so that samples of one writer stay in order.
    state: Mutex<Received>,
}

struct Received {
    on_sample: Option<SampleHandler>,
    /// The last sample of each writer, where samples are not kept.
    numbers: HashMap<Gid, i64>,
    order: Order,
}

impl Receiving {
    /// Takes a sample as it comes, or the answer to a question.
    fn take(self: &Arc<Self>, received: &ZenohSample) {
        let Some(domain) = self.domain.upgrade() else { return };
        let sample = match sample(received) {
            Ok(sample) => sample,
            Err(reason) => return domain.skipped.count(&self.topic, reason),
        };
        let mut state = self.state.lock();
        let (writer, number) = (sample.writer, sample.sequence_number);
        if let (true, Some(source)) = (self.is_kept, received.source_info()) {
            let taken = state.order.take(sample);
            let is_gap = taken.is_gap;
            self.deliver(&domain, &mut state, writer, taken);
            drop(state);
            if is_gap {
                let (key, id) = (received.key_expr(), source.source_id());
                let answers = format!("{key}/@adv/*/{}/{}/**", id.zid(), id.eid());
                let of = Arc::downgrade(self);
                domain.repairs.ask(Gap::new(of, writer, answers, number, source.source_sn()));
            }
        } else {
            let lost = lost(&mut state.numbers, &sample).unwrap_or(0);
            self.deliver(&domain, &mut state, writer, Taken { ready: vec![sample], lost, is_gap: false });
        }
    }

    fn deliver(&self, domain: &Domain, state: &mut Received, writer: Gid, taken: Taken) {
        if taken.lost > 0 {
            let event = EndpointEvent::MessagesLost { peer: writer, count: taken.lost };
            domain.graph.happened(self.gid, event);
        }
        if let Some(on_sample) = state.on_sample.as_mut() {
            taken.ready.into_iter().for_each(on_sample);
        }
    }
}

impl Incomplete for Receiving {
    fn session(&self) -> Option<Session> {
        self.domain.upgrade().map(|domain| domain.session.clone())
    }

    fn last_before_gap(&self, writer: Gid) -> Option<i64> {
        self.state.lock().order.last_before_gap(writer)
    }

    fn take_answer(self: Arc<Self>, sample: &ZenohSample) {
        self.take(sample);
    }

    fn give_up(&self, writer: Gid) {
        let Some(domain) = self.domain.upgrade() else { return };
        let mut state = self.state.lock();
        let taken = state.order.give_up(writer);
        self.deliver(&domain, &mut state, writer, taken);
    }
}

impl ZenohReader {
    pub(super) fn new(
        domain: &Arc<Domain>,
        endpoint: &Endpoint,
        on_sample: SampleHandler,
    ) -> Result<Self, MiddlewareError> {
        let refused = |error: &Error| refused("reader", endpoint, error.to_string());
        let token = of_topic(endpoint, Role::Subscription).ok_or_else(|| no_topic("reader", endpoint))?;
        let EndpointToken { name, type_name, hash, .. } = &token;
        let key = match hash {
            Some(hash) => key(domain.domain_id, name, type_name, Some(hash)),
            None => keys_of_any_hash(domain.domain_id, name, type_name),
        };
        let topic = name.clone();
        let described = domain.describe(endpoint.node.as_ref(), token);
        let is_latched = endpoint.qos.durability == Durability::TransientLocal;
        let is_kept = is_latched && endpoint.qos.reliability == Reliability::Reliable;
        let receiving = Arc::new(Receiving {
            domain: Arc::downgrade(domain),
            topic,
            gid: described.gid,
            is_kept,
            state: Mutex::new(Received {
                on_sample: Some(on_sample),
                numbers: HashMap::new(),
                order: Order::new(kept(endpoint.qos.history)),
            }),
        });
        let take = {
            let receiving = Arc::clone(&receiving);
            move |received: ZenohSample| receiving.take(&received)
        };
        let mut subscriber = domain.session.declare_subscriber(key).callback(take).advanced();
        if is_latched {
            let history = HistoryConfig::default().detect_late_publishers();
            subscriber = subscriber
                .history(history.max_samples(kept(endpoint.qos.history)))
                .subscriber_detection()
                .query_timeout(Duration::from_millis(u64::MAX));
            if is_kept {
                subscriber = subscriber.recovery(RecoveryConfig::default().heartbeat());
            }
        }
        let subscriber = subscriber.wait().map_err(|error| refused(&error))?;
        let announcement = domain.announce(described, refused)?;
        Ok(Self { announcement, domain: Arc::clone(domain), receiving, _subscriber: subscriber })
    }
}

impl Reader for ZenohReader {
    fn gid(&self) -> Gid {
        self.announcement.gid
    }

    fn matched(&self) -> usize {
        self.domain.graph.match_count(self.announcement.gid).load(Ordering::Relaxed)
    }

    fn matched_writers(&self) -> Vec<Gid> {
        self.domain.graph.matched(self.announcement.gid)
    }

    fn on_match(&self, handler: MatchHandler) {
        self.domain.graph.on_match(self.announcement.gid, handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.domain.graph.on_event(self.announcement.gid, handler);
    }
}

impl Drop for ZenohReader {
    fn drop(&mut self) {
        self.receiving.state.lock().on_sample = None;
    }
}

/// What a peer sent, if it is a sample of ROS 2.
fn sample(received: &ZenohSample) -> Result<Sample, &'static str> {
    if received.kind() != SampleKind::Put {
        return Err("it deletes a key");
    }
    let attachment = received.attachment().ok_or("it has no attachment")?;
    let attachment =
        Attachment::parse(&attachment.to_bytes()).ok_or("its attachment is not that of ROS 2")?;
    let cdr = payload(received.payload())?;
    Ok(Sample {
        cdr,
        source_time_ns: Some(attachment.source_time_ns),
        writer: Gid(attachment.gid),
        sequence_number: attachment.sequence_number,
        related: None,
    })
}

/// Copies a payload out of the memory of the link, if it is one of ROS 2.
pub(super) fn payload(received: &ZBytes) -> Result<Bytes, &'static str> {
    let cdr = match received.to_bytes() {
        Cow::Borrowed(bytes) => Bytes::copy_from_slice(bytes),
        // Put together from fragments, which was the copy.
        Cow::Owned(bytes) => Bytes::from(bytes),
    };
    if is_cdr(&cdr) { Ok(cdr) } else { Err("its payload is no CDR") }
}

/// The number of samples of the same writer that are missing before this one.
fn lost(numbers: &mut HashMap<Gid, i64>, sample: &Sample) -> Option<u64> {
    if numbers.len() >= MOST_WRITERS && !numbers.contains_key(&sample.writer) {
        numbers.clear();
    }
    let last = numbers.insert(sample.writer, sample.sequence_number)?;
    let missing = sample.sequence_number.checked_sub(last)?.checked_sub(1)?;
    u64::try_from(missing).ok().filter(|missing| *missing > 0)
}

/// The number of samples for late subscriptions.
fn kept(history: History) -> usize {
    let depth = match history {
        History::KeepLast(depth) => depth.max(1),
        History::KeepAll => MOST_KEPT,
    };
    usize::try_from(depth).unwrap_or(usize::MAX)
}

fn refused(kind: &'static str, endpoint: &Endpoint, reason: String) -> MiddlewareError {
    let (topic_name, type_name) = (endpoint.topic_name.clone(), endpoint.type_name.clone());
    MiddlewareError::Endpoint { endpoint: kind, topic_name, type_name, reason }
}

fn no_topic(kind: &'static str, endpoint: &Endpoint) -> MiddlewareError {
    refused(kind, endpoint, "on Zenoh only topics of ROS 2 have writers and readers".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gaps_in_the_numbers_of_a_writer_are_counted() {
        let mut numbers = HashMap::new();
        let of = |writer, sequence_number| Sample {
            cdr: Bytes::new(),
            source_time_ns: None,
            writer: Gid([writer; 16]),
            sequence_number,
            related: None,
        };
        let mut lost = |writer, number| super::lost(&mut numbers, &of(writer, number));
        assert_eq!(lost(1, 7), None, "what was before it came is not lost");
        assert_eq!([lost(1, 8), lost(2, 1), lost(1, 11)], [None, None, Some(2)]);
        assert_eq!([lost(1, 9), lost(1, i64::MIN), lost(1, i64::MAX)], [None; 3]);
    }
}
