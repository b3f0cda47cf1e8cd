//! The announcements of this participant that wait, and when the next ones are due.

use std::{
    collections::VecDeque,
    net::SocketAddrV4,
    time::{Duration, Instant},
};

use crate::{
    protocol::{Addresses, Config, Guard, Now, peers::Peers},
    wire::{
        BuiltinEndpoints, Data, EntityId, Guid, GuidPrefix, Header, InlineQos, MessageBuilder,
        ParticipantData, Payload, SequenceNumber, Timestamp, VendorId,
    },
};

/// Number of initial announcements in quick succession, since some may be lost.
const FIRST: u32 = 5;
const FIRST_PERIOD: Duration = Duration::from_millis(100);

/// A farewell is not acknowledged, so it is sent several times.
const FAREWELLS: usize = 3;

/// Longest datagram of an announcement; to other hosts it may be fragmented by IP.
const MAX_LEN: usize = 8 * 1024;

/// A datagram to be sent.
#[derive(Debug, Clone, Copy)]
pub(super) struct Announcement {
    pub(super) to: SocketAddrV4,
    /// The addressed participant, if it is for one only.
    pub(super) peer: Option<GuidPrefix>,
    kind: Kind,
}

#[derive(Debug, Clone, Copy)]
enum Kind {
    Presence,
    Farewell(SequenceNumber),
}

/// The announcements of this participant and their schedule.
#[derive(Debug)]
pub(crate) struct Announcer {
    payload: Vec<u8>,
    /// Changes only with the content: a repetition is not a new sample.
    number: SequenceNumber,
    /// Number of remaining initial announcements.
    first: u32,
    next: Option<Instant>,
    queue: VecDeque<Announcement>,
    is_leaving: bool,
}

impl Announcer {
    pub(crate) fn new(config: &Config, guard: Option<&mut (dyn Guard + 'static)>, now: Now) -> Self {
        let is_heard = !config.addresses.announce_to.is_empty();
        Self {
            payload: payload(config, guard),
            number: SequenceNumber::FIRST,
            first: FIRST,
            next: is_heard.then_some(now.steady),
            queue: VecDeque::new(),
            is_leaving: false,
        }
    }

    pub(crate) fn next(&self) -> Option<Instant> {
        self.next
    }

    /// What is announced about this participant.
    pub(super) fn payload(&self) -> &[u8] {
        &self.payload
    }

    pub(crate) fn is_leaving(&self) -> bool {
        self.is_leaving
    }

    /// Restarts the initial announcements.
    pub(crate) fn hurry(&mut self, now: Now) {
        self.first = FIRST;
        self.next = self.next.map(|_| now.steady);
    }

    /// Replaces announcements by farewells, after which nothing is announced any more.
    pub(crate) fn leave(&mut self, addresses: &Addresses, peers: &Peers) {
        self.is_leaving = true;
        self.queue.clear();
        let kind = Kind::Farewell(self.number.next());
        for _ in 0..FAREWELLS {
            for to in &addresses.announce_to {
                self.queue.push_back(Announcement { to: *to, peer: None, kind });
            }
            for (prefix, peer) in peers.iter() {
                if let Some(to) = addresses.choose(&peer.data.metatraffic_unicast, peer.source)
                    && !addresses.announce_to.contains(&to)
                {
                    self.queue.push_back(Announcement { to, peer: Some(prefix), kind });
                }
            }
        }
    }

    /// Starts the next round of announcements to the configured addresses.
    pub(super) fn start_round(&mut self, config: &Config, now: Now) {
        let usual = config.announcement_period.max(FIRST_PERIOD);
        let period = if self.first > 1 { FIRST_PERIOD } else { usual };
        self.first = self.first.saturating_sub(1);
        self.next = Some(now.steady + period);
        // Announcements left from the last time would be sent twice.
        self.queue.retain(|waiting| waiting.peer.is_some());
        for to in &config.addresses.announce_to {
            self.queue.push_back(Announcement { to: *to, peer: None, kind: Kind::Presence });
        }
    }

    /// Starts to announce changed addresses.
    pub(super) fn start_anew(
        &mut self,
        config: &Config,
        guard: Option<&mut (dyn Guard + 'static)>,
        now: Now,
    ) {
        self.payload = payload(config, guard);
        self.number = self.number.next();
        self.next = (!config.addresses.announce_to.is_empty()).then_some(now.steady);
        self.hurry(now);
    }

    /// Announces this participant to another one at that address.
    pub(super) fn announce_to(&mut self, to: SocketAddrV4, peer: GuidPrefix) {
        self.enqueue(to, peer, Kind::Presence);
    }

    /// Sends a farewell to another participant at that address.
    pub(super) fn part_from(&mut self, to: SocketAddrV4, peer: GuidPrefix) {
        self.enqueue(to, peer, Kind::Farewell(self.number.next()));
        // Later announcements must have higher numbers than the farewell.
        self.number = self.number.next().next();
    }

    /// Removes the announcement that is to be sent next.
    pub(super) fn pop(&mut self) -> Option<Announcement> {
        self.queue.pop_front()
    }

    /// Writes the message of an announcement. Returns whether it fits into a datagram.
    pub(super) fn emit(
        &self,
        announcement: Announcement,
        own: GuidPrefix,
        now: Now,
        datagram: &mut Vec<u8>,
    ) -> bool {
        let Announcement { peer, kind, .. } = announcement;
        datagram.clear();
        let mut builder = MessageBuilder::new(datagram, MAX_LEN, Header::ours(own));
        builder.info_destination(peer.unwrap_or(GuidPrefix::UNKNOWN));
        builder.info_timestamp(Some(Timestamp::from_nanos(now.wall_ns)));
        let (number, inline_qos, payload) = match kind {
            Kind::Presence => (self.number, InlineQos::default(), Payload::Data(&self.payload)),
            Kind::Farewell(number) => {
                (number, InlineQos::removal(Guid::new(own, EntityId::PARTICIPANT)), Payload::None)
            }
        };
        let (reader, writer) = (EntityId::UNKNOWN, EntityId::SPDP_WRITER);
        builder.data(&Data { reader, writer, number, inline_qos, payload })
    }

    fn enqueue(&mut self, to: SocketAddrV4, prefix: GuidPrefix, kind: Kind) {
        if !self.is_leaving {
            self.queue.push_back(Announcement { to, peer: Some(prefix), kind });
        }
    }
}

fn payload(config: &Config, guard: Option<&mut (dyn Guard + 'static)>) -> Vec<u8> {
    let addresses = &config.addresses;
    let mut payload = Vec::new();
    let mut data = ParticipantData {
        prefix: config.prefix,
        version: Header::ours(config.prefix).version,
        vendor: VendorId::OURS,
        metatraffic_unicast: addresses.metatraffic_unicast.clone(),
        metatraffic_multicast: addresses.metatraffic_multicast.clone(),
        default_unicast: addresses.default_unicast.clone(),
        default_multicast: Vec::new(),
        lease: Some(config.lease),
        builtin_endpoints: BuiltinEndpoints::OURS,
        user_data: config.user_data.to_vec(),
        name: config.name.clone(),
        domain_id: Some(config.domain_id),
        domain_tag: String::new(),
        expects_inline_qos: false,
        receive_buffer: config.receive_buffer,
        security: None,
    };
    if let Some(guard) = guard {
        guard.complete_participant(&mut data);
    }
    data.emit(&mut payload);
    payload
}
