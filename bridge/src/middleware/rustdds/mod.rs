//! The engine for DDS: rustdds, which speaks RTPS over UDP.
//!
//! One participant has the threads of rustdds (discovery and event loop) and one more that serves all
//! readers. Whatever rustdds panics at stays behind this boundary: it becomes an error, or ends one reader
//! with a message.
//!
//! rustdds says much at ERROR about lost and repaired packets that is no error. It logs through the `log`
//! crate under the target [`LOG_TARGET`]; programs set that to `off` unless asked otherwise.

mod matches;
mod payload;
mod qos;
mod reader_thread;
mod writer;

use super::{
    Direction, DiscoveryRange, Endpoint, EventHandler, Gid, MatchHandler, Middleware, MiddlewareError,
    ParticipantOptions, Reader, RemoteEndpoint, SampleHandler, Writer,
};
use downbeat_msgs::qos::Durability;
use matches::{MatchedCount, Matches};
use parking_lot::Mutex;
use payload::{OutgoingBody, ReceiveAny, ReceivedCdr, SendLittleEndian};
use reader_thread::{DdsDataReader, ReaderThread};
use rustdds::{DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity, TopicKind};
use std::net::Ipv4Addr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::Ordering;

/// The target under which rustdds logs.
pub const LOG_TARGET: &str = "rustdds";

type SharedMatches = Arc<Mutex<Matches>>;

/// A participant of a DDS domain.
pub struct RustddsParticipant {
    gid: Gid,
    // Fields drop in this order: the thread holds the readers and a strong reference to the participant.
    reader_thread: ReaderThread,
    matches: SharedMatches,
    publisher: rustdds::Publisher,
    subscriber: rustdds::Subscriber,
    participant: DomainParticipant,
}

impl RustddsParticipant {
    /// Joins a domain.
    ///
    /// # Errors
    /// [`MiddlewareError::Join`] if no participant can be created, for example because 120 exist on this
    /// machine.
    pub fn new(options: &ParticipantOptions) -> Result<Self, MiddlewareError> {
        let failed = |reason: String| MiddlewareError::Join { domain_id: options.domain_id, reason };
        let (participant, publisher, subscriber) = guarded("joining the domain", || {
            let mut builder = DomainParticipantBuilder::new(options.domain_id);
            if options.discovery_range == DiscoveryRange::Localhost {
                builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
            }
            let participant = builder.build().map_err(|error| failed(error.to_string()))?;
            let unset = QosPolicies::default();
            let publisher =
                participant.create_publisher(&unset).map_err(|error| failed(error.to_string()))?;
            let subscriber =
                participant.create_subscriber(&unset).map_err(|error| failed(error.to_string()))?;
            Ok((participant, publisher, subscriber))
        })?;
        let gid = matches::gid(participant.guid());
        let matches = Arc::new(Mutex::new(Matches::new(gid)));
        let listener = participant.status_listener();
        let reader_thread = ReaderThread::start(listener, Arc::clone(&matches))?;
        Ok(Self { gid, reader_thread, matches, publisher, subscriber, participant })
    }

    fn topic(
        &self,
        endpoint: &Endpoint,
        qos: &QosPolicies,
    ) -> Result<rustdds::Topic, rustdds::dds::CreateError> {
        let Endpoint { topic_name, type_name, .. } = endpoint;
        self.participant.create_topic(topic_name.clone(), type_name.clone(), qos, TopicKind::NoKey)
    }

    fn watch(&self, local: Gid, direction: Direction, endpoint: &Endpoint) -> MatchedCount {
        self.matches.lock().watch(local, direction, endpoint.qos.liveliness)
    }
}

impl Middleware for RustddsParticipant {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn create_writer(&self, endpoint: &Endpoint) -> Result<Box<dyn Writer>, MiddlewareError> {
        let qos = qos::policies(endpoint, Direction::Out)?;
        let writer = guarded("creating a writer", || {
            let created = self.topic(endpoint, &qos).and_then(|topic| {
                self.publisher.create_datawriter_no_key::<OutgoingBody, SendLittleEndian>(&topic, Some(qos))
            });
            created.map_err(|error| refused("writer", endpoint, &error))
        })?;
        Ok(Box::new(writer::DdsWriter::new(writer, self, endpoint)))
    }

    fn create_reader(
        &self,
        endpoint: &Endpoint,
        on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError> {
        let qos = qos::policies(endpoint, Direction::In)?;
        let reader = guarded("creating a reader", || {
            let created = self.topic(endpoint, &qos).and_then(|topic| {
                self.subscriber.create_simple_datareader_no_key::<ReceivedCdr, ReceiveAny>(&topic, Some(qos))
            });
            let reader = created.map_err(|error| refused("reader", endpoint, &error))?;
            if endpoint.qos.durability == Durability::Volatile {
                discard_what_an_earlier_reader_left(&reader);
            }
            Ok(reader)
        })?;
        let gid = matches::gid(reader.guid());
        let matched = self.watch(gid, Direction::In, endpoint);
        let slot = self.reader_thread.add(reader, endpoint.topic_name.clone(), on_sample);
        let (matches, link) = (Arc::clone(&self.matches), self.reader_thread.link());
        Ok(Box::new(DdsReader { gid, matched, matches, link, _slot: slot }))
    }

    fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        self.matches.lock().remote_endpoints()
    }
}

struct DdsReader {
    gid: Gid,
    matched: MatchedCount,
    matches: SharedMatches,
    link: reader_thread::Link,
    _slot: reader_thread::Slot,
}

impl Reader for DdsReader {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn matched(&self) -> usize {
        self.matched.load(Ordering::Acquire)
    }

    fn matched_writers(&self) -> Vec<Gid> {
        self.matches.lock().peers(self.gid)
    }

    fn on_match(&self, handler: MatchHandler) {
        self.matches.lock().on_change(self.gid, handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.link.listen(self.gid, handler);
    }
}

impl Drop for DdsReader {
    fn drop(&mut self) {
        self.matches.lock().forget(self.gid);
    }
}

/// rustdds keeps the samples of a topic after its last reader was dropped, and would deliver them to the
/// next.
fn discard_what_an_earlier_reader_left(reader: &DdsDataReader) {
    // Bounded by what a topic can hold; a sample that cannot be read counts as taken.
    for _ in 0..qos::KEEP_ALL_SAMPLES {
        if let Ok(None) = reader.try_take_one() {
            return;
        }
    }
}

fn refused(kind: &'static str, endpoint: &Endpoint, error: &rustdds::dds::CreateError) -> MiddlewareError {
    MiddlewareError::Endpoint {
        endpoint: kind,
        topic_name: endpoint.topic_name.clone(),
        type_name: endpoint.type_name.clone(),
        reason: error.to_string(),
    }
}

/// Keeps a panic of the engine from crossing into the program.
fn guarded<T>(
    doing: &'static str,
    action: impl FnOnce() -> Result<T, MiddlewareError>,
) -> Result<T, MiddlewareError> {
    catch_unwind(AssertUnwindSafe(action)).unwrap_or(Err(MiddlewareError::Panicked { doing }))
}
