//! Announcement of this participant (SPDP, section 8.5.3).

use std::{
    collections::VecDeque,
    net::SocketAddrV4,
    time::{Duration, Instant},
};

use crate::{
    protocol::{Addresses, Config, Destination, Now, Participant, participant::Timer, peers::Peers},
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
struct Announcement {
    to: SocketAddrV4,
    /// The addressed participant, if it is for one only.
    peer: Option<GuidPrefix>,
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
    pub(crate) fn new(config: &Config, now: Now) -> Self {
        let is_heard = !config.addresses.announce_to.is_empty();
        Self {
            payload: payload(config),
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

    fn enqueue(&mut self, to: SocketAddrV4, prefix: GuidPrefix, kind: Kind) {
        if !self.is_leaving {
            self.queue.push_back(Announcement { to, peer: Some(prefix), kind });
        }
    }
}

fn payload(config: &Config) -> Vec<u8> {
    let addresses = &config.addresses;
    let mut payload = Vec::new();
    ParticipantData {
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
    }
    .emit(&mut payload);
    payload
}

impl Participant {
    /// Announces this participant to all others.
    pub(in crate::protocol) fn announce(&mut self, now: Now) {
        let announcer = &mut self.announcer;
        let usual = self.config.announcement_period.max(FIRST_PERIOD);
        let period = if announcer.first > 1 { FIRST_PERIOD } else { usual };
        announcer.first = announcer.first.saturating_sub(1);
        announcer.next = Some(now.steady + period);
        self.timers.set(Timer::Announcement, announcer.next);
        // Announcements left from the last time would be sent twice.
        announcer.queue.retain(|waiting| waiting.peer.is_some());
        let announce_to = &self.config.addresses.announce_to;
        for to in announce_to {
            announcer.queue.push_back(Announcement { to: *to, peer: None, kind: Kind::Presence });
        }
        // Multicast may not reach them, and an idle participant sends nothing else that shows that it is
        // alive.
        let often_enough = self.config.lease / 3;
        for (prefix, peer) in self.peers.iter_mut() {
            let to = self.links.destination(peer.metatraffic);
            if let Some(Destination::Unicast(to)) = to
                && now.steady.saturating_duration_since(peer.announced) >= often_enough
            {
                peer.announced = now.steady;
                if !announce_to.contains(&to) {
                    announcer.enqueue(to, prefix, Kind::Presence);
                }
            }
        }
    }

    /// Announces this participant to another one.
    pub(in crate::protocol) fn announce_to(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.announced = now.steady;
        if let Some(Destination::Unicast(to)) = self.links.destination(peer.metatraffic) {
            self.announcer.enqueue(to, prefix, Kind::Presence);
        }
    }

    /// Sends a farewell to one participant, so that it rediscovers this one with the next announcement.
    pub(in crate::protocol) fn part_from(&mut self, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        if let Some(Destination::Unicast(to)) = self.links.destination(peer.metatraffic) {
            self.announcer.enqueue(to, prefix, Kind::Farewell(self.announcer.number.next()));
            // Later announcements must have higher numbers than the farewell.
            self.announcer.number = self.announcer.number.next().next();
        }
    }

    /// Announces changed addresses.
    pub(in crate::protocol) fn announce_anew(&mut self, now: Now) {
        self.announcer.payload = payload(&self.config);
        self.announcer.number = self.announcer.number.next();
        self.announcer.next = (!self.config.addresses.announce_to.is_empty()).then_some(now.steady);
        self.announcer.hurry(now);
        self.timers.set(Timer::Announcement, self.announcer.next);
    }

    /// The next waiting announcement.
    pub(in crate::protocol) fn transmit_announcement(
        &mut self,
        now: Now,
        datagram: &mut Vec<u8>,
    ) -> Option<Destination> {
        while let Some(Announcement { to, peer, kind }) = self.announcer.queue.pop_front() {
            datagram.clear();
            let mut builder = MessageBuilder::new(datagram, MAX_LEN, Header::ours(self.config.prefix));
            builder.info_destination(peer.unwrap_or(GuidPrefix::UNKNOWN));
            builder.info_timestamp(Some(Timestamp::from_nanos(now.wall_ns)));
            let (number, inline_qos, payload) = match kind {
                Kind::Presence => {
                    (self.announcer.number, InlineQos::default(), Payload::Data(&self.announcer.payload))
                }
                Kind::Farewell(number) => {
                    let guid = Guid::new(self.config.prefix, EntityId::PARTICIPANT);
                    (number, InlineQos::removal(guid), Payload::None)
                }
            };
            let fits = builder.data(&Data {
                reader: EntityId::UNKNOWN,
                writer: EntityId::SPDP_WRITER,
                number,
                inline_qos,
                payload,
            });
            let prefix = peer.unwrap_or(GuidPrefix::UNKNOWN);
            let is_allowed =
                self.peers.get(prefix).is_none_or(|peer| peer.account.allowance() >= datagram.len());
            if fits && is_allowed && self.seal(prefix, datagram) {
                return Some(if to.ip().is_multicast() {
                    Destination::Multicast(to)
                } else {
                    Destination::Unicast(to)
                });
            }
        }
        None
    }
}
