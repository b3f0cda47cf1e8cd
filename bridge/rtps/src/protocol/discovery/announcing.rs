//! Announcement of this participant (SPDP, section 8.5.3).

use bytes::Bytes;

use super::announcer::Announcement;
use crate::{
    protocol::{Destination, Now, Participant, participant::Timer},
    wire::{EntityId, Guid, GuidPrefix, InlineQos},
};

impl Participant {
    /// Announces this participant to all others.
    pub(in crate::protocol) fn announce(&mut self, now: Now) {
        self.announcer.start_round(&self.config, now);
        self.timers.set(Timer::Announcement, self.announcer.next());
        // Multicast may not reach them, and an idle participant sends nothing else that shows that it is
        // alive.
        let often_enough = self.config.lease / 3;
        for (prefix, peer) in self.peers.iter_mut() {
            let to = self.links.destination(peer.metatraffic);
            if let Some(Destination::Unicast(to)) = to
                && now.steady.saturating_duration_since(peer.announced) >= often_enough
            {
                peer.announced = now.steady;
                if !self.config.addresses.announce_to.contains(&to) {
                    self.announcer.announce_to(to, prefix);
                }
            }
        }
    }

    /// Announces this participant to another one.
    pub(in crate::protocol) fn announce_to(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.announced = now.steady;
        if let Some(Destination::Unicast(to)) = self.links.destination(peer.metatraffic) {
            self.announcer.announce_to(to, prefix);
        }
    }

    /// Sends a farewell to one participant, so that it rediscovers this one with the next announcement.
    pub(in crate::protocol) fn part_from(&mut self, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix) else { return };
        if let Some(Destination::Unicast(to)) = self.links.destination(peer.metatraffic) {
            self.announcer.part_from(to, prefix);
        }
    }

    /// Announces changed addresses.
    pub(in crate::protocol) fn announce_anew(&mut self, now: Now) {
        self.announcer.start_anew(&self.config, self.guard.as_deref_mut(), now);
        self.timers.set(Timer::Announcement, self.announcer.next());
        self.announce_protected(now);
    }

    /// Announces this participant, as it is now, to those that have authenticated it.
    pub(in crate::protocol) fn announce_protected(&mut self, now: Now) {
        if self.guard.is_none() {
            return;
        }
        let payload = Bytes::copy_from_slice(self.announcer.payload());
        let key_hash = Some(Guid::new(self.config.prefix, EntityId::PARTICIPANT).to_bytes());
        let inline_qos = InlineQos { key_hash, ..InlineQos::default() };
        self.write_builtin(now, EntityId::SPDP_SECURE_WRITER, payload, inline_qos);
    }

    /// Announces the departure to those that have authenticated this participant, and do not believe it in
    /// clear.
    pub(in crate::protocol) fn announce_departure(&mut self, now: Now) {
        if self.guard.is_some() {
            let inline_qos = InlineQos::removal(Guid::new(self.config.prefix, EntityId::PARTICIPANT));
            self.write_builtin(now, EntityId::SPDP_SECURE_WRITER, Bytes::new(), inline_qos);
        }
    }

    /// The next waiting announcement.
    pub(in crate::protocol) fn transmit_announcement(
        &mut self,
        now: Now,
        datagram: &mut Vec<u8>,
    ) -> Option<Destination> {
        while let Some(announcement) = self.announcer.pop() {
            let fits = self.announcer.emit(announcement, self.config.prefix, now, datagram);
            let Announcement { to, peer, .. } = announcement;
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
