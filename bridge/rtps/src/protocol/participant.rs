//! One participant of a domain with its endpoints.

use std::{
    collections::VecDeque,
    net::SocketAddrV4,
    time::{Duration, Instant},
};

use bytes::Bytes;

use super::{
    Addresses, Channel, Config, Counters, Denial, Destination, EndpointConfig, Event, Fault, Guard, Limits,
    LinkId, LinkOptions, Links, Now, Reader, ReaderConfig, Received, Room, WriteOptions, Writer,
    WriterConfig,
    counters::Warnings,
    discovery::{Announced, Announcer, BUILTIN, BUILTIN_OF_SECURITY, Builtin},
    links::OWN_HOST_DATAGRAM,
    locals::Locals,
    peers::Peers,
    timers::Timers,
};
use crate::{
    qos::{Durability, History, Qos, Reliability},
    wire::{EndpointData, EntityId, Guid, GuidPrefix, ParticipantData, SequenceNumber},
};

/// Payload of a fragment to local endpoints, where nothing is lost.
const OWN_FRAGMENT: u16 = 60_000;

/// How long a message of a handshake is worth sending.
const HANDSHAKE_LIFESPAN: Duration = Duration::from_secs(10);

/// The longest message between guards; anybody may send one.
const MOST_BYTES_ON_CHANNEL: u32 = 256 << 10;

/// The least payload of a fragment, however much its protection takes.
const SMALLEST_FRAGMENT: u16 = 512;

/// A longer time than this without a call means that the process was suspended, because announcements cause
/// more frequent calls.
const SUSPENSION: Duration = Duration::from_secs(2);

/// The resolution of timers.
pub(super) const SHORTEST_TIMEOUT: Duration = Duration::from_micros(50);

/// Error of a write.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum WriteError {
    #[error("the writer does not exist")]
    UnknownWriter,
    #[error("too many samples of the writer wait to be sent or acknowledged")]
    WindowFull,
}

/// Error while creating an endpoint.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum CreateError {
    #[error("no identities are left for endpoints of this participant")]
    TooMany,
    #[error(transparent)]
    Denied(#[from] Denial),
    #[error(
        "the name of the topic or type, or the user data, is longer than participants of this engine accept"
    )]
    Overlong,
}

/// The parts of the participant that have timers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub(super) enum Timer {
    Announcement,
    Liveliness,
    Lease(GuidPrefix),
    Doubt(GuidPrefix),
    Audit(GuidPrefix),
    /// Until it passes, nothing is sent to a participant whose port was closed.
    Closed(GuidPrefix),
    Guard,
    Endpoint(EntityId),
}

/// A participant without sockets, clock or threads.
///
/// After each call that takes the time, call [`Participant::poll_transmit`] until it returns `None`, then
/// [`Participant::poll_event`] until it returns `None`, and call [`Participant::handle_timeout`] at
/// [`Participant::next_timeout`].
pub struct Participant {
    pub(super) config: Config,
    pub(super) locals: Locals,
    pub(super) peers: Peers,
    pub(super) links: Links,
    /// The link to local endpoints.
    pub(super) own: LinkId,
    pub(super) timers: Timers<Timer>,
    pub(super) announcer: Announcer,
    pub(super) announced: Announced,
    /// The time between assertions of the writers whose liveliness is automatic.
    pub(super) liveliness_period: Option<Duration>,
    pub(super) events: VecDeque<Event>,
    pub(super) counters: Counters,
    pub(super) warnings: Warnings,
    pub(super) guard: Option<Box<dyn Guard>>,
    /// The plain form of a received message, kept to reuse its allocation.
    pub(super) plain: Vec<u8>,
    /// No lease ends before this time: after a suspension the announcements of all others have yet to arrive.
    pub(super) grace_until: Instant,
    latest_call: Instant,
    latest_key: u32,
    /// Kept to reuse its allocation.
    received: Vec<Received>,
}

impl Participant {
    pub fn new(config: Config, now: Now) -> Self {
        Self::create(config, None, now)
    }

    /// Creates a participant whose messages and matches `guard` protects. The prefix in `config` is the one
    /// that belongs to its identity.
    pub fn with_guard(config: Config, guard: Box<dyn Guard>, now: Now) -> Self {
        Self::create(config, Some(guard), now)
    }

    fn create(mut config: Config, mut guard: Option<Box<dyn Guard>>, now: Now) -> Self {
        if let Some(guard) = &guard {
            // A protected fragment has to fit into the same frame.
            let Room { message, submessage } = guard.room();
            let growth = u16::try_from(message + submessage).unwrap_or(u16::MAX);
            config.fragment_size = config.fragment_size.saturating_sub(growth).max(SMALLEST_FRAGMENT);
        }
        let mut links = Links::new();
        let own = links.open(LinkOptions {
            destination: Destination::Own,
            peer: config.prefix,
            max_datagram: OWN_HOST_DATAGRAM,
            fragment_size: OWN_FRAGMENT,
            receive_buffer: None,
        });
        let mut participant = Self {
            locals: Locals::default(),
            peers: Peers::default(),
            links,
            own,
            timers: Timers::new(),
            announcer: Announcer::new(&config, guard.as_deref_mut(), now),
            announced: Announced::default(),
            liveliness_period: None,
            events: VecDeque::new(),
            counters: Counters::default(),
            warnings: Warnings::default(),
            guard,
            plain: Vec::new(),
            grace_until: now.steady,
            latest_call: now.steady,
            latest_key: 0,
            received: Vec::new(),
            config,
        };
        participant.create_builtin_endpoints();
        participant.announce_protected(now);
        participant.timers.set(Timer::Announcement, participant.announcer.next());
        participant
    }

    pub fn guid(&self) -> Guid {
        Guid::new(self.config.prefix, EntityId::PARTICIPANT)
    }

    pub fn prefix(&self) -> GuidPrefix {
        self.config.prefix
    }

    /// Runs the timers that are due.
    pub fn handle_timeout(&mut self, now: Now) {
        self.note_time(now);
        while let Some(timer) = self.timers.pop(now.steady) {
            match timer {
                Timer::Announcement => self.announce(now),
                Timer::Liveliness => self.assert_automatic_writers(now),
                Timer::Lease(prefix) => self.check_lease(now, prefix),
                Timer::Doubt(prefix) => self.resolve_doubt(now, prefix),
                Timer::Audit(prefix) => self.audit(now, prefix),
                Timer::Closed(prefix) => self.reopen(prefix),
                Timer::Guard => {
                    if let Some(guard) = self.guard.as_deref_mut() {
                        guard.handle_timeout(now);
                    }
                }
                Timer::Endpoint(id) if self.locals.writers.contains_key(&id) => {
                    self.with_writer(now, id, |writer, links| writer.handle_timeout(now, links));
                }
                Timer::Endpoint(id) => {
                    self.with_reader(now, id, |reader, received, links| {
                        reader.handle_timeout(now, received, links);
                    });
                }
            }
        }
        self.heed_guard(now);
    }

    /// The next time at which [`Participant::handle_timeout`] has something to do.
    pub fn next_timeout(&self) -> Option<Instant> {
        let pacers = self.links.next_timeout();
        self.timers.next().into_iter().chain(pacers).min()
    }

    /// Returns the oldest event that has not been returned yet.
    pub fn poll_event(&mut self) -> Option<Event> {
        self.events.pop_front()
    }

    /// Replaces the addresses after the interfaces have changed.
    pub fn set_addresses(&mut self, now: Now, addresses: Addresses) {
        self.note_time(now);
        if self.config.addresses != addresses {
            self.config.addresses = addresses;
            self.readdress(now);
        }
    }

    /// Creates a writer and announces it.
    pub fn create_writer(&mut self, now: Now, config: EndpointConfig) -> Result<EntityId, CreateError> {
        self.note_time(now);
        let id = EntityId::user_writer(self.next_key()?);
        let data = self.announceable(now, id, &config)?;
        let writer = Writer::new(WriterConfig {
            guid: data.guid,
            qos: config.qos,
            send_window: config.send_window,
            send_window_bytes: config.send_window_bytes,
        });
        self.locals.add_writer(data, writer);
        self.introduce(now, id);
        Ok(id)
    }

    /// Creates a reader and announces it.
    pub fn create_reader(&mut self, now: Now, config: EndpointConfig) -> Result<EntityId, CreateError> {
        self.note_time(now);
        let id = EntityId::user_reader(self.next_key()?);
        let data = self.announceable(now, id, &config)?;
        let reader = Reader::new(self.reader_config(data.guid, config.qos));
        self.locals.add_reader(data, reader);
        self.introduce(now, id);
        Ok(id)
    }

    fn introduce(&mut self, now: Now, id: EntityId) {
        // The announcement is sent before any data, because peers drop data of unknown writers.
        self.announce_endpoint(now, id);
        self.match_local(now, id);
        self.plan_liveliness(now);
        self.heed_guard(now);
    }

    /// Removes an endpoint and announces the removal. Returns whether it existed.
    pub fn remove_endpoint(&mut self, now: Now, id: EntityId) -> bool {
        self.note_time(now);
        if id.is_builtin() || self.locals.data(id).is_none() {
            return false;
        }
        self.unmatch_local(now, id);
        self.links.forget_endpoint(id);
        self.timers.set(Timer::Endpoint(id), None);
        self.dispose_endpoint(now, id);
        self.locals.remove(id);
        self.plan_liveliness(now);
        if let Some(guard) = self.guard.as_deref_mut() {
            guard.forget_endpoint(Guid::new(self.config.prefix, id));
        }
        true
    }

    /// Sends a sample to all matched readers. `payload` includes the encapsulation header.
    pub fn write(
        &mut self,
        now: Now,
        id: EntityId,
        payload: Bytes,
        options: WriteOptions,
    ) -> Result<SequenceNumber, WriteError> {
        self.note_time(now);
        if id.is_builtin() {
            return Err(WriteError::UnknownWriter);
        }
        self.with_writer(now, id, |writer, links| writer.write(now, payload, options, links))
            .ok_or(WriteError::UnknownWriter)?
            .map_err(|_| {
                if let Some(local) = self.locals.writers.get_mut(&id) {
                    local.is_full = true;
                }
                WriteError::WindowFull
            })
    }

    /// Asserts that a writer with manual liveliness is alive, without a sample.
    pub fn assert_liveliness(&mut self, now: Now, writer: EntityId) {
        self.note_time(now);
        self.assert_manual_writer(now, writer);
    }

    /// Returns whether every matched reliable reader has acknowledged all samples.
    pub fn is_acknowledged(&self, writer: EntityId) -> bool {
        self.locals.writers.get(&writer).is_none_or(|local| local.machine.is_acknowledged())
    }

    /// Requests acknowledgements of all readers that have not acknowledged all samples.
    pub fn ask_for_acknowledgements(&mut self, now: Now, writer: EntityId) {
        self.note_time(now);
        self.with_writer(now, writer, |writer, links| writer.ask_all(now, links));
    }

    /// Announces the departure after everything that waits to be sent. Afterwards call only
    /// [`Participant::poll_transmit`] until it returns `None`.
    pub fn leave(&mut self, now: Now) {
        self.note_time(now);
        self.announce_departure(now);
        self.announcer.leave(&self.config.addresses, &self.peers);
        self.timers = Timers::new();
    }

    /// Asks the guard again about a waiting participant, or about all matches with a participant.
    pub fn reconsider(&mut self, now: Now, prefix: GuidPrefix) {
        self.note_time(now);
        self.admit(now, prefix);
        self.heed_guard(now);
    }

    /// Returns the endpoints that a local endpoint is matched with.
    pub fn matched(&self, id: EntityId) -> Vec<Guid> {
        self.locals.matched(id).into_iter().flatten().copied().collect()
    }

    /// Returns the endpoints of the other participants.
    pub fn remote_endpoints(&self) -> impl Iterator<Item = &EndpointData> {
        self.peers.iter().flat_map(|(_, peer)| peer.endpoints.values()).map(|remote| &remote.data)
    }

    pub fn remote_endpoint(&self, guid: Guid) -> Option<&EndpointData> {
        self.peers.endpoint(guid).map(|remote| &remote.data)
    }

    pub fn remote_participant(&self, prefix: GuidPrefix) -> Option<&ParticipantData> {
        self.peers.get(prefix).map(|peer| &peer.data)
    }

    pub fn remote_participants(&self) -> impl Iterator<Item = &ParticipantData> {
        self.peers.iter().map(|(_, peer)| &peer.data)
    }

    /// Returns the endpoints created by [`Participant::create_writer`] and [`Participant::create_reader`].
    pub fn own_endpoints(&self) -> impl Iterator<Item = &EndpointData> {
        self.locals.announced()
    }

    pub fn counters(&self) -> Counters {
        self.counters
    }

    fn next_key(&mut self) -> Result<u32, CreateError> {
        // Keys are not reused: a peer may still take the new endpoint for a removed one.
        let key = self.latest_key + 1;
        if key >= 1 << 24 {
            return Err(CreateError::TooMany);
        }
        self.latest_key = key;
        Ok(key)
    }

    fn reader_config(&self, guid: Guid, qos: Qos) -> ReaderConfig {
        let Limits { max_sample_size, max_open_bytes, .. } = self.config.limits;
        ReaderConfig { guid, qos, max_sample_size, max_open_bytes }
    }

    /// Creates the builtin endpoints, which announce the endpoints of the user.
    fn create_builtin_endpoints(&mut self) {
        let prefix = self.config.prefix;
        let qos = |history| Qos {
            reliability: Reliability::Reliable,
            durability: Durability::TransientLocal,
            history,
            ..Qos::writer_default()
        };
        let volatile = |reliability| Qos { reliability, history: History::KeepAll, ..Qos::writer_default() };
        // What cannot be sent in this time is sent again by the handshake.
        let lifespan = Some(HANDSHAKE_LIFESPAN);
        let announcing = |builtin: &Builtin| (builtin.writer, builtin.reader, qos(builtin.history()));
        let channels = [
            (Channel::Stateless, Qos { lifespan, ..volatile(Reliability::BestEffort) }),
            (Channel::Volatile, volatile(Reliability::Reliable)),
        ];
        let channels = channels.map(|(channel, qos)| (channel.ends().0, channel.ends().1, qos));
        let is_guarded = self.guard.is_some();
        let plain = BUILTIN.iter().map(announcing);
        let secure = BUILTIN_OF_SECURITY.iter().map(announcing).chain(channels).filter(|_| is_guarded);
        for (writer, reader, qos) in plain.chain(secure) {
            let config = EndpointConfig::new("", "", qos.clone());
            let guid = Guid::new(prefix, writer);
            // Announcements are never refused, however slow the other participants are.
            let config_of_writer =
                WriterConfig { guid, qos: qos.clone(), send_window: usize::MAX, send_window_bytes: u64::MAX };
            self.locals.add_writer(self.endpoint_data(writer, &config), Writer::new(config_of_writer));
            let mut config_of_reader =
                self.reader_config(Guid::new(prefix, reader), Qos { history: History::KeepAll, ..qos });
            if Channel::of_reader(reader).is_some() {
                config_of_reader.max_sample_size = MOST_BYTES_ON_CHANNEL;
                config_of_reader.max_open_bytes = 16 * MOST_BYTES_ON_CHANNEL as usize;
            }
            self.locals.add_reader(self.endpoint_data(reader, &config), Reader::new(config_of_reader));
        }
    }

    fn announceable(
        &mut self,
        now: Now,
        id: EntityId,
        config: &EndpointConfig,
    ) -> Result<EndpointData, CreateError> {
        let mut data = self.endpoint_data(id, config);
        if let Some(guard) = self.guard.as_deref_mut() {
            guard.complete_endpoint(now, &mut data)?;
        }
        let mut payload = Vec::new();
        data.emit(&mut payload);
        if EndpointData::parse(&payload).is_err() { Err(CreateError::Overlong) } else { Ok(data) }
    }

    fn endpoint_data(&self, id: EntityId, config: &EndpointConfig) -> EndpointData {
        EndpointData {
            guid: Guid::new(self.config.prefix, id),
            topic: config.topic.clone(),
            type_name: config.type_name.clone(),
            qos: config.qos.clone(),
            unicast: Vec::new(),
            multicast: Vec::new(),
            user_data: config.user_data.to_vec(),
            expects_inline_qos: false,
            security: None,
        }
    }

    /// Detects that the process was suspended.
    pub(super) fn note_time(&mut self, now: Now) {
        let pause = now.steady.saturating_duration_since(self.latest_call);
        self.latest_call = self.latest_call.max(now.steady);
        if pause > self.config.announcement_period + SUSPENSION {
            self.grace_until = now.steady + self.config.lease.min(self.config.announcement_period * 4);
            self.announcer.hurry(now);
            self.timers.set(Timer::Announcement, self.announcer.next());
        }
    }

    /// Calls a writer and handles the consequences.
    pub(super) fn with_writer<T>(
        &mut self,
        now: Now,
        id: EntityId,
        call: impl FnOnce(&mut Writer, &mut Links) -> T,
    ) -> Option<T> {
        let local = self.locals.writers.get_mut(&id)?;
        let result = call(&mut local.machine, &mut self.links);
        self.follow_up(now, id);
        Some(result)
    }

    /// Handles the consequences of a call of a writer.
    pub(super) fn follow_up(&mut self, now: Now, id: EntityId) {
        while let Some(local) = self.locals.writers.get_mut(&id) {
            let Some(event) = local.machine.poll_event() else {
                if local.is_full && local.machine.can_write(now, &self.links) {
                    local.is_full = false;
                    self.events.push_back(Event::WindowOpen { writer: id });
                }
                let timeout = local.machine.next_timeout();
                return self.set_timer(now, id, timeout);
            };
            self.take_from_writer(id, event);
        }
    }

    /// Sets the timer of an endpoint to its next timeout.
    pub(super) fn set_timer(&mut self, now: Now, id: EntityId, timeout: Option<Instant>) {
        // Never immediately: time must pass between two calls, whatever the endpoint requests.
        let soonest = now.steady + SHORTEST_TIMEOUT;
        self.timers.set(Timer::Endpoint(id), timeout.map(|at| at.max(soonest)));
    }

    /// Calls a reader and handles the consequences.
    pub(super) fn with_reader(
        &mut self,
        now: Now,
        id: EntityId,
        call: impl FnOnce(&mut Reader, &mut Vec<Received>, &mut Links),
    ) {
        let Some(local) = self.locals.readers.get_mut(&id) else { return };
        let mut received = std::mem::take(&mut self.received);
        call(&mut local.machine, &mut received, &mut self.links);
        let timeout = local.machine.next_timeout();
        self.set_timer(now, id, timeout);
        for item in received.drain(..) {
            self.take_from_reader(now, id, item);
        }
        self.received = received;
    }

    pub(super) fn fault(&mut self, now: Now, fault: Fault, from: SocketAddrV4) {
        if let Some(count) = self.warnings.count(&mut self.counters, fault, now.steady) {
            self.events.push_back(Event::Warning { fault, from, count });
        }
    }
}
