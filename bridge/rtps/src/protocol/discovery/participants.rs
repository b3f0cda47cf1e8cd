//! The other participants: found, followed, lost (SPDP, section 8.5.3).

use std::{net::SocketAddrV4, time::Duration};

use crate::{
    protocol::{
        Admission, Departure, Destination, Event, Fault, LinkId, LinkOptions, MatchedReader, MatchedWriter,
        Now, Participant,
        counters::Account,
        participant::{OWN_HOST_DATAGRAM, REMOTE_DATAGRAM, Timer},
        peers::Peer,
    },
    wire::{
        BuiltinEndpoints, Data, EntityId, Guid, GuidPrefix, ParticipantData, Payload, StatusInfo, VendorId,
    },
};

/// Lease of a participant that announces none (section 9.6.4.2, as Cyclone DDS reads it).
const DEFAULT_LEASE: Duration = Duration::from_secs(100);

/// Bytes of a datagram that are no payload of a fragment, at most.
const FRAGMENT_OVERHEAD: usize = 200;

/// Addresses that the endpoints of one participant may have, those of the participant among them.
const MAX_LINKS: usize = 16;

/// Payload of a fragment to a peer of this host: three datagrams of it fit in the smallest receive buffer Linux gives.
const OWN_HOST_FRAGMENT: u16 = 32_768;

/// Builtin endpoints: the writer, the reader, and the bits by which a participant says that it has them.
const BUILTIN: [(EntityId, EntityId, u32, u32); 3] = [
    (
        EntityId::SEDP_PUBLICATIONS_WRITER,
        EntityId::SEDP_PUBLICATIONS_READER,
        BuiltinEndpoints::SEDP_PUBLICATIONS_WRITER,
        BuiltinEndpoints::SEDP_PUBLICATIONS_READER,
    ),
    (
        EntityId::SEDP_SUBSCRIPTIONS_WRITER,
        EntityId::SEDP_SUBSCRIPTIONS_READER,
        BuiltinEndpoints::SEDP_SUBSCRIPTIONS_WRITER,
        BuiltinEndpoints::SEDP_SUBSCRIPTIONS_READER,
    ),
    (EntityId::WLP_WRITER, EntityId::WLP_READER, BuiltinEndpoints::WLP_WRITER, BuiltinEndpoints::WLP_READER),
];

impl Participant {
    /// What a participant says of itself.
    pub(in crate::protocol) fn hear_of_participant(
        &mut self,
        now: Now,
        source: GuidPrefix,
        from: SocketAddrV4,
        length: usize,
        announcement: &Data<'_>,
    ) {
        if announcement.inline_qos.status.is_some_and(StatusInfo::is_removal) {
            let gone = announcement.inline_qos.removed(announcement.payload);
            // Without a name it can only mean itself.
            if gone.is_none_or(|guid| guid.prefix == source) {
                self.remove_peer(now, source, Departure::Disposed);
            } else {
                self.fault(now, Fault::ForeignEndpoint, from);
            }
            return;
        }
        let Payload::Data(payload) = announcement.payload else {
            return self.fault(now, Fault::MalformedDiscovery, from);
        };
        let data = match ParticipantData::parse(payload) {
            Ok(data) => data,
            Err(_) => return self.fault(now, Fault::MalformedDiscovery, from),
        };
        if data.prefix != source {
            self.fault(now, Fault::ForeignEndpoint, from);
        } else if data.domain_id.is_some_and(|id| id != self.config.domain_id) || !data.domain_tag.is_empty()
        {
            // Another domain on the same port: none of ours, and no fault.
        } else if self.peers.get(source).is_some() {
            self.refresh_peer(now, from, data);
        } else {
            self.meet(now, from, length, data);
        }
    }

    fn meet(&mut self, now: Now, from: SocketAddrV4, length: usize, data: ParticipantData) {
        let prefix = data.prefix;
        let addresses = &self.config.addresses;
        let metatraffic = addresses.choose(&data.metatraffic_unicast, *from.ip());
        let default = addresses.choose(&data.default_unicast, *from.ip());
        let Some(metatraffic) = metatraffic else { return self.fault(now, Fault::NoAddress, from) };
        // Those without an address for samples have no endpoints of a user.
        let default = default.unwrap_or(metatraffic);
        if self.peers.len() >= self.config.limits.participants {
            self.fault(now, Fault::TooManyParticipants, from);
            let Some(expendable) = self.peers.expendable() else { return };
            self.remove_peer(now, expendable, Departure::Crowded);
        }
        let admission = match self.guard.as_deref_mut() {
            Some(guard) => guard.admit_participant(&data),
            None => Admission::Admit,
        };
        if admission == Admission::Refuse {
            return self.fault(now, Fault::Rejected, from);
        }
        let mut account = Account::default();
        account.received(length);
        let buffer = data.receive_buffer.filter(|_| data.vendor == VendorId::OURS);
        let mut peer = Peer {
            source: *from.ip(),
            is_own_host: self.config.addresses.is_own_host(*from.ip()),
            admission: Admission::Wait,
            metatraffic: self.own,
            default: self.own,
            links: Vec::new(),
            account,
            withheld: Vec::new(),
            heard: now.steady,
            told: now.steady,
            endpoints: Default::default(),
            data,
        };
        // The buffer is that of the socket for samples; discovery is small.
        peer.metatraffic = self.open_link(&mut peer, metatraffic, None);
        peer.default = self.open_link(&mut peer, default, buffer);
        self.peers.insert(prefix, peer);
        self.events.push_back(Event::ParticipantFound { remote: prefix });
        self.arm_lease(now, prefix);
        self.announce_to(now, prefix);
        if admission == Admission::Admit {
            self.let_in(now, prefix);
        }
    }

    /// Asks the guard again; what it admits by now is matched.
    pub(in crate::protocol) fn admit(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let was = peer.admission;
        let guids: Vec<_> = peer.endpoints.values().map(|remote| remote.data.guid).collect();
        let admission = match self.guard.as_deref_mut() {
            Some(guard) => guard.admit_participant(&peer.data),
            None => Admission::Admit,
        };
        match admission {
            Admission::Admit if was == Admission::Admit => {
                guids.into_iter().for_each(|guid| self.match_remote(now, guid));
            }
            Admission::Admit => self.let_in(now, prefix),
            Admission::Wait => {}
            Admission::Refuse => self.remove_peer(now, prefix, Departure::Refused),
        }
    }

    /// Connects the builtin endpoints: from here on the two exchange what endpoints they have.
    fn let_in(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.admission = Admission::Admit;
        let (link, theirs) = (peer.metatraffic, peer.data.builtin_endpoints);
        for (writer, reader, writer_bit, reader_bit) in BUILTIN {
            if theirs.has(writer_bit) {
                let guid = Guid::new(prefix, writer);
                self.locals.note_source(reader, guid);
                self.with_reader(now, reader, |reader, _, _| {
                    let matched = MatchedWriter {
                        guid,
                        is_reliable: true,
                        lifespan: None,
                        liveliness_lease: None,
                        link,
                        is_ours: false,
                    };
                    reader.match_writer(now, matched);
                });
            }
            if theirs.has(reader_bit) {
                let guid = Guid::new(prefix, reader);
                self.with_writer(now, writer, |writer, links| {
                    let matched = MatchedReader { guid, is_reliable: true, wants_history: true, link };
                    writer.match_reader(now, matched, links);
                });
            }
        }
    }

    fn refresh_peer(&mut self, now: Now, from: SocketAddrV4, data: ParticipantData) {
        let prefix = data.prefix;
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        let is_news = peer.data != data;
        if !peer.account.is_known() {
            // It may not have heard the answer: Fast DDS announces itself before it listens.
            self.announce_to(now, prefix);
        }
        if !is_news {
            return;
        }
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.source = *from.ip();
        peer.is_own_host = self.config.addresses.is_own_host(*from.ip());
        peer.data = data;
        self.arm_lease(now, prefix);
        self.readdress_peer(prefix);
    }

    /// Follows a change of our own addresses.
    pub(in crate::protocol) fn readdress(&mut self, now: Now) {
        let prefixes: Vec<_> = self.peers.iter().map(|(prefix, _)| prefix).collect();
        prefixes.into_iter().for_each(|prefix| self.readdress_peer(prefix));
        self.announce_anew(now);
    }

    /// Chooses anew where a peer is reached.
    fn readdress_peer(&mut self, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        let addresses = &self.config.addresses;
        let Some(metatraffic) = addresses.choose(&peer.data.metatraffic_unicast, peer.source) else { return };
        let default = addresses.choose(&peer.data.default_unicast, peer.source).unwrap_or(metatraffic);
        for (link, to) in [(peer.metatraffic, metatraffic), (peer.default, default)] {
            for (address, known) in &mut peer.links {
                if *known == link && *address != to {
                    *address = to;
                    let (max_datagram, _) = sizes(peer.is_own_host, self.config.fragment_size);
                    self.links.redirect(link, Destination::Unicast(to), max_datagram);
                }
            }
        }
    }

    /// The link to an address of a peer.
    fn open_link(&mut self, peer: &mut Peer, to: SocketAddrV4, receive_buffer: Option<u32>) -> LinkId {
        if let Some((_, link)) = peer.links.iter().find(|(address, _)| *address == to) {
            return *link;
        }
        let (max_datagram, fragment_size) = sizes(peer.is_own_host, self.config.fragment_size);
        let destination = Destination::Unicast(to);
        let peer_prefix = peer.data.prefix;
        let link = self.links.open(LinkOptions {
            destination,
            peer: peer_prefix,
            max_datagram,
            fragment_size,
            receive_buffer,
        });
        peer.links.push((to, link));
        link
    }

    /// The link to an endpoint: that of its participant, unless it announced an address of its own.
    pub(in crate::protocol) fn link_to(&mut self, remote: Guid) -> Option<LinkId> {
        if remote.prefix == self.config.prefix {
            return Some(self.own);
        }
        let peer = self.peers.get(remote.prefix)?;
        let (default, source) = (peer.default, peer.source);
        let unicast = &peer.endpoints.get(&remote.entity)?.data.unicast;
        let Some(to) = self.config.addresses.choose(unicast, source) else { return Some(default) };
        if let Some((_, link)) = peer.links.iter().find(|(address, _)| *address == to) {
            return Some(*link);
        }
        // Bounded, since a link costs more than an announcement of one.
        if peer.links.len() >= MAX_LINKS {
            return Some(default);
        }
        let mut peer = self.peers.remove(remote.prefix)?;
        let link = self.open_link(&mut peer, to, None);
        self.peers.insert(remote.prefix, peer);
        Some(link)
    }

    fn arm_lease(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let lease = peer.data.lease.map(|lease| lease.max(Duration::from_millis(100)));
        // An infinite lease would keep a participant that was killed for ever.
        let lease = lease.unwrap_or(DEFAULT_LEASE);
        let end = peer.heard.checked_add(lease).unwrap_or(now.steady + DEFAULT_LEASE).max(self.grace_until);
        self.timers.set(Timer::Lease(prefix), Some(end.max(now.steady + Duration::from_millis(1))));
    }

    /// Messages do not move the timer, for there are many; so it looks when it fires whether there were any.
    pub(in crate::protocol) fn check_lease(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let lease = peer.data.lease.unwrap_or(DEFAULT_LEASE);
        let is_over =
            now.steady.saturating_duration_since(peer.heard) >= lease && now.steady >= self.grace_until;
        if !is_over {
            return self.arm_lease(now, prefix);
        }
        // If it still lives it takes us for one that knows it, and would not say again what it told us already.
        if peer.account.is_known() {
            self.part_from(prefix);
        }
        self.remove_peer(now, prefix, Departure::LeaseRanOut);
    }

    /// Forgets a participant with all it has.
    pub(in crate::protocol) fn remove_peer(&mut self, now: Now, prefix: GuidPrefix, reason: Departure) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let guids: Vec<_> = peer.endpoints.values().map(|remote| remote.data.guid).collect();
        guids.into_iter().for_each(|guid| self.remove_remote(now, guid));
        for (writer, reader, ..) in BUILTIN {
            let guid = Guid::new(prefix, writer);
            self.locals.forget_source(reader, guid);
            self.with_reader(now, reader, |reader, _, _| reader.unmatch_writer(guid));
            self.with_writer(now, writer, |writer, links| {
                writer.unmatch_reader(now, Guid::new(prefix, reader), links)
            });
        }
        self.timers.set(Timer::Lease(prefix), None);
        for (_, link) in self.peers.remove(prefix).into_iter().flat_map(|peer| peer.links) {
            self.links.close(link);
        }
        self.events.push_back(Event::ParticipantLeft { remote: prefix, reason });
    }
}

/// Longest datagram to a peer, and the payload of a fragment.
fn sizes(is_own_host: bool, fragment_size: u16) -> (usize, u16) {
    if is_own_host {
        return (OWN_HOST_DATAGRAM, OWN_HOST_FRAGMENT.max(fragment_size));
    }
    (REMOTE_DATAGRAM.max(usize::from(fragment_size) + FRAGMENT_OVERHEAD), fragment_size)
}
