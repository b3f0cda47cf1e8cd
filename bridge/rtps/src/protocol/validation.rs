//! Validation of the addresses of other participants.
//!
//! Anybody can announce a participant with the address of a third party, and send any message in its name. An
//! address is therefore validated by something that only its owner can know: the builtin writers send each
//! participant the same samples with other sequence numbers, which begin at an unpredictable one. The first
//! acknowledgement that continues these numbers proves that a heartbeat arrived at the address. Until then
//! the participant is sent announcements, heartbeats, acknowledgements and handshakes (which prove the
//! address as well) only, at most three times the bytes received from it (as in RFC 9000, section 8.1) and
//! one handshake, and no local writer matches its readers.

use std::{
    hash::{DefaultHasher, Hash, Hasher},
    net::{Ipv4Addr, SocketAddrV4},
    time::Duration,
};

use super::{Departure, LinkId, Now, Participant, participant::Timer, peers::Peer};
use crate::wire::{AckNack, EntityId, GuidPrefix, NackFragment, SequenceNumber, SequenceNumberSet};

/// The numbers begin at an unpredictable one of this many. Fast DDS takes time for each number that it skips.
const RANGE: u64 = 1 << 16;
/// The lowest offset: acknowledgements of readers that have not heard anything are lower.
const LOWEST: u64 = 1 << 10;
/// The most wrong numbers of a participant that is not validated; then it has to announce itself again.
const GUESSES: u8 = 16;
/// How long nothing is sent to a port that answered that it is closed.
const CLOSED: Duration = Duration::from_secs(1);

impl Participant {
    /// Chooses the numbers of what the builtin writers send to a participant. They depend on its address, and
    /// are above the previous ones on the link.
    pub(super) fn choose_numbers(&mut self, prefix: GuidPrefix, link: LinkId) {
        let mut hasher = DefaultHasher::new();
        (self.config.secret, prefix, self.links.destination(link)).hash(&mut hasher);
        let (previous, mut offset) = (self.links.offset(link), LOWEST + hasher.finish() % RANGE);
        if offset.cast_signed() <= previous {
            offset += previous.unsigned_abs().next_multiple_of(RANGE);
        }
        self.links.set_offset(link, offset.cast_signed());
    }

    /// Translates the numbers in an acknowledgement of a builtin writer, which validates the address of its
    /// sender. A reader with other numbers than were last sent to it begins anew.
    pub(super) fn translate_ack_nack(&mut self, now: Now, source: GuidPrefix, ack_nack: &AckNack) -> AckNack {
        let Some(peer) = self.peers.get(source) else { return *ack_nack };
        let (offset, is_known) = (self.links.offset(peer.metatraffic), peer.account.is_known());
        let base = ack_nack.missing.base();
        let guess = base;
        let base = SequenceNumber(base.0.saturating_sub(offset));
        let machine = self.locals.writers.get(&ack_nack.writer).map(|local| &local.machine);
        // A participant that is not validated was sent heartbeats only: it lacks the first sample.
        let is_right = machine.is_some_and(|writer| match is_known {
            true => (SequenceNumber::FIRST..=writer.next()).contains(&base),
            false => base == writer.first(),
        });
        if !is_right {
            if !is_known && guess > SequenceNumber::FIRST {
                self.note_guess(now, source);
            }
            return AckNack { missing: SequenceNumberSet::new(SequenceNumber::ZERO), ..*ack_nack };
        }
        let mut missing = SequenceNumberSet::new(base);
        for number in ack_nack.missing.iter() {
            let _ = missing.insert(SequenceNumber(number.0 - offset));
        }
        if !is_known {
            self.validate(now, source);
        }
        AckNack { missing, ..*ack_nack }
    }

    /// The same for a request for fragments.
    pub(super) fn translate_nack_fragment(&self, source: GuidPrefix, nack: &NackFragment) -> NackFragment {
        let offset = match self.peers.get(source).filter(|_| nack.writer.is_builtin()) {
            Some(peer) => self.links.offset(peer.metatraffic),
            None => 0,
        };
        NackFragment { number: SequenceNumber(nack.number.0.saturating_sub(offset)), ..*nack }
    }

    /// Counts a wrong number in the name of a participant that is not validated.
    fn note_guess(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        if peer.account.count_guess() > GUESSES {
            self.remove_peer(now, prefix, Departure::Unreachable);
        }
    }

    /// Lifts the limits of a participant whose address is validated.
    pub(super) fn validate(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.account.answered();
        let links: Vec<_> = peer.links.iter().map(|(_, link)| *link).collect();
        let guids: Vec<_> = peer.endpoints.values().map(|remote| remote.data.guid).collect();
        let writers: Vec<EntityId> = self.locals.writers.keys().copied().collect();
        for link in links {
            self.links.restrict(link, false);
            for writer in &writers {
                self.with_writer(now, *writer, |writer, links| writer.resume(now, link, links));
            }
        }
        self.release_withheld(prefix);
        guids.into_iter().for_each(|guid| self.match_remote(now, guid));
    }

    /// Handles a message that is addressed to this participant and comes from `from`.
    pub(super) fn note_answer(&mut self, now: Now, source: GuidPrefix, from: Ipv4Addr) {
        let Some(peer) = self.peers.get_mut(source) else { return };
        let is_own_host = || peer.is_own_host && self.config.addresses.is_own_host(from);
        if peer.host == from || is_own_host() {
            peer.answered = now.steady;
        }
    }

    /// Whether a participant sends from that host: the one at which it is reached, the one that announced it,
    /// or one that it announced, since a host with several networks sends from any of them.
    pub(super) fn is_at(&self, peer: &Peer, from: Ipv4Addr) -> bool {
        let announced = || peer.data.metatraffic_unicast.iter().chain(&peer.data.default_unicast);
        let is_own_host = || peer.is_own_host && self.config.addresses.is_own_host(from);
        peer.host == from || peer.source == from || is_own_host() || announced().any(|at| *at.ip() == from)
    }

    /// Handles the answer of a host that no socket receives datagrams at `to`. A participant that was never
    /// validated is removed; nothing is sent to others for a second, or until they are heard.
    pub fn handle_refusal(&mut self, now: Now, to: SocketAddrV4) {
        self.note_time(now);
        let is_there = |links: &[(SocketAddrV4, LinkId)]| links.iter().any(|(address, _)| *address == to);
        let refusing: Vec<_> =
            self.peers.iter().filter(|(_, peer)| is_there(&peer.links)).map(|(prefix, _)| prefix).collect();
        for prefix in refusing {
            let Some(peer) = self.peers.get_mut(prefix) else { continue };
            if !peer.account.is_known() {
                self.remove_peer(now, prefix, Departure::Unreachable);
                continue;
            }
            peer.is_closed = true;
            self.timers.set(Timer::Closed(prefix), Some(now.steady + CLOSED));
        }
    }

    /// Sends again to a participant whose port was closed.
    pub(super) fn reopen(&mut self, prefix: GuidPrefix) {
        if let Some(peer) = self.peers.get_mut(prefix) {
            peer.is_closed = false;
            self.timers.set(Timer::Closed(prefix), None);
            self.release_withheld(prefix);
        }
    }
}
