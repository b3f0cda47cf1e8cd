//! Endpoints that outlive the participant they were created on.

use super::{Trouble, TroubleSink, lock};
use crate::middleware::{
    Endpoint, EndpointEvent, EventHandler, Gid, MatchHandler, Middleware, MiddlewareError, Reader, Sample,
    SampleHandler, WriteError, WriteOptions, Writer,
};
use bytes::Bytes;
use downbeat_msgs::qos::{Durability, History};
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, RwLock, RwLockReadGuard, RwLockWriteGuard};
use std::time::Duration;

/// What a writer that keeps all its samples writes again at most.
const KEEP_ALL_AGAIN: usize = 64;

/// Identities of an endpoint: before and after.
type Moved = (Gid, Gid);

/// An endpoint of the present engine, or nothing while there is none.
struct Slot<E: ?Sized> {
    now: RwLock<Now<E>>,
    on_match: Mutex<Option<Arc<MatchHandler>>>,
    on_event: Mutex<Option<Arc<EventHandler>>>,
    /// With whom it was matched when it was taken out.
    left: Mutex<Vec<Gid>>,
}

struct Now<E: ?Sized> {
    gid: Gid,
    endpoint: Option<Box<E>>,
}

impl<E: ?Sized> Slot<E> {
    fn new(gid: Gid, endpoint: Box<E>) -> Self {
        Self {
            now: RwLock::new(Now { gid, endpoint: Some(endpoint) }),
            on_match: Mutex::default(),
            on_event: Mutex::default(),
            left: Mutex::default(),
        }
    }

    fn read(&self) -> RwLockReadGuard<'_, Now<E>> {
        self.now.read().unwrap_or_else(PoisonError::into_inner)
    }

    fn write(&self) -> RwLockWriteGuard<'_, Now<E>> {
        self.now.write().unwrap_or_else(PoisonError::into_inner)
    }

    /// What `ask` says of the endpoint; while it is away, what nobody would say.
    fn ask<R: Default>(&self, ask: impl FnOnce(&E) -> R) -> R {
        self.read().endpoint.as_deref().map(ask).unwrap_or_default()
    }

    fn take(&self) -> Option<Box<E>> {
        self.write().endpoint.take()
    }

    fn put(&self, gid: Gid, endpoint: Box<E>) -> Moved {
        let mut now = self.write();
        now.endpoint = Some(endpoint);
        (std::mem::replace(&mut now.gid, gid), gid)
    }

    fn handler(&self) -> Option<MatchHandler> {
        let handler = lock(&self.on_match).clone()?;
        Some(Box::new(move || (*handler)()))
    }

    fn tell_matches(&self) {
        if let Some(handler) = self.handler() {
            handler();
        }
    }

    fn event_handler(&self) -> Option<EventHandler> {
        let handler = lock(&self.on_event).clone()?;
        Some(Box::new(move |event| (*handler)(event)))
    }

    /// The engine of the endpoint is gone, and with it those it was matched with.
    fn tell_unmatched(&self) {
        let peers = std::mem::take(&mut *lock(&self.left));
        if let Some(handler) = self.event_handler() {
            peers.into_iter().for_each(|peer| handler(&EndpointEvent::Unmatched { peer }));
        }
    }
}

pub(super) struct WriterSlot {
    endpoint: Endpoint,
    slot: Slot<dyn Writer>,
    sink: TroubleSink,
    /// What a late reader is to have: of a transient local writer, its last samples.
    latched: Mutex<VecDeque<Bytes>>,
}

impl WriterSlot {
    pub(super) fn new(endpoint: Endpoint, writer: Box<dyn Writer>, sink: TroubleSink) -> Self {
        let slot = Slot::new(writer.gid(), writer);
        Self { endpoint, slot, sink, latched: Mutex::default() }
    }

    pub(super) fn take(&self) -> Option<Box<dyn Writer>> {
        self.slot.take()
    }

    /// Takes the endpoint out, for it to end with its engine.
    pub(super) fn leave(&self) -> Option<Box<dyn Writer>> {
        let writer = self.slot.take()?;
        *lock(&self.slot.left) = writer.matched_readers();
        Some(writer)
    }

    pub(super) fn tell_unmatched(&self) {
        self.slot.tell_unmatched();
    }

    pub(super) fn tell_matches(&self) {
        self.slot.tell_matches();
    }

    pub(super) fn create_on(&self, engine: &dyn Middleware) -> Result<Moved, MiddlewareError> {
        let writer = engine.create_writer(&self.endpoint)?;
        // Held until the writer is in its place, so that nothing is written before what was written earlier.
        let latched = lock(&self.latched);
        for cdr in latched.iter() {
            // What cannot be written now is told as it was when it was written first.
            let _ = writer.write(cdr.clone());
        }
        if let Some(handler) = self.slot.handler() {
            writer.on_match(handler);
        }
        if let Some(handler) = self.slot.event_handler() {
            writer.on_event(handler);
        }
        Ok(self.slot.put(writer.gid(), writer))
    }

    /// Held until the sample is written, so that a writer that comes in between does not write it, too.
    fn keep(&self, cdr: &Bytes) -> Option<MutexGuard<'_, VecDeque<Bytes>>> {
        if self.endpoint.qos.durability != Durability::TransientLocal {
            return None;
        }
        let depth = match self.endpoint.qos.history {
            History::KeepLast(depth) => depth as usize,
            History::KeepAll => KEEP_ALL_AGAIN,
        };
        let mut latched = lock(&self.latched);
        latched.push_back(cdr.clone());
        if latched.len() > depth {
            latched.pop_front();
        }
        Some(latched)
    }
}

pub(super) struct ReaderSlot {
    endpoint: Endpoint,
    slot: Slot<dyn Reader>,
    on_sample: SharedHandler,
}

type SharedHandler = Arc<Mutex<SampleHandler>>;

impl ReaderSlot {
    pub(super) fn new(endpoint: Endpoint, reader: Box<dyn Reader>, on_sample: SharedHandler) -> Self {
        Self { endpoint, slot: Slot::new(reader.gid(), reader), on_sample }
    }

    pub(super) fn take(&self) -> Option<Box<dyn Reader>> {
        self.slot.take()
    }

    /// Takes the endpoint out, for it to end with its engine.
    pub(super) fn leave(&self) -> Option<Box<dyn Reader>> {
        let reader = self.slot.take()?;
        *lock(&self.slot.left) = reader.matched_writers();
        Some(reader)
    }

    pub(super) fn tell_unmatched(&self) {
        self.slot.tell_unmatched();
    }

    pub(super) fn tell_matches(&self) {
        self.slot.tell_matches();
    }

    pub(super) fn create_on(&self, engine: &dyn Middleware) -> Result<Moved, MiddlewareError> {
        let reader = engine.create_reader(&self.endpoint, hand_to(&self.on_sample))?;
        if let Some(handler) = self.slot.handler() {
            reader.on_match(handler);
        }
        if let Some(handler) = self.slot.event_handler() {
            reader.on_event(handler);
        }
        Ok(self.slot.put(reader.gid(), reader))
    }
}

/// A handler for one engine, in front of the one that stays.
pub(super) fn hand_to(on_sample: &SharedHandler) -> SampleHandler {
    let on_sample = Arc::clone(on_sample);
    Box::new(move |sample: Sample| (*lock(&on_sample))(sample))
}

pub(super) struct RejoiningWriter(pub(super) Arc<WriterSlot>);

impl Writer for RejoiningWriter {
    fn gid(&self) -> Gid {
        self.0.slot.read().gid
    }

    fn matched(&self) -> usize {
        self.0.slot.ask(|writer| writer.matched())
    }

    fn matched_readers(&self) -> Vec<Gid> {
        self.0.slot.ask(|writer| writer.matched_readers())
    }

    fn on_match(&self, handler: MatchHandler) {
        *lock(&self.0.slot.on_match) = Some(Arc::new(handler));
        if let (Some(handler), Some(writer)) = (self.0.slot.handler(), &self.0.slot.read().endpoint) {
            writer.on_match(handler);
        }
    }

    fn on_event(&self, handler: EventHandler) {
        *lock(&self.0.slot.on_event) = Some(Arc::new(handler));
        if let (Some(handler), Some(writer)) = (self.0.slot.event_handler(), &self.0.slot.read().endpoint) {
            writer.on_event(handler);
        }
    }

    fn write_with(&self, cdr: Bytes, options: WriteOptions) -> Result<i64, WriteError> {
        let _kept = self.0.keep(&cdr);
        let written = match &self.0.slot.read().endpoint {
            Some(writer) => writer.write_with(cdr, options),
            None => Err(WriteError::Away),
        };
        if let Err(error @ (WriteError::Panicked | WriteError::Engine(_))) = &written {
            self.0.sink.tell(Trouble::Engine(format!("{}: {error}", self.0.endpoint.topic_name)));
        }
        written
    }

    fn flush(&self, timeout: Duration) -> bool {
        self.0.slot.ask(|writer| writer.flush(timeout))
    }
}

impl Drop for RejoiningWriter {
    fn drop(&mut self) {
        // Not left to the slot, which the supervisor may hold for a while.
        drop(self.0.take());
    }
}

pub(super) struct RejoiningReader(pub(super) Arc<ReaderSlot>);

impl Reader for RejoiningReader {
    fn gid(&self) -> Gid {
        self.0.slot.read().gid
    }

    fn matched(&self) -> usize {
        self.0.slot.ask(|reader| reader.matched())
    }

    fn matched_writers(&self) -> Vec<Gid> {
        self.0.slot.ask(|reader| reader.matched_writers())
    }

    fn on_match(&self, handler: MatchHandler) {
        *lock(&self.0.slot.on_match) = Some(Arc::new(handler));
        if let (Some(handler), Some(reader)) = (self.0.slot.handler(), &self.0.slot.read().endpoint) {
            reader.on_match(handler);
        }
    }

    fn on_event(&self, handler: EventHandler) {
        *lock(&self.0.slot.on_event) = Some(Arc::new(handler));
        if let (Some(handler), Some(reader)) = (self.0.slot.event_handler(), &self.0.slot.read().endpoint) {
            reader.on_event(handler);
        }
    }
}

impl Drop for RejoiningReader {
    fn drop(&mut self) {
        drop(self.0.take());
    }
}
