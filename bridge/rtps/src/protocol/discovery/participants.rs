//! Discovery and removal of other participants (SPDP, section 8.5.3).

use std::{
    net::{Ipv4Addr, SocketAddrV4},
    time::Duration,
};

use super::{
    BUILTIN, BUILTIN_OF_SECURITY, Builtin,
    builtin::{self},
};
use crate::{
    protocol::{
        Admission, Channel, Departure, Destination, Event, Fault, MatchedReader, MatchedWriter, Now,
        Participant, Sample,
        account::Account,
        participant::Timer,
        peers::{Change, Doubtful, Peer},
    },
    wire::{Data, Guid, GuidPrefix, ParticipantData, Payload, StatusInfo},
};

/// Lease of a participant that announces none (section 9.6.4.2, as interpreted by Cyclone DDS).
const DEFAULT_LEASE: Duration = Duration::from_secs(100);

/// An unknown participant is answered again after this time: without it, two that do not know each other
/// would answer each other's answers.
const REPEATED: Duration = Duration::from_millis(50);

/// How long a participant may take to answer that it is still there.
const ANSWER: Duration = Duration::from_millis(100);

/// A participant that is still there answers more than once; one answer may have been on its way when the
/// participant left.
const ANSWERS: u32 = 1;

impl Participant {
    /// Handles the announcement of a participant.
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
            // Without a GUID it can only refer to the sender.
            if gone.is_none_or(|guid| guid.prefix == source) {
                self.hear_farewell(now, source);
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
            // Another domain on the same port: ignored, but not a fault.
        } else if self.peers.get(source).is_some() {
            self.refresh_peer(now, from, length, data);
        } else {
            self.meet(now, from, length, data);
        }
    }

    /// Handles what an authenticated participant announces with protection: changed data, or its departure.
    pub(in crate::protocol) fn hear_of_change(&mut self, now: Now, sample: &Sample) {
        let prefix = sample.writer.prefix;
        let Some(peer) = self.peers.get(prefix) else { return };
        let (source, from) = (peer.source, SocketAddrV4::new(peer.source, 0));
        if sample.inline_qos.status.is_some_and(StatusInfo::is_removal) {
            return self.remove_peer(now, prefix, Departure::Disposed);
        }
        match ParticipantData::parse(&sample.payload) {
            // The guard knows what it announced in clear about its protection.
            Ok(data) if data.prefix == prefix => {
                let data = ParticipantData { security: peer.data.security.clone(), ..data };
                if peer.data != data {
                    self.relocate(now, prefix, data, source, sample.payload.len());
                }
            }
            Ok(_) => self.fault(now, Fault::ForeignEndpoint, from),
            Err(_) => self.fault(now, Fault::MalformedDiscovery, from),
        }
    }

    /// Handles the farewell of a participant.
    fn hear_farewell(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        if peer.account.is_known() {
            self.doubt(now, prefix, Change::Farewell, 0);
        } else {
            self.remove_peer(now, prefix, Departure::Disposed);
        }
    }

    /// Asks a participant whether it is still there before a change in its name is applied, which anybody can
    /// announce.
    fn doubt(&mut self, now: Now, prefix: GuidPrefix, change: Change, answers: u32) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        if peer.doubtful.is_some() {
            return;
        }
        peer.doubtful = Some(Doubtful { change, asked: now.steady, answers });
        self.timers.set(Timer::Doubt(prefix), Some(now.steady + ANSWER));
        for Builtin { writer, reader, .. } in builtin::all() {
            let guid = Guid::new(prefix, reader);
            self.with_writer(now, writer, |writer, links| writer.ask(now, guid, links));
        }
    }

    /// Applies a doubtful change if the participant no longer answers.
    pub(in crate::protocol) fn resolve_doubt(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        let Some(Doubtful { change, asked, answers }) = peer.doubtful.take() else { return };
        if peer.answered > asked {
            if answers < ANSWERS {
                self.doubt(now, prefix, change, answers + 1);
            }
            return;
        }
        match change {
            Change::Farewell => self.remove_peer(now, prefix, Departure::Disposed),
            Change::Move(data, source, length) => self.relocate(now, prefix, *data, source, length),
        }
    }

    fn meet(&mut self, now: Now, from: SocketAddrV4, length: usize, data: ParticipantData) {
        let prefix = data.prefix;
        let Some(route) = self.route(&data, *from.ip()) else {
            return self.fault(now, Fault::NoAddress, from);
        };
        let admission = match self.guard.as_deref_mut() {
            Some(guard) => guard.admit_participant(now, &data),
            None => Admission::Admit,
        };
        if admission == Admission::Refuse {
            return self.fault(now, Fault::Rejected, from);
        }
        if self.peers.len() >= self.config.limits.participants {
            self.fault(now, Fault::TooManyParticipants, from);
            let Some(expendable) = self.peers.expendable(*route.metatraffic.ip()) else {
                return self.forget_in_guard(prefix);
            };
            self.remove_peer(now, expendable, Departure::Crowded);
        }
        let mut account = Account::default();
        account.received(length);
        if admission == Admission::Wait {
            account.permit_handshake();
        }
        let mut peer = Peer {
            source: *from.ip(),
            host: *route.metatraffic.ip(),
            is_own_host: self.config.addresses.is_own_host(*from.ip()),
            admission: Admission::Wait,
            metatraffic: self.own,
            default: self.own,
            links: Vec::new(),
            account,
            is_closed: false,
            withheld: Vec::new(),
            heard: now.steady,
            answered: now.steady,
            doubtful: None,
            audited: None,
            announced: now.steady,
            endpoints: Default::default(),
            data,
        };
        // The announced buffer is that of the socket for samples; discovery data are small.
        let buffer = peer.data.receive_buffer.filter(|_| peer.is_ours());
        peer.metatraffic = self.open_link(&mut peer, route.metatraffic, None);
        peer.default = self.open_link(&mut peer, route.default, buffer);
        self.choose_numbers(prefix, peer.metatraffic);
        self.peers.insert(prefix, peer);
        self.events.push_back(Event::ParticipantFound { remote: prefix });
        self.arm_lease(now, prefix);
        self.announce_to(now, prefix);
        self.open_channel(now, Channel::Stateless, prefix);
        if admission == Admission::Admit {
            self.let_in(now, prefix);
        }
    }

    /// Asks the guard again and matches what it now admits.
    pub(in crate::protocol) fn admit(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let was = peer.admission;
        let guids: Vec<_> = peer.endpoints.values().map(|remote| remote.data.guid).collect();
        let admission = match self.guard.as_deref_mut() {
            Some(guard) => guard.admit_participant(now, &peer.data),
            None => Admission::Admit,
        };
        match admission {
            Admission::Admit if was == Admission::Admit => {
                guids.into_iter().for_each(|guid| self.match_remote(now, guid));
            }
            Admission::Admit => {
                if self.is_authenticated(prefix) {
                    // The handshake proves that it receives at its address.
                    self.validate(now, prefix);
                }
                self.let_in(now, prefix);
            }
            Admission::Wait => {}
            Admission::Refuse => {
                // If it has not forgotten this participant, it would not begin anew.
                self.part_from(prefix);
                self.remove_peer(now, prefix, Departure::Refused);
            }
        }
    }

    /// Matches the builtin endpoints: from now on the two participants exchange their endpoints.
    fn let_in(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.admission = Admission::Admit;
        let (link, theirs, vendor) = (peer.metatraffic, peer.data.builtin_endpoints, peer.data.vendor);
        let (is_authenticated, numbers) = (self.is_authenticated(prefix), self.numbers_of(prefix, None));
        if is_authenticated {
            self.open_channel(now, Channel::Volatile, prefix);
        }
        let secure = BUILTIN_OF_SECURITY.into_iter().filter(|_| is_authenticated);
        for Builtin { writer, reader, writer_bit, reader_bit } in BUILTIN.into_iter().chain(secure) {
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
                        numbers,
                        vendor,
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

    fn refresh_peer(&mut self, now: Now, from: SocketAddrV4, length: usize, data: ParticipantData) {
        let prefix = data.prefix;
        let is_protected = self.hears_only_protected(prefix);
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        if is_protected && !peer.data.builtin_endpoints.has(data.builtin_endpoints.0) {
            // What somebody else announced in its name before may have lacked some.
            peer.data.builtin_endpoints.0 |= data.builtin_endpoints.0;
            self.admit(now, prefix);
            self.let_in(now, prefix);
        }
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        let data = if is_protected {
            // Only its addresses may change without protection, if it no longer answers at the old ones.
            let addresses = data;
            ParticipantData {
                metatraffic_unicast: addresses.metatraffic_unicast,
                default_unicast: addresses.default_unicast,
                ..peer.data.clone()
            }
        } else {
            data
        };
        let is_news = peer.data != data;
        let is_known = peer.account.is_known();
        let is_repeated = now.steady.saturating_duration_since(peer.announced) >= REPEATED;
        if !is_known && is_repeated {
            // The peer may have missed the answer: Fast DDS announces itself before it receives.
            self.announce_to(now, prefix);
        }
        if !is_news {
            return;
        }
        if is_known && self.would_move(prefix, &data, *from.ip()) {
            return self.doubt(now, prefix, Change::Move(Box::new(data), *from.ip(), length), 0);
        }
        self.relocate(now, prefix, data, *from.ip(), length);
    }

    /// Returns whether other data would change the host to which messages for a participant are sent.
    fn would_move(&self, prefix: GuidPrefix, data: &ParticipantData, source: Ipv4Addr) -> bool {
        let Some(peer) = self.peers.get(prefix) else { return false };
        let Some(route) = self.route(data, source) else { return false };
        let current = [peer.metatraffic, peer.default].map(|link| self.links.destination(link));
        current != [route.metatraffic, route.default].map(|to| Some(Destination::Unicast(to)))
    }

    /// Applies changed data of a participant. A new address has to be validated.
    fn relocate(
        &mut self,
        now: Now,
        prefix: GuidPrefix,
        data: ParticipantData,
        source: Ipv4Addr,
        length: usize,
    ) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.source = source;
        peer.is_own_host = self.config.addresses.is_own_host(source);
        peer.data = data;
        self.arm_lease(now, prefix);
        if !self.reroute(prefix) {
            return;
        }
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.account = Account::default();
        peer.account.received(length);
        let is_admitted = peer.admission == Admission::Admit;
        let metatraffic = peer.metatraffic;
        for (_, link) in peer.links.clone() {
            self.links.restrict(link, true);
        }
        self.choose_numbers(prefix, metatraffic);
        self.announce_to(now, prefix);
        if !is_admitted {
            return;
        }
        for Builtin { writer, reader, .. } in builtin::all() {
            let guid = Guid::new(prefix, reader);
            self.with_writer(now, writer, |writer, links| writer.unmatch_reader(now, guid, links));
        }
        // This requests acknowledgements.
        self.let_in(now, prefix);
    }

    fn arm_lease(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let lease = self.lease_of(peer).max(Duration::from_millis(100));
        let end = peer.heard.checked_add(lease).unwrap_or(now.steady + DEFAULT_LEASE).max(self.grace_until);
        self.timers.set(Timer::Lease(prefix), Some(end.max(now.steady + Duration::from_millis(1))));
    }

    /// How long a participant is kept after its last message.
    fn lease_of(&self, peer: &Peer) -> Duration {
        // With an infinite lease, a killed participant would never be removed.
        let lease = peer.data.lease.unwrap_or(DEFAULT_LEASE);
        // One that still keeps this participant would not repeat the handshake.
        let least = if self.is_authenticated(peer.data.prefix) { self.config.lease } else { Duration::ZERO };
        lease.max(least)
    }

    /// Checks the lease of a participant. Messages do not reset the timer, because there are many; instead it
    /// is checked when it fires.
    pub(in crate::protocol) fn check_lease(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let lease = self.lease_of(peer);
        let is_over =
            now.steady.saturating_duration_since(peer.heard) >= lease && now.steady >= self.grace_until;
        if !is_over {
            return self.arm_lease(now, prefix);
        }
        // A peer that is still alive assumes that it is known here and would not repeat what it has sent.
        if peer.account.is_known() {
            self.part_from(prefix);
        }
        self.remove_peer(now, prefix, Departure::LeaseRanOut);
    }

    /// Removes a participant with all its endpoints.
    pub(in crate::protocol) fn remove_peer(&mut self, now: Now, prefix: GuidPrefix, reason: Departure) {
        let Some(peer) = self.peers.get(prefix) else { return };
        let guids: Vec<_> = peer.endpoints.values().map(|remote| remote.data.guid).collect();
        guids.into_iter().for_each(|guid| self.remove_remote(now, guid));
        self.close_channels(now, prefix);
        for Builtin { writer, reader, .. } in builtin::all() {
            let guid = Guid::new(prefix, writer);
            self.locals.forget_source(reader, guid);
            self.with_reader(now, reader, |reader, _, _| reader.unmatch_writer(guid));
            self.with_writer(now, writer, |writer, links| {
                writer.unmatch_reader(now, Guid::new(prefix, reader), links)
            });
        }
        for timer in [Timer::Lease(prefix), Timer::Doubt(prefix), Timer::Audit(prefix), Timer::Closed(prefix)]
        {
            self.timers.set(timer, None);
        }
        for (_, link) in self.peers.remove(prefix).into_iter().flat_map(|peer| peer.links) {
            self.links.close(link);
        }
        self.forget_in_guard(prefix);
        self.events.push_back(Event::ParticipantLeft { remote: prefix, reason });
    }

    fn forget_in_guard(&mut self, prefix: GuidPrefix) {
        if let Some(guard) = self.guard.as_deref_mut() {
            guard.forget_participant(prefix);
        }
    }
}
