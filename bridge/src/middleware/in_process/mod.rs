//! An engine without a network: participants of one [`Hub`] hear each other, nobody else does.
//!
//! It stands in for DDS in tests that are not about DDS, and is what `ROS_AUTOMATIC_DISCOVERY_RANGE=OFF` gets. It
//! delivers on the thread that writes, loses nothing, and matches by reliability and durability.

use super::{
    Direction, Endpoint, Gid, MatchHandler, Middleware, MiddlewareError, Reader, RemoteEndpoint, Sample,
    SampleHandler, WriteError, WriteOptions, Writer,
};
use bytes::Bytes;
use downbeat_msgs::qos::{Durability, History, Reliability};
use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// What participants in memory have instead of a network.
#[derive(Clone, Default)]
pub struct Hub {
    state: Arc<Mutex<State>>,
}

impl Hub {
    /// A hub that nobody has joined.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A new participant.
    #[must_use]
    pub fn join(&self) -> InProcessParticipant {
        let mut state = lock(&self.state);
        state.participants += 1;
        let mut gid = [0; 16];
        gid[..8].copy_from_slice(b"downbeat");
        gid[8..12].copy_from_slice(&state.participants.to_be_bytes());
        InProcessParticipant { gid: Gid(gid), hub: self.clone() }
    }
}

/// A participant of a [`Hub`].
pub struct InProcessParticipant {
    gid: Gid,
    hub: Hub,
}

impl Middleware for InProcessParticipant {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn create_writer(&self, endpoint: &Endpoint) -> Result<Box<dyn Writer>, MiddlewareError> {
        let mut state = lock(&self.hub.state);
        let gid = state.next_gid(self.gid);
        let history = Arc::new(Mutex::new(WriterHistory::default()));
        let on_match = SharedMatchHandler::default();
        let writer = HubWriter {
            endpoint: endpoint.clone(),
            history: Arc::clone(&history),
            on_match: Arc::clone(&on_match),
        };
        let changed = state.readers_of((&gid, endpoint));
        state.writers.insert(gid, writer);
        drop(state);
        tell(changed);
        Ok(Box::new(InProcessWriter {
            gid,
            hub: self.hub.clone(),
            endpoint: endpoint.clone(),
            history,
            on_match,
        }))
    }

    fn create_reader(
        &self,
        endpoint: &Endpoint,
        mut on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError> {
        let mut state = lock(&self.hub.state);
        let gid = state.next_gid(self.gid);
        if endpoint.qos.durability == Durability::TransientLocal {
            let writers = state.writers.iter();
            for (_, writer) in
                writers.filter(|(from, writer)| is_match((from, &writer.endpoint), (&gid, endpoint)))
            {
                lock(&writer.history).samples.iter().for_each(|sample| on_sample(sample.clone()));
            }
        }
        let handler = Arc::new(Mutex::new(Some(on_sample)));
        let on_match = SharedMatchHandler::default();
        let reader = HubReader {
            endpoint: endpoint.clone(),
            handler: Arc::clone(&handler),
            on_match: Arc::clone(&on_match),
        };
        let changed = state.writers_to((&gid, endpoint));
        state.readers.insert(gid, reader);
        drop(state);
        tell(changed);
        Ok(Box::new(InProcessReader {
            gid,
            hub: self.hub.clone(),
            endpoint: endpoint.clone(),
            handler,
            on_match,
        }))
    }

    fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        let state = lock(&self.hub.state);
        let writers = state.writers.iter().map(|(gid, writer)| (*gid, &writer.endpoint, Direction::Out));
        let readers = state.readers.iter().map(|(gid, reader)| (*gid, &reader.endpoint, Direction::In));
        writers
            .chain(readers)
            .filter(|(gid, ..)| gid.participant() != self.gid.participant())
            .map(|(gid, endpoint, direction)| RemoteEndpoint {
                gid,
                direction,
                topic_name: endpoint.topic_name.clone(),
                type_name: endpoint.type_name.clone(),
                reliability: endpoint.qos.reliability,
                durability: endpoint.qos.durability,
                deadline: endpoint.qos.deadline,
                liveliness: endpoint.qos.liveliness,
                liveliness_lease_duration: endpoint.qos.liveliness_lease_duration,
                type_hash: None,
            })
            .collect()
    }
}

#[derive(Default)]
struct State {
    participants: u32,
    endpoints: u32,
    writers: BTreeMap<Gid, HubWriter>,
    readers: BTreeMap<Gid, HubReader>,
}

impl State {
    fn next_gid(&mut self, participant: Gid) -> Gid {
        self.endpoints += 1;
        let mut gid = participant;
        gid.0[12..].copy_from_slice(&self.endpoints.to_be_bytes());
        gid
    }

    fn readers_of(&self, writer: (&Gid, &Endpoint)) -> Vec<SharedMatchHandler> {
        let matching = self.readers.iter().filter(|(to, reader)| is_match(writer, (to, &reader.endpoint)));
        matching.map(|(_, reader)| Arc::clone(&reader.on_match)).collect()
    }

    fn writers_to(&self, reader: (&Gid, &Endpoint)) -> Vec<SharedMatchHandler> {
        let matching =
            self.writers.iter().filter(|(from, writer)| is_match((from, &writer.endpoint), reader));
        matching.map(|(_, writer)| Arc::clone(&writer.on_match)).collect()
    }
}

struct HubWriter {
    endpoint: Endpoint,
    history: Arc<Mutex<WriterHistory>>,
    on_match: SharedMatchHandler,
}

struct HubReader {
    endpoint: Endpoint,
    handler: SharedHandler,
    on_match: SharedMatchHandler,
}

type SharedMatchHandler = Arc<Mutex<Option<Arc<MatchHandler>>>>;

/// Empty once the reader is dropped.
type SharedHandler = Arc<Mutex<Option<SampleHandler>>>;

#[derive(Default)]
struct WriterHistory {
    last_sequence_number: i64,
    /// For late readers, where the writer is transient local.
    samples: VecDeque<Sample>,
}

struct InProcessWriter {
    gid: Gid,
    hub: Hub,
    endpoint: Endpoint,
    history: Arc<Mutex<WriterHistory>>,
    on_match: SharedMatchHandler,
}

impl InProcessWriter {
    fn is_match(&self, to: &Gid, reader: &HubReader) -> bool {
        is_match((&self.gid, &self.endpoint), (to, &reader.endpoint))
    }
}

impl Writer for InProcessWriter {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn matched(&self) -> usize {
        self.matched_readers().len()
    }

    fn matched_readers(&self) -> Vec<Gid> {
        let state = lock(&self.hub.state);
        state.readers.iter().filter(|(to, reader)| self.is_match(to, reader)).map(|(to, _)| *to).collect()
    }

    fn on_match(&self, handler: MatchHandler) {
        *lock(&self.on_match) = Some(Arc::new(handler));
    }

    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError> {
        if !cdr.starts_with(&[0x00, 0x01, 0x00, 0x00]) {
            return Err(WriteError::Encapsulation { found: cdr[..cdr.len().min(4)].to_vec() });
        }
        let handlers: Vec<SharedHandler> = {
            let state = lock(&self.hub.state);
            let is_meant = |to: &Gid| options.only_to.is_none_or(|only| only == *to);
            let matching =
                state.readers.iter().filter(|(to, reader)| is_meant(to) && self.is_match(to, reader));
            matching.map(|(_, reader)| Arc::clone(&reader.handler)).collect()
        };
        // Held while the handlers run, so that samples of one writer stay in order.
        let mut history = lock(&self.history);
        history.last_sequence_number += 1;
        let sample = Sample {
            cdr,
            source_time_ns: now_ns(),
            writer: self.gid,
            sequence_number: history.last_sequence_number,
            related: options.related,
        };
        for handler in handlers {
            if let Some(on_sample) = lock(&handler).as_mut() {
                on_sample(sample.clone());
            }
        }
        if self.endpoint.qos.durability == Durability::TransientLocal {
            history.samples.push_back(sample);
            if let History::KeepLast(depth) = self.endpoint.qos.history
                && history.samples.len() > depth as usize
            {
                history.samples.pop_front();
            }
        }
        Ok(history.last_sequence_number)
    }

    fn flush(&self, _timeout: Duration) -> bool {
        true
    }
}

impl Drop for InProcessWriter {
    fn drop(&mut self) {
        let mut state = lock(&self.hub.state);
        state.writers.remove(&self.gid);
        let changed = state.readers_of((&self.gid, &self.endpoint));
        drop(state);
        tell(changed);
    }
}

struct InProcessReader {
    gid: Gid,
    hub: Hub,
    endpoint: Endpoint,
    handler: SharedHandler,
    on_match: SharedMatchHandler,
}

impl Reader for InProcessReader {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn matched(&self) -> usize {
        self.matched_writers().len()
    }

    fn matched_writers(&self) -> Vec<Gid> {
        let state = lock(&self.hub.state);
        let to = (&self.gid, &self.endpoint);
        let matching = state.writers.iter().filter(|(from, writer)| is_match((from, &writer.endpoint), to));
        matching.map(|(from, _)| *from).collect()
    }

    fn on_match(&self, handler: MatchHandler) {
        *lock(&self.on_match) = Some(Arc::new(handler));
    }
}

impl Drop for InProcessReader {
    fn drop(&mut self) {
        let mut state = lock(&self.hub.state);
        state.readers.remove(&self.gid);
        let changed = state.writers_to((&self.gid, &self.endpoint));
        drop(state);
        tell(changed);
        lock(&self.handler).take();
    }
}

/// Whether the two belong to different participants, and what the writer offers suffices for the reader.
fn is_match((writer_gid, writer): (&Gid, &Endpoint), (reader_gid, reader): (&Gid, &Endpoint)) -> bool {
    let (offered, requested) = (&writer.qos, &reader.qos);
    writer_gid.participant() != reader_gid.participant()
        && writer.topic_name == reader.topic_name
        && writer.type_name == reader.type_name
        && (offered.reliability == Reliability::Reliable || requested.reliability == Reliability::BestEffort)
        && (offered.durability == Durability::TransientLocal || requested.durability == Durability::Volatile)
}

/// Calls the handlers of endpoints whose matches have changed; not under the lock, since they ask who is matched.
fn tell(changed: Vec<SharedMatchHandler>) {
    for on_match in changed {
        let handler = lock(&on_match).clone();
        if let Some(handler) = handler {
            handler();
        }
    }
}

fn now_ns() -> Option<i64> {
    SystemTime::now().duration_since(UNIX_EPOCH).ok().and_then(|time| i64::try_from(time.as_nanos()).ok())
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
