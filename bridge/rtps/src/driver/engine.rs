//! The protocol and the sockets that send, as handles and the thread share them.
//!
//! There are two locks. The *protocol* is locked for the duration of each call into it, never while a
//! datagram is sent. *Outgoing* is held by the thread that sends. It is acquired and released while the
//! protocol is locked, and no thread waits for it. A thread that finds it taken can therefore rely on the
//! holder to poll the protocol again, and datagrams are sent in the order in which the protocol produced
//! them.

use super::endpoint::{EndpointEvent, EndpointState, SampleHandler};
use super::interfaces::Interfaces;
use super::sockets::{Senders, Sent};
use crate::protocol::{
    self, Addresses, CreateError, Destination, EndpointConfig, Event, Fault, Now, Report, Severity,
    WriteError, WriteOptions,
};
use crate::wire::{EntityId, Guid, SequenceNumber};
use bytes::Bytes;
use mio::Waker;
use std::collections::HashMap;
use std::net::SocketAddrV4;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError, RwLock};
use std::thread::ThreadId;
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// A write that follows the previous one within this time is delayed, so that it can share a datagram with
/// later writes.
const BURST: Duration = Duration::from_micros(20);
/// Number of datagrams that a writing thread sends itself; the thread of the participant sends the rest.
const DIRECT_DATAGRAMS: usize = 4;
/// The most events that wait for their handlers. If there are more, the handlers do not keep up, and writes
/// are refused.
const MOST_EVENTS: usize = 4096;
/// Period in which the thread checks the timers while samples are written, so that a write need not wake it
/// for its heartbeat.
const LOOK: Duration = Duration::from_millis(50);
/// How long after a write the thread checks the timers in this period.
const ACTIVE: Duration = Duration::from_secs(1);

pub(super) struct Engine {
    protocol: Mutex<Protocol>,
    outgoing: Mutex<Outgoing>,
    endpoints: RwLock<HashMap<EntityId, Arc<EndpointState>>>,
    /// Used with the lock of the protocol.
    acknowledged: Condvar,
    waker: Waker,
    is_woken: AtomicBool,
    is_stopping: AtomicBool,
    thread: OnceLock<ThreadId>,
}

pub(super) struct Protocol {
    pub(super) participant: protocol::Participant,
    /// True once the participant has announced its departure.
    has_left: bool,
    /// Events that wait for their handlers, in order.
    events: Vec<Event>,
    /// When the thread checks the timers next.
    looks_at: Option<Instant>,
    last_write: Option<Instant>,
}

pub(super) struct Outgoing {
    senders: Senders,
    datagram: Vec<u8>,
    /// The destination of the datagram while the send buffer is full.
    waiting: Option<Destination>,
    /// When a writing thread last sent a datagram itself.
    last_direct: Option<Instant>,
}

/// Whether everything was sent that the protocol has to send now.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Transmitted {
    All,
    /// There is more to send, and no thread is sending it.
    Rest,
    /// The thread continues when the socket is writable.
    Blocked,
}

impl Engine {
    pub(super) fn new(participant: protocol::Participant, senders: Senders, waker: Waker) -> Self {
        Self {
            protocol: Mutex::new(Protocol {
                participant,
                has_left: false,
                events: Vec::new(),
                looks_at: None,
                last_write: None,
            }),
            outgoing: Mutex::new(Outgoing {
                senders,
                datagram: Vec::new(),
                waiting: None,
                last_direct: None,
            }),
            endpoints: RwLock::default(),
            acknowledged: Condvar::new(),
            waker,
            is_woken: AtomicBool::new(false),
            is_stopping: AtomicBool::new(false),
            thread: OnceLock::new(),
        }
    }

    pub(super) fn lock(&self) -> MutexGuard<'_, Protocol> {
        self.protocol.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Must be called once, on the thread of the participant.
    pub(super) fn run_on_this_thread(&self) {
        // There is only one such thread.
        let _ = self.thread.set(std::thread::current().id());
    }

    pub(super) fn is_on_its_thread(&self) -> bool {
        self.thread.get() == Some(&std::thread::current().id())
    }

    pub(super) fn create_writer(&self, config: EndpointConfig) -> Result<Arc<EndpointState>, CreateError> {
        self.create(None, |participant, now| participant.create_writer(now, config))
    }

    pub(super) fn create_reader(
        &self,
        config: EndpointConfig,
        on_sample: SampleHandler,
    ) -> Result<Arc<EndpointState>, CreateError> {
        self.create(Some(on_sample), |participant, now| participant.create_reader(now, config))
    }

    fn create(
        &self,
        on_sample: Option<SampleHandler>,
        create: impl FnOnce(&mut protocol::Participant, Now) -> Result<EntityId, CreateError>,
    ) -> Result<Arc<EndpointState>, CreateError> {
        let mut protocol = self.lock();
        let id = create(&mut protocol.participant, now())?;
        let guid = Guid::new(protocol.participant.prefix(), id);
        let state = Arc::new(EndpointState::new(guid, on_sample));
        // While the protocol is locked, so that no event arrives earlier.
        self.endpoints.write().unwrap_or_else(PoisonError::into_inner).insert(id, Arc::clone(&state));
        self.follow_up(protocol);
        Ok(state)
    }

    pub(super) fn remove(&self, endpoint: &EndpointState) {
        let mut protocol = self.lock();
        if !protocol.has_left {
            protocol.participant.remove_endpoint(now(), endpoint.guid.entity);
        }
        self.endpoints.write().unwrap_or_else(PoisonError::into_inner).remove(&endpoint.guid.entity);
        self.follow_up(protocol);
        endpoint.close(self.is_on_its_thread());
    }

    /// Sends a sample from the calling thread, or, during a burst, leaves it to the thread of the
    /// participant.
    pub(super) fn write(
        &self,
        writer: EntityId,
        payload: Bytes,
        options: WriteOptions,
    ) -> Result<SequenceNumber, WriteError> {
        let now = now();
        let mut protocol = self.lock();
        if protocol.has_left {
            return Err(WriteError::UnknownWriter);
        }
        if protocol.events.len() >= MOST_EVENTS {
            return Err(WriteError::WindowFull);
        }
        let number = protocol.participant.write(now, writer, payload, options)?;
        protocol.last_write = Some(now.steady);
        let must_wake = protocol.collect() | protocol.is_due_before_the_thread_looks();
        let transmitted = match self.outgoing.try_lock() {
            // The holder polls the protocol again.
            Err(_) => Transmitted::All,
            Ok(outgoing) if outgoing.waiting.is_some() => Transmitted::Blocked,
            Ok(outgoing) if outgoing.is_burst(now.steady) => Transmitted::Rest,
            Ok(outgoing) => self.transmit(protocol, outgoing, DIRECT_DATAGRAMS),
        };
        if must_wake || transmitted == Transmitted::Rest {
            self.wake();
        }
        Ok(number)
    }

    /// Sends what a call has produced, and wakes the thread for the rest.
    pub(super) fn follow_up(&self, mut protocol: MutexGuard<'_, Protocol>) {
        let must_wake = protocol.collect() | protocol.is_due_before_the_thread_looks();
        let transmitted = match self.outgoing.try_lock() {
            Err(_) => Transmitted::All,
            Ok(outgoing) => self.transmit(protocol, outgoing, DIRECT_DATAGRAMS),
        };
        if must_wake || transmitted == Transmitted::Rest {
            self.wake();
        }
    }

    /// Sends everything that is ready to be sent. Called by the thread of the participant.
    pub(super) fn transmit_all(&self) {
        let mut protocol = self.lock();
        if let Ok(mut outgoing) = self.outgoing.try_lock() {
            for refused in outgoing.senders.take_refusals() {
                protocol.participant.handle_refusal(now(), refused);
            }
            self.transmit(protocol, outgoing, usize::MAX);
        }
    }

    fn transmit<'a>(
        &'a self,
        mut protocol: MutexGuard<'a, Protocol>,
        mut outgoing: MutexGuard<'a, Outgoing>,
        most: usize,
    ) -> Transmitted {
        let is_direct = most != usize::MAX;
        let mut result = Transmitted::Rest;
        for _ in 0..most {
            let waiting = outgoing.waiting.take();
            let destination = waiting.or_else(|| {
                outgoing.datagram.clear();
                protocol.participant.poll_transmit(now(), &mut outgoing.datagram)
            });
            let Some(destination) = destination else {
                result = Transmitted::All;
                break;
            };
            drop(protocol);
            let sent = outgoing.send(destination);
            protocol = self.lock();
            for refused in outgoing.senders.take_refusals() {
                protocol.participant.handle_refusal(now(), refused);
            }
            if sent == Sent::Full {
                outgoing.waiting = Some(destination);
                result = Transmitted::Blocked;
                break;
            }
        }
        if is_direct {
            outgoing.last_direct = Some(Instant::now());
        }
        // Samples to endpoints of this participant arrive here.
        if protocol.collect() {
            self.wake();
        }
        drop(outgoing);
        drop(protocol);
        result
    }

    /// Wakes the thread of the participant, unless it is awake.
    pub(super) fn wake(&self) {
        if !self.is_on_its_thread()
            && !self.is_woken.swap(true, Ordering::SeqCst)
            && let Err(error) = self.waker.wake()
        {
            tracing::warn!("waking the thread of the participant failed: {error}");
        }
    }

    /// Must be called when the thread has woken, before it checks for work.
    pub(super) fn is_awake(&self) {
        self.is_woken.store(false, Ordering::SeqCst);
    }

    /// Returns how long the thread may sleep, at most until `latest`.
    pub(super) fn sleep(&self, latest: Option<Instant>) -> Option<Duration> {
        let mut protocol = self.lock();
        let now = Instant::now();
        if protocol.collect() {
            return Some(Duration::ZERO);
        }
        let is_active = protocol.last_write.is_some_and(|last| now.duration_since(last) < ACTIVE);
        let look = is_active.then(|| now + LOOK);
        protocol.looks_at = [protocol.participant.next_timeout(), latest, look].into_iter().flatten().min();
        protocol.looks_at.map(|at| at.saturating_duration_since(now))
    }

    /// Notes which ports answered that they are closed. Called when the sending socket reports an error.
    pub(super) fn read_refusals(&self) {
        if let Ok(mut outgoing) = self.outgoing.try_lock() {
            outgoing.senders.read_refusals();
        }
    }

    /// Runs the timers that are due.
    pub(super) fn handle_timeout(&self) {
        let mut protocol = self.lock();
        let now = now();
        if !protocol.has_left && protocol.participant.next_timeout().is_some_and(|at| at <= now.steady) {
            protocol.participant.handle_timeout(now);
            protocol.collect();
        }
    }

    /// Passes waiting events to the handlers. `events` is an empty buffer, which is reused.
    pub(super) fn deliver(&self, events: &mut Vec<Event>) {
        {
            let mut protocol = self.lock();
            protocol.collect();
            std::mem::swap(&mut protocol.events, events);
        }
        for event in events.drain(..) {
            if catch_unwind(AssertUnwindSafe(|| self.dispatch(event))).is_err() {
                tracing::error!("a handler panicked on the thread of the participant; it is called again");
            }
        }
    }

    fn dispatch(&self, event: Event) {
        let deliver = |local, event| {
            if let Some(endpoint) = self.endpoint(local) {
                endpoint.deliver(event);
            }
        };
        match event {
            Event::Sample { reader, sample } => {
                if let Some(endpoint) = self.endpoint(reader) {
                    endpoint.give(sample);
                }
            }
            Event::Matched { local, remote } => deliver(local, EndpointEvent::Matched { peer: remote }),
            Event::Awaiting { writer, count } => {
                if let Some(endpoint) = self.endpoint(writer) {
                    endpoint.await_readers(count);
                }
            }
            Event::Unmatched { local, remote } => deliver(local, EndpointEvent::Unmatched { peer: remote }),
            Event::Incompatible { local, remote, policy } => {
                deliver(local, EndpointEvent::Incompatible { peer: remote, policy });
            }
            Event::OtherType { local, remote, type_name } => {
                deliver(local, EndpointEvent::OtherType { peer: remote, type_name });
            }
            Event::DeadlineMissed { local, count } => deliver(local, EndpointEvent::DeadlineMissed { count }),
            Event::LivelinessLost { writer } => deliver(writer, EndpointEvent::LivelinessLost),
            Event::LivelinessChanged { reader, writer, change } => {
                deliver(reader, EndpointEvent::LivelinessChanged { peer: writer, change });
            }
            Event::Lost { reader, writer, count } => {
                deliver(reader, EndpointEvent::Lost { peer: writer, count })
            }
            Event::BegunAnew { writer, reader } => {
                deliver(writer, EndpointEvent::BegunAnew { peer: reader });
            }
            Event::Acknowledged { .. } => self.acknowledged.notify_all(),
            Event::EndpointLeft { remote } => {
                let endpoints: Vec<_> =
                    self.endpoints.read().unwrap_or_else(PoisonError::into_inner).values().cloned().collect();
                endpoints.iter().for_each(|endpoint| endpoint.forget(remote));
            }
            Event::Security(report) => self.report(&report),
            // The guard says why, in words.
            Event::Warning { fault: Fault::Rejected, from, .. } => {
                tracing::debug!("security rejected a message from {from}");
            }
            Event::Warning { fault, from, count } => {
                tracing::warn!("dropped {fault} from {from} ({count} since the last such message)");
            }
            Event::ParticipantLeft { remote, reason } => {
                tracing::debug!("participant {remote} was removed: {reason:?}");
            }
            Event::WindowOpen { .. }
            | Event::EndpointFound { .. }
            | Event::EndpointChanged { .. }
            | Event::ParticipantFound { .. } => {}
        }
    }

    fn report(&self, report: &Report) {
        match report.severity {
            Severity::Info => tracing::info!("{}", report.text),
            Severity::Warning => tracing::warn!("{}", report.text),
        }
    }

    fn endpoint(&self, id: EntityId) -> Option<Arc<EndpointState>> {
        self.endpoints.read().unwrap_or_else(PoisonError::into_inner).get(&id).cloned()
    }

    /// Waits until all matched reliable readers have acknowledged all samples. Returns false after `timeout`.
    pub(super) fn wait_until_acknowledged(&self, writer: EntityId, timeout: Duration) -> bool {
        let deadline = Instant::now().checked_add(timeout);
        let mut protocol = self.lock();
        if !protocol.has_left {
            protocol.participant.ask_for_acknowledgements(now(), writer);
        }
        // Sends delayed samples of a burst now, and the request.
        self.wake();
        loop {
            if protocol.participant.is_acknowledged(writer) {
                return true;
            }
            let rest = deadline.map_or(Duration::MAX, |at| at.saturating_duration_since(Instant::now()));
            if rest.is_zero() || self.is_on_its_thread() || self.is_stopping() {
                return false;
            }
            let waited = self.acknowledged.wait_timeout(protocol, rest);
            protocol = waited.unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Replaces the interfaces and addresses.
    pub(super) fn set_addresses(&self, interfaces: &Interfaces, addresses: Addresses) {
        let mut protocol = self.lock();
        if !protocol.has_left {
            protocol.participant.set_addresses(now(), addresses);
        }
        drop(protocol);
        // Other threads that find it taken leave their datagrams to this thread, which sends next.
        self.outgoing
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .senders
            .set_interfaces(interfaces.used());
    }

    /// Leaves the domain and ends the thread.
    pub(super) fn stop(&self) {
        let mut protocol = self.lock();
        protocol.participant.leave(now());
        protocol.has_left = true;
        if let Ok(outgoing) = self.outgoing.try_lock() {
            self.transmit(protocol, outgoing, usize::MAX);
        } else {
            drop(protocol);
        }
        self.is_stopping.store(true, Ordering::SeqCst);
        self.acknowledged.notify_all();
        self.wake();
    }

    pub(super) fn is_stopping(&self) -> bool {
        self.is_stopping.load(Ordering::SeqCst)
    }
}

impl Protocol {
    pub(super) fn handle_datagram(&mut self, now: Now, from: SocketAddrV4, datagram: &[u8]) {
        if !self.has_left {
            self.participant.handle_datagram(now, from, datagram);
        }
    }

    /// Takes the events of the protocol. Returns whether there are any.
    pub(super) fn collect(&mut self) -> bool {
        while let Some(event) = self.participant.poll_event() {
            self.events.push(event);
        }
        !self.events.is_empty()
    }

    fn is_due_before_the_thread_looks(&self) -> bool {
        let next = self.participant.next_timeout();
        next.is_some_and(|next| self.looks_at.is_none_or(|looks_at| next < looks_at))
    }
}

impl Outgoing {
    fn is_burst(&self, now: Instant) -> bool {
        self.last_direct.is_some_and(|last| now.saturating_duration_since(last) < BURST)
    }

    fn send(&mut self, destination: Destination) -> Sent {
        match destination {
            Destination::Unicast(to) => self.senders.send(to, &self.datagram),
            Destination::Multicast(group) => {
                self.senders.send_to_group(group, &self.datagram);
                Sent::Done
            }
            // The protocol does not return these.
            Destination::Own => Sent::Done,
        }
    }
}

pub(super) fn now() -> Now {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    Now { steady: Instant::now(), wall_ns: i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX) }
}
