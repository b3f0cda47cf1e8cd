//! The state of a hub: the endpoints of all participants, and their matches.

use super::now_ns;
use crate::middleware::{
    Endpoint, EndpointEvent, EventHandler, Gid, MatchHandler, QosPolicyKind, Sample, SampleHandler,
    WriteOptions,
};
use bytes::Bytes;
use downbeat_msgs::qos::{Durability, History};
use parking_lot::Mutex;
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

#[derive(Default)]
pub(super) struct State {
    pub(super) participants: u32,
    endpoints: u32,
    pub(super) writers: BTreeMap<Gid, HubWriter>,
    pub(super) readers: BTreeMap<Gid, HubReader>,
}

pub(super) struct HubWriter {
    pub(super) endpoint: Endpoint,
    pub(super) history: Arc<Mutex<WriterHistory>>,
    pub(super) handlers: Handlers,
}

pub(super) struct HubReader {
    pub(super) endpoint: Endpoint,
    pub(super) on_sample: SharedHandler,
    pub(super) handlers: Handlers,
}

/// Empty once the reader is dropped.
pub(super) type SharedHandler = Arc<Mutex<Option<SampleHandler>>>;

/// The handlers of one endpoint; clones share them.
#[derive(Clone, Default)]
pub(super) struct Handlers {
    pub(super) on_match: Arc<Mutex<Option<Arc<MatchHandler>>>>,
    pub(super) on_event: Arc<Mutex<Option<Arc<EventHandler>>>>,
}

#[derive(Default)]
pub(super) struct WriterHistory {
    pub(super) last_sequence_number: i64,
    /// For late readers, where the writer is transient local.
    pub(super) samples: VecDeque<Sample>,
}

/// Events for endpoints, which are delivered without the lock on the state, since handlers may take it.
pub(super) type News = Vec<(Handlers, EndpointEvent)>;

/// The relation of a writer and a reader of one topic.
enum Suits {
    Yes,
    No(QosPolicyKind),
    OtherType,
}

impl State {
    pub(super) fn next_gid(&mut self, participant: Gid) -> Gid {
        self.endpoints += 1;
        let mut gid = participant;
        gid.0[12..].copy_from_slice(&self.endpoints.to_be_bytes());
        gid
    }

    pub(super) fn readers_of(&self, writer: &Endpoint) -> impl Iterator<Item = (Gid, &HubReader)> {
        self.readers
            .iter()
            .map(|(to, reader)| (*to, reader))
            .filter(move |(_, reader)| matches!(suits(writer, &reader.endpoint), Some(Suits::Yes)))
    }

    pub(super) fn writers_to(&self, reader: &Endpoint) -> impl Iterator<Item = (Gid, &HubWriter)> {
        self.writers
            .iter()
            .map(|(from, writer)| (*from, writer))
            .filter(move |(_, writer)| matches!(suits(&writer.endpoint, reader), Some(Suits::Yes)))
    }

    pub(super) fn add_writer(&mut self, from: Gid, writer: HubWriter) -> News {
        let news = self.readers.values().filter_map(|reader| {
            let event = event_of(suits(&writer.endpoint, &reader.endpoint)?, from, &writer.endpoint);
            Some((reader.handlers.clone(), event))
        });
        let news = news.collect();
        self.writers.insert(from, writer);
        news
    }

    pub(super) fn add_reader(&mut self, to: Gid, reader: HubReader) -> News {
        let news = self.writers.values().filter_map(|writer| {
            let event = event_of(suits(&writer.endpoint, &reader.endpoint)?, to, &reader.endpoint);
            Some((writer.handlers.clone(), event))
        });
        let news = news.collect();
        self.readers.insert(to, reader);
        news
    }

    pub(super) fn remove_writer(&mut self, from: Gid) -> News {
        let Some(writer) = self.writers.remove(&from) else { return News::new() };
        let readers = self.readers_of(&writer.endpoint);
        let unmatched = || EndpointEvent::Unmatched { peer: from };
        readers.map(|(_, reader)| (reader.handlers.clone(), unmatched())).collect()
    }

    pub(super) fn remove_reader(&mut self, to: Gid) -> News {
        let Some(reader) = self.readers.remove(&to) else { return News::new() };
        let writers = self.writers_to(&reader.endpoint);
        let unmatched = || EndpointEvent::Unmatched { peer: to };
        writers.map(|(_, writer)| (writer.handlers.clone(), unmatched())).collect()
    }

    /// The present state of a writer, as events.
    pub(super) fn events_of_writer(&self, writer: &Endpoint) -> Vec<EndpointEvent> {
        let event = |(to, reader): (&Gid, &HubReader)| {
            Some(event_of(suits(writer, &reader.endpoint)?, *to, &reader.endpoint))
        };
        self.readers.iter().filter_map(event).collect()
    }

    /// The present state of a reader, as events.
    pub(super) fn events_of_reader(&self, reader: &Endpoint) -> Vec<EndpointEvent> {
        let event = |(from, writer): (&Gid, &HubWriter)| {
            Some(event_of(suits(&writer.endpoint, reader)?, *from, &writer.endpoint))
        };
        self.writers.iter().filter_map(event).collect()
    }
}

impl WriterHistory {
    /// The next sample of the writer, kept for late readers where there is need.
    pub(super) fn next(
        &mut self,
        writer: Gid,
        endpoint: &Endpoint,
        cdr: Bytes,
        options: WriteOptions,
    ) -> Sample {
        self.last_sequence_number += 1;
        let sample = Sample {
            cdr,
            source_time_ns: now_ns(),
            writer,
            sequence_number: self.last_sequence_number,
            related: options.related,
        };
        if endpoint.qos.durability == Durability::TransientLocal {
            self.samples.push_back(sample.clone());
            if let History::KeepLast(depth) = endpoint.qos.history
                && self.samples.len() > depth as usize
            {
                self.samples.pop_front();
            }
        }
        sample
    }
}

/// Calls the handlers that the news is for.
pub(super) fn deliver(news: News) {
    for (handlers, event) in news {
        if matches!(event, EndpointEvent::Matched { .. } | EndpointEvent::Unmatched { .. }) {
            let on_match = handlers.on_match.lock().clone();
            if let Some(handler) = on_match {
                handler();
            }
        }
        let on_event = handlers.on_event.lock().clone();
        if let Some(handler) = on_event {
            handler(&event);
        }
    }
}

/// The event for one endpoint about another one, `peer`.
fn event_of(suits: Suits, peer: Gid, theirs: &Endpoint) -> EndpointEvent {
    match suits {
        Suits::OtherType => EndpointEvent::IncompatibleType { peer, type_name: theirs.type_name[..].into() },
        Suits::Yes => EndpointEvent::Matched { peer },
        Suits::No(policy) => EndpointEvent::IncompatibleQos { peer, policy },
    }
}

/// `None` where the two have nothing to do with each other.
fn suits(writer: &Endpoint, reader: &Endpoint) -> Option<Suits> {
    if writer.topic_name != reader.topic_name {
        return None;
    }
    if writer.type_name != reader.type_name {
        return Some(Suits::OtherType);
    }
    Some(QosPolicyKind::between(&writer.qos, &reader.qos).map_or(Suits::Yes, Suits::No))
}
