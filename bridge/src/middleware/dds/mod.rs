//! The engine for DDS: rustdds, which speaks RTPS over UDP.
//!
//! One participant has the threads of rustdds (discovery and event loop) and one more that serves all readers.
//! Whatever rustdds panics at stays behind this boundary: it becomes an error, or ends one reader with a message.
//!
//! rustdds says much at ERROR about lost and repaired packets that is no error. It logs through the `log` crate under
//! the target [`LOG_TARGET`]; programs set that to `off` unless asked otherwise.

mod engine_threads;
mod farewell;
mod first_fragment;
mod matches;
mod payload;
mod qos;
mod reader_thread;
mod returned;
mod rtps;
mod static_peers;
mod writer;

use super::rejoining::TroubleSink;
use super::{
    Direction, DiscoveryRange, Endpoint, EventHandler, Gid, MatchHandler, Middleware, MiddlewareError,
    ParticipantOptions, Reader, RemoteEndpoint, SampleHandler, Writer,
};
use downbeat_msgs::qos::Durability;
use engine_threads::EngineThreads;
use farewell::Farewell;
use first_fragment::FirstFragments;
use matches::{MatchedCount, Matches};
use payload::{OutgoingBody, ReceiveAny, ReceivedCdr, SendLittleEndian};
use reader_thread::{DdsDataReader, ReaderThread};
use returned::ReturnWatch;
use rustdds::{DomainParticipant, DomainParticipantBuilder, QosPolicies, RTPSEntity, TopicKind};
use static_peers::{Listening, StaticPeers};
use std::net::Ipv4Addr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The target under which rustdds logs.
pub const LOG_TARGET: &str = "rustdds";

/// When rustdds has surely answered a participant that was found.
const ANSWERED: Duration = Duration::from_millis(100);

/// How long a participant that joins looks for others before it has endpoints; more by [`ANSWERED`] when it finds some.
const FIRST_LOOK: Duration = Duration::from_millis(100);

type SharedMatches = Arc<Mutex<Matches>>;

/// A participant of a DDS domain.
pub struct DdsParticipant {
    gid: Gid,
    // Fields drop in this order: the thread holds the readers and a strong reference to the participant.
    reader_thread: ReaderThread,
    matches: SharedMatches,
    first_fragments: Arc<FirstFragments>,
    _static_peers: Option<StaticPeers>,
    publisher: rustdds::Publisher,
    subscriber: rustdds::Subscriber,
    participant: DomainParticipant,
    // Behind all that the participant itself says.
    _farewell: Farewell,
}

impl DdsParticipant {
    /// Joins a domain.
    ///
    /// # Errors
    /// [`MiddlewareError::Join`] when no participant can be created, for example because 120 exist on this machine.
    pub fn new(options: &ParticipantOptions) -> Result<Self, MiddlewareError> {
        Self::with(options, None)
    }

    /// Joins a domain with an engine that tells when it has lost touch.
    ///
    /// # Errors
    /// As [`DdsParticipant::new`].
    pub fn watched(options: &ParticipantOptions, trouble: TroubleSink) -> Result<Self, MiddlewareError> {
        Self::with(options, Some(trouble))
    }

    fn with(options: &ParticipantOptions, trouble: Option<TroubleSink>) -> Result<Self, MiddlewareError> {
        let failed = |reason: String| MiddlewareError::Join { domain_id: options.domain_id, reason };
        let hosts = options.static_peers.clone();
        let listening = (!hosts.is_empty()).then(|| StaticPeers::start(options.domain_id, hosts));
        let listening = listening.transpose().map_err(|error| failed(error.to_string()))?;
        let ((participant, publisher, subscriber), threads) = guarded("joining the domain", || {
            let mut builder = DomainParticipantBuilder::new(options.domain_id);
            if options.discovery_range == DiscoveryRange::Localhost {
                builder = builder.with_only_networks([Ipv4Addr::LOCALHOST]);
            }
            let build = || builder.build().map_err(|error| failed(error.to_string()));
            let (participant, threads) = EngineThreads::started_by(build)?;
            let unset = QosPolicies::default();
            let publisher =
                participant.create_publisher(&unset).map_err(|error| failed(error.to_string()))?;
            let subscriber =
                participant.create_subscriber(&unset).map_err(|error| failed(error.to_string()))?;
            Ok(((participant, publisher, subscriber), threads))
        })?;
        let gid = matches::gid(participant.guid());
        let watch = trouble.map(|sink| ReturnWatch::new(options.domain_id, sink));
        let matches = Arc::new(Mutex::new(Matches::new(gid, watch)));
        let listener = participant.status_listener();
        let reader_thread = ReaderThread::start(gid, listener, Arc::clone(&matches), threads)?;
        let announce = |listening: Listening| listening.announce(gid.participant());
        let static_peers = listening.map(announce).transpose().map_err(|error| failed(error.to_string()))?;
        let farewell = Farewell {
            participant: gid,
            domain_id: options.domain_id,
            range: options.discovery_range,
            static_peers: static_peers.as_ref().map(StaticPeers::addresses).unwrap_or_default(),
        };
        let first_fragments = FirstFragments::new().map_err(|error| failed(error.to_string()))?;
        let first_fragments = Arc::new(first_fragments);
        let joined = Self {
            gid,
            reader_thread,
            matches,
            first_fragments,
            _static_peers: static_peers,
            publisher,
            subscriber,
            participant,
            _farewell: farewell,
        };
        joined.look_around();
        Ok(joined)
    }

    /// Waits until those who are there have surely found this participant.
    ///
    /// They are then told of its endpoints one by one and in order. Were endpoints created meanwhile, the first would come
    /// again behind later ones, and Fast DDS 2.14 forgets some when two participants do that at once: it keeps what
    /// comes out of order sorted by source timestamps (`ReaderHistory::add_change`), of which rustdds sends none with
    /// announcements. Such an endpoint would stay unknown to that peer for ever.
    fn look_around(&self) {
        std::thread::sleep(FIRST_LOOK);
        self.wait_until_all_are_answered();
    }

    fn wait_until_all_are_answered(&self) {
        let last_participant = lock(&self.matches).last_participant();
        let answering = last_participant.and_then(|found| ANSWERED.checked_sub(found.elapsed()));
        if let Some(rest) = answering {
            std::thread::sleep(rest);
        }
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
        lock(&self.matches).watch(local, direction, endpoint.qos.liveliness)
    }
}

impl Middleware for DdsParticipant {
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
        lock(&self.matches).remote_endpoints()
    }
}

impl Drop for DdsParticipant {
    fn drop(&mut self) {
        // 10 ms after a participant was found the discovery thread of rustdds 0.15 holds a strong reference for a moment,
        // to answer it. Were ours dropped in that moment, that thread would drop the participant, fail to join itself,
        // and never tell the others that we leave.
        self.wait_until_all_are_answered();
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
        lock(&self.matches).peers(self.gid)
    }

    fn on_match(&self, handler: MatchHandler) {
        lock(&self.matches).on_change(self.gid, handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.link.listen(self.gid, handler);
    }
}

impl Drop for DdsReader {
    fn drop(&mut self) {
        lock(&self.matches).forget(self.gid);
    }
}

/// rustdds keeps the samples of a topic after its last reader is gone, and would give them to the next.
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

fn lock(matches: &SharedMatches) -> std::sync::MutexGuard<'_, Matches> {
    matches.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests;
