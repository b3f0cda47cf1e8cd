//! Packing of waiting submessages into datagrams.

use super::{Destination, Emitted, LinkId, Now, Participant, Room};
use crate::wire::{EntityId, GuidPrefix, Header, MessageBuilder};

/// A datagram with less room than this is not started: an acknowledgement with its header has this size.
const SMALLEST: usize = 128;

impl Participant {
    /// Fills `datagram` with the next data to send and returns its destination; `None` if there is nothing to
    /// send.
    ///
    /// Also delivers messages between local endpoints.
    pub fn poll_transmit(&mut self, now: Now, datagram: &mut Vec<u8>) -> Option<Destination> {
        self.note_time(now);
        if !self.announcer.is_leaving()
            && let Some(destination) = self.transmit_announcement(now, datagram)
        {
            return Some(destination);
        }
        while let Some(link) = self.links.next(now.steady) {
            if !self.fill(now, link, datagram) {
                continue;
            }
            let Some(destination) = self.links.destination(link) else { continue };
            if destination == Destination::Own {
                let own = std::mem::take(datagram);
                self.loop_back(now, &own);
                *datagram = own;
                continue;
            }
            let peer = self.links.peer(link);
            if self.seal(peer, datagram) {
                return Some(destination);
            }
        }
        if self.announcer.is_leaving() { self.transmit_announcement(now, datagram) } else { None }
    }

    /// Packs what waits on a link into one datagram. Returns whether there is a datagram to send.
    fn fill(&mut self, now: Now, link: LinkId, datagram: &mut Vec<u8>) -> bool {
        let peer = self.links.peer(link);
        let known = self.peers.get(peer);
        let (allowance, is_closed) =
            known.map_or((usize::MAX, false), |peer| (peer.account.allowance(), peer.is_closed));
        let is_own = self.links.destination(link) == Some(Destination::Own);
        let room = self.guard.as_deref().filter(|_| !is_own).map_or(Room::default(), |guard| guard.room());
        let max_len = self.links.max_datagram(link).min(allowance).saturating_sub(room.message);
        let is_limited = allowance <= self.links.max_datagram(link);
        datagram.clear();
        if is_limited && max_len < SMALLEST || is_closed {
            while let Some(id) = self.links.pop(link) {
                self.withhold(peer, link, id);
            }
            return false;
        }
        let mut builder = MessageBuilder::new(datagram, max_len, Header::ours(self.config.prefix));
        builder.reserve(room.submessage);
        let offset = self.links.offset(link);
        let mut establishes_protection = None;
        while let Some(id) = self.links.pop(link) {
            // With a guard, what establishes protection is sent in datagrams of its own.
            let kind = self.guard.is_some() && id.establishes_protection();
            if *establishes_protection.get_or_insert(kind) != kind && !builder.is_empty() {
                self.links.put_back(link, id, Emitted::More);
                break;
            }
            establishes_protection = Some(kind);
            builder.shift_numbers(if id.is_builtin() { offset } else { 0 });
            let emitted = if let Some(local) = self.locals.writers.get_mut(&id) {
                let emitted = local.machine.emit(now, link, &mut self.links, &mut builder);
                self.follow_up(now, id);
                emitted
            } else if let Some(local) = self.locals.readers.get_mut(&id) {
                let emitted = local.machine.emit(now, link, &mut builder);
                let timeout = local.machine.next_timeout();
                self.set_timer(now, id, timeout);
                emitted
            } else {
                continue;
            };
            let is_full = emitted == Emitted::More;
            if is_full && is_limited && builder.is_empty() {
                self.withhold(peer, link, id);
            } else {
                self.links.put_back(link, id, emitted);
            }
            if is_full {
                break;
            }
        }
        !builder.is_empty()
    }

    /// Protects and counts a complete datagram. Returns whether it may be sent.
    pub(super) fn seal(&mut self, peer: GuidPrefix, datagram: &mut Vec<u8>) -> bool {
        if let Some(guard) = self.guard.as_deref_mut()
            && !guard.encode(peer, datagram)
        {
            return false;
        }
        if let Some(peer) = self.peers.get_mut(peer) {
            peer.account.sent(datagram.len());
        }
        self.counters.datagrams_sent += 1;
        self.counters.bytes_sent += datagram.len() as u64;
        true
    }

    /// Withholds a sender until more bytes were received from the peer.
    fn withhold(&mut self, peer: GuidPrefix, link: LinkId, id: EntityId) {
        self.counters.withheld += 1;
        if let Some(peer) = self.peers.get_mut(peer)
            && !peer.withheld.contains(&(link, id))
        {
            peer.withheld.push((link, id));
        }
    }

    /// Lets withheld senders send again.
    pub(super) fn release_withheld(&mut self, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        for (link, id) in std::mem::take(&mut peer.withheld) {
            self.links.request(link, id);
        }
    }
}
