//! The protocol on UDP: sockets, a thread, and handles for writers and readers.
//!
//! A write sends on the calling thread; samples in quick succession share datagrams. Everything else happens
//! on the single thread of the participant: it receives, passes samples and events to the handlers, and runs
//! the timers. A write in a handler is also sent immediately, so an answer is sent on the thread that
//! received the request.

mod endpoint;
mod engine;
mod interfaces;
mod log_limit;
mod options;
mod ports;
mod sockets;
mod static_peers;
mod thread;

pub use endpoint::{EndpointEvent, EventHandler, MatchHandler, SampleHandler};
pub use options::{JoinError, Options, Range, Security};
pub use sockets::SOCKET_BUFFER;

use crate::protocol::{self, Counters, CreateError, EndpointConfig, WriteError, WriteOptions};
use crate::wire::{EndpointData, Guid, GuidPrefix, SequenceNumber, VendorId};
use bytes::Bytes;
use endpoint::EndpointState;
use engine::{Engine, now};
use interfaces::Interfaces;
use mio::{Poll, Token, Waker};
use ports::Ports;
use sockets::{Receivers, Senders};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::net::Ipv4Addr;
use std::sync::Arc;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread::JoinHandle;
use std::time::Duration;

/// Tokens of the receiving sockets, from 0.
const TOKENS: usize = 3;
const SENDER: Token = Token(TOKENS);
const WAKER: Token = Token(TOKENS + 1);
/// Number of participants of this machine that are announced to by address if discovery is limited to
/// localhost, as in rmw_fastrtps.
const LOCAL_PARTICIPANTS: usize = 32;
/// Period in which names of static peers are resolved.
const LOOK_UP: Duration = Duration::from_secs(60);

/// A participant in a domain. Dropping it leaves the domain; remaining endpoints then no longer send or
/// receive.
pub struct Participant {
    engine: Arc<Engine>,
    prefix: GuidPrefix,
    thread: Option<JoinHandle<()>>,
    /// Ends the thread that resolves names when it is dropped.
    _stop_looking: mpsc::Sender<()>,
}

impl Participant {
    /// Joins a domain and starts discovery.
    ///
    /// # Errors
    /// Returns [`JoinError`] if no port is free, or a socket or thread cannot be created.
    pub fn join(options: &Options) -> Result<Self, JoinError> {
        let Options { domain_id, range, .. } = *options;
        let ports = Ports::of_domain(domain_id).ok_or(JoinError::Domain(domain_id))?;
        let poll = Poll::new().map_err(JoinError::Socket)?;
        let interfaces = Interfaces::read(range, &Interfaces::default()).map_err(JoinError::Interfaces)?;
        let mut receivers = Receivers::bind(ports, range, poll.registry())?;
        receivers.join(interfaces.used());
        let mut senders = Senders::bind(range, poll.registry(), SENDER).map_err(JoinError::Socket)?;
        senders.set_interfaces(interfaces.used());
        let waker = Waker::new(poll.registry(), WAKER).map_err(JoinError::Socket)?;

        let hosts = if range == Range::Off { &[][..] } else { &options.static_peers };
        let (mut fixed, names) = static_peers::split(hosts, ports);
        if range == Range::Localhost {
            fixed.extend(ports.announcements_to(Ipv4Addr::LOCALHOST, LOCAL_PARTICIPANTS));
        }
        let bound = (receivers.meta_port, receivers.user_port);
        let addresses = interfaces.addresses(ports, bound, fixed.iter().copied());
        let mut config = protocol::Config::new(unique(), domain_id.into(), addresses);
        config.name.clone_from(&options.name);
        config.user_data = Bytes::copy_from_slice(&options.user_data);
        config.lease = options.lease;
        config.announcement_period = options.announcement_period;
        config.receive_buffer = u32::try_from(receivers.buffer).ok().filter(|bytes| *bytes > 0);
        let participant = match &options.security {
            None => protocol::Participant::new(config, now()),
            Some(security) => {
                let (prefix, guard) = security.guard(config.prefix);
                protocol::Participant::with_guard(protocol::Config { prefix, ..config }, guard, now())
            }
        };
        let prefix = participant.prefix();
        let engine = Engine::new(participant, senders, waker);
        let engine = Arc::new(engine);

        let (found, looked_up) = mpsc::channel();
        let thread = thread::Thread {
            engine: Arc::clone(&engine),
            poll,
            receivers,
            range,
            ports,
            interfaces,
            period: options.announcement_period,
            fixed,
            named: Vec::new(),
            looked_up,
        };
        let thread = std::thread::Builder::new().name("downbeat-rtps".to_owned()).spawn(|| thread.run());
        let thread = Some(thread.map_err(JoinError::Thread)?);
        let (stop_looking, stop) = mpsc::channel();
        let participant = Self { engine, prefix, thread, _stop_looking: stop_looking };
        if !names.is_empty() {
            let engine = Arc::downgrade(&participant.engine);
            let look_up = move || {
                loop {
                    let sent = found.send(names.look_up(ports));
                    let Some(engine) = engine.upgrade().filter(|_| sent.is_ok()) else { return };
                    engine.wake();
                    drop(engine);
                    if stop.recv_timeout(LOOK_UP) != Err(RecvTimeoutError::Timeout) {
                        return;
                    }
                }
            };
            let builder = std::thread::Builder::new().name("downbeat-peers".to_owned());
            // Not joined at the end: a name server may block it for a long time.
            drop(builder.spawn(look_up).map_err(JoinError::Thread)?);
        }
        Ok(participant)
    }

    /// The identity of this participant.
    #[must_use]
    pub fn prefix(&self) -> GuidPrefix {
        self.prefix
    }

    /// Creates a writer.
    ///
    /// # Errors
    /// Returns [`CreateError`] if the configuration is invalid.
    pub fn create_writer(&self, config: EndpointConfig) -> Result<Writer, CreateError> {
        let state = self.engine.create_writer(config)?;
        Ok(Writer { engine: Arc::clone(&self.engine), state })
    }

    /// Creates a reader that calls `on_sample` with each sample.
    ///
    /// # Errors
    /// Returns [`CreateError`] if the configuration is invalid.
    pub fn create_reader(
        &self,
        config: EndpointConfig,
        on_sample: SampleHandler,
    ) -> Result<Reader, CreateError> {
        let state = self.engine.create_reader(config, on_sample)?;
        Ok(Reader { engine: Arc::clone(&self.engine), state })
    }

    /// Returns the currently known endpoints of other participants.
    #[must_use]
    pub fn remote_endpoints(&self) -> Vec<EndpointData> {
        self.engine.lock().participant.remote_endpoints().cloned().collect()
    }

    /// Returns the participants that were discovered, whether or not their endpoints are known.
    #[must_use]
    pub fn remote_participants(&self) -> Vec<GuidPrefix> {
        self.engine.lock().participant.remote_participants().map(|data| data.prefix).collect()
    }

    /// The vendor that a participant has announced; `None` if it is not known.
    #[must_use]
    pub fn vendor_of(&self, participant: GuidPrefix) -> Option<VendorId> {
        self.engine.lock().participant.remote_participant(participant).map(|data| data.vendor)
    }

    /// Leaves the domain at once: its endpoints no longer send or receive. For a process that is about to end
    /// without dropping it.
    pub fn leave(&self) {
        self.engine.stop();
    }

    /// Returns the counters of traffic and invalid input since the participant joined.
    #[must_use]
    pub fn counters(&self) -> Counters {
        self.engine.lock().participant.counters()
    }
}

impl Drop for Participant {
    fn drop(&mut self) {
        self.engine.stop();
        if let Some(thread) = self.thread.take()
            && !self.engine.is_on_its_thread()
        {
            // Panics have already been reported by the thread.
            let _ = thread.join();
        }
    }
}

/// Writes samples to one topic. Dropping it removes the endpoint.
pub struct Writer {
    engine: Arc<Engine>,
    state: Arc<EndpointState>,
}

impl Writer {
    /// The identity of this endpoint.
    #[must_use]
    pub fn guid(&self) -> Guid {
        self.state.guid
    }

    /// Number of matched readers.
    #[must_use]
    pub fn matched(&self) -> usize {
        self.state.matched()
    }

    /// The number of readers of what is written now: matched ones, and known reliable ones that have yet to
    /// answer this writer, for which samples are kept.
    #[must_use]
    pub fn readers(&self) -> usize {
        self.state.known()
    }

    /// Returns a function that counts the readers as [`readers`](Self::readers) does, without keeping the
    /// writer.
    pub fn reader_counter(&self) -> impl Fn() -> usize + Send + Sync + use<> {
        let state = Arc::clone(&self.state);
        move || state.known()
    }

    /// See [`Participant::vendor_of`].
    #[must_use]
    pub fn vendor_of(&self, participant: GuidPrefix) -> Option<VendorId> {
        self.engine.lock().participant.remote_participant(participant).map(|data| data.vendor)
    }

    /// The matched readers.
    #[must_use]
    pub fn matched_readers(&self) -> Vec<Guid> {
        self.state.peers()
    }

    /// Registers an event handler, which replaces the previous one. It is called on the calling thread with
    /// the events that describe the current state. Must not be called in a handler of this endpoint.
    pub fn on_event(&self, handler: EventHandler) {
        self.state.on_event(handler);
    }

    /// Registers a handler that is called whenever the matched readers have changed. Replaces the previous
    /// handler.
    pub fn on_match(&self, handler: MatchHandler) {
        self.state.on_match(handler);
    }

    /// Writes one sample, given as encapsulation header and body, and returns its sequence number. Does not
    /// block.
    ///
    /// # Errors
    /// Returns [`WriteError`] if the sample was not written.
    pub fn write(&self, payload: Bytes, options: WriteOptions) -> Result<SequenceNumber, WriteError> {
        self.engine.write(self.state.guid.entity, payload, options)
    }

    /// Asserts the liveliness of this writer without a sample, if its liveliness is manual.
    pub fn assert_liveliness(&self) {
        let mut protocol = self.engine.lock();
        protocol.participant.assert_liveliness(now(), self.state.guid.entity);
        self.engine.follow_up(protocol);
    }

    /// Waits until all matched reliable readers have acknowledged all samples. Returns false after `timeout`.
    /// Does not wait if called in a handler.
    #[must_use]
    pub fn flush(&self, timeout: Duration) -> bool {
        self.engine.wait_until_acknowledged(self.state.guid.entity, timeout)
    }
}

impl Drop for Writer {
    fn drop(&mut self) {
        self.engine.remove(&self.state);
    }
}

/// A subscription. Once it is dropped its handlers are no longer called.
pub struct Reader {
    engine: Arc<Engine>,
    state: Arc<EndpointState>,
}

impl Reader {
    /// The identity of this endpoint.
    #[must_use]
    pub fn guid(&self) -> Guid {
        self.state.guid
    }

    /// Number of matched writers.
    #[must_use]
    pub fn matched(&self) -> usize {
        self.state.matched()
    }

    /// The matched writers.
    #[must_use]
    pub fn matched_writers(&self) -> Vec<Guid> {
        self.state.peers()
    }

    /// See [`Writer::on_event`].
    pub fn on_event(&self, handler: EventHandler) {
        self.state.on_event(handler);
    }

    /// Registers a handler that is called whenever the matched writers have changed. Replaces the previous
    /// handler.
    pub fn on_match(&self, handler: MatchHandler) {
        self.state.on_match(handler);
    }
}

impl Drop for Reader {
    fn drop(&mut self) {
        self.engine.remove(&self.state);
    }
}

/// Returns random bytes for the identity of a participant. They come from the keys of a hasher, which the
/// system generates randomly.
fn unique() -> [u8; 10] {
    let mut hashers = std::iter::repeat_with(|| {
        let mut hasher = RandomState::new().build_hasher();
        hasher.write_u32(std::process::id());
        hasher.finish()
    });
    let mut unique = [0; 10];
    for (bytes, hash) in unique.chunks_mut(8).zip(&mut hashers) {
        bytes.copy_from_slice(&hash.to_ne_bytes()[..bytes.len()]);
    }
    unique
}
