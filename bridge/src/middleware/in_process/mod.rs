//! An engine without a network: participants of one [`Hub`] communicate only with each other.
//!
//! It replaces DDS in tests that are not about DDS. It delivers on the writing thread, loses nothing, matches
//! by the same policies as DDS, and measures no times: no deadline is missed, and no sample expires.

mod state;

use super::rtps::is_cdr;
use super::{
    Direction, Endpoint, EventHandler, Gid, MatchHandler, Middleware, MiddlewareError, Reader, ReaderCounter,
    RemoteEndpoint, SampleHandler, WriteError, WriteOptions, Writer,
};
use bytes::Bytes;
use downbeat_msgs::qos::Durability;
use parking_lot::Mutex;
use state::{Handlers, HubReader, HubWriter, SharedHandler, State, WriterHistory, deliver};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::time::{Duration, SystemTime, UNIX_EPOCH};

/// The network of participants in memory.
#[derive(Clone, Default)]
pub struct Hub {
    state: Arc<Mutex<State>>,
}

impl Hub {
    /// A hub without participants.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// A new participant.
    #[must_use]
    pub fn join(&self) -> InProcessParticipant {
        let mut state = self.state.lock();
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
        let mut state = self.hub.state.lock();
        let gid = state.next_gid(self.gid);
        let (history, handlers) = (Arc::<Mutex<WriterHistory>>::default(), Handlers::default());
        let writer = HubWriter {
            endpoint: endpoint.clone(),
            history: Arc::clone(&history),
            handlers: handlers.clone(),
        };
        let news = state.add_writer(gid, writer);
        drop(state);
        deliver(news);
        let (hub, endpoint) = (self.hub.clone(), endpoint.clone());
        Ok(Box::new(InProcessWriter { gid, hub, endpoint, history, handlers }))
    }

    fn create_reader(
        &self,
        endpoint: &Endpoint,
        mut on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError> {
        let mut state = self.hub.state.lock();
        let gid = state.next_gid(self.gid);
        if endpoint.qos.durability == Durability::TransientLocal {
            for (_, writer) in state.writers_to(endpoint) {
                writer.history.lock().samples.iter().for_each(|sample| on_sample(sample.clone()));
            }
        }
        let (on_sample, handlers) = (Arc::new(Mutex::new(Some(on_sample))), Handlers::default());
        let reader = HubReader {
            endpoint: endpoint.clone(),
            on_sample: Arc::clone(&on_sample),
            handlers: handlers.clone(),
        };
        let news = state.add_reader(gid, reader);
        drop(state);
        deliver(news);
        let (hub, endpoint) = (self.hub.clone(), endpoint.clone());
        Ok(Box::new(InProcessReader { gid, hub, endpoint, on_sample, handlers }))
    }

    fn remote_participants(&self) -> Option<Vec<[u8; 12]>> {
        let state = self.hub.state.lock();
        let gids = state.writers.keys().chain(state.readers.keys());
        let others: BTreeSet<_> =
            gids.map(|gid| gid.participant()).filter(|other| *other != self.gid.participant()).collect();
        Some(others.into_iter().collect())
    }

    fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        let state = self.hub.state.lock();
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
                lifespan: endpoint.qos.lifespan,
                liveliness: endpoint.qos.liveliness,
                liveliness_lease_duration: endpoint.qos.liveliness_lease_duration,
                type_hash: endpoint.type_hash.clone(),
                node: None,
            })
            .collect()
    }
}

struct InProcessWriter {
    gid: Gid,
    hub: Hub,
    endpoint: Endpoint,
    history: Arc<Mutex<WriterHistory>>,
    handlers: Handlers,
}

impl Writer for InProcessWriter {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn matched(&self) -> usize {
        self.matched_readers().len()
    }

    fn reader_counter(&self) -> ReaderCounter {
        let (hub, endpoint) = (self.hub.clone(), self.endpoint.clone());
        Box::new(move || hub.state.lock().readers_of(&endpoint).count())
    }

    fn matched_readers(&self) -> Vec<Gid> {
        self.hub.state.lock().readers_of(&self.endpoint).map(|(to, _)| to).collect()
    }

    fn on_match(&self, handler: MatchHandler) {
        *self.handlers.on_match.lock() = Some(Arc::new(handler));
    }

    fn on_event(&self, handler: EventHandler) {
        let handler = Arc::new(handler);
        let state = self.hub.state.lock();
        let events = state.events_of_writer(&self.endpoint);
        *self.handlers.on_event.lock() = Some(Arc::clone(&handler));
        drop(state);
        events.iter().for_each(|event| handler(event));
    }

    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError> {
        if !is_cdr(&cdr) {
            return Err(WriteError::Encapsulation { found: cdr[..cdr.len().min(4)].to_vec() });
        }
        let handlers: Vec<SharedHandler> = {
            let state = self.hub.state.lock();
            let is_meant = |to: &Gid| options.only_to.is_none_or(|only| only == *to);
            let readers = state.readers_of(&self.endpoint).filter(|(to, _)| is_meant(to));
            readers.map(|(_, reader)| Arc::clone(&reader.on_sample)).collect()
        };
        // Held while the handlers run, so that samples of one writer stay in order.
        let mut history = self.history.lock();
        let sample = history.next(self.gid, &self.endpoint, cdr, options);
        for handler in handlers {
            if let Some(on_sample) = handler.lock().as_mut() {
                on_sample(sample.clone());
            }
        }
        Ok(sample.sequence_number)
    }

    fn flush(&self, _timeout: Duration) -> bool {
        true
    }
}

impl Drop for InProcessWriter {
    fn drop(&mut self) {
        let news = self.hub.state.lock().remove_writer(self.gid);
        deliver(news);
    }
}

struct InProcessReader {
    gid: Gid,
    hub: Hub,
    endpoint: Endpoint,
    on_sample: SharedHandler,
    handlers: Handlers,
}

impl Reader for InProcessReader {
    fn gid(&self) -> Gid {
        self.gid
    }

    fn matched(&self) -> usize {
        self.matched_writers().len()
    }

    fn matched_writers(&self) -> Vec<Gid> {
        self.hub.state.lock().writers_to(&self.endpoint).map(|(from, _)| from).collect()
    }

    fn on_match(&self, handler: MatchHandler) {
        *self.handlers.on_match.lock() = Some(Arc::new(handler));
    }

    fn on_event(&self, handler: EventHandler) {
        let handler = Arc::new(handler);
        let state = self.hub.state.lock();
        let events = state.events_of_reader(&self.endpoint);
        *self.handlers.on_event.lock() = Some(Arc::clone(&handler));
        drop(state);
        events.iter().for_each(|event| handler(event));
    }
}

impl Drop for InProcessReader {
    fn drop(&mut self) {
        let news = self.hub.state.lock().remove_reader(self.gid);
        deliver(news);
        self.on_sample.lock().take();
    }
}

fn now_ns() -> Option<i64> {
    SystemTime::now().duration_since(UNIX_EPOCH).ok().and_then(|time| i64::try_from(time.as_nanos()).ok())
}
