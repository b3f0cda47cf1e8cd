//! Which link leads to which endpoint.
//!
//! A peer is reached at one host. Addresses of other hosts that it or its endpoints announce are not used: it has not shown
//! that it is there, and samples sent there could be meant to hurt somebody else.

use std::net::{Ipv4Addr, SocketAddrV4};

use super::{Destination, LinkId, LinkOptions, Now, Participant, peers::Peer};
use crate::wire::{Guid, GuidPrefix, ParticipantData};

/// Longest datagram to a peer of this host; UDP allows 65 507 bytes.
pub(super) const OWN_HOST_DATAGRAM: usize = 65_000;

/// Longest datagram to another host: one that fits in an Ethernet frame.
const REMOTE_DATAGRAM: usize = 1_472;

/// Bytes of a datagram that are no payload of a fragment, at most.
const FRAGMENT_OVERHEAD: usize = 200;

/// Addresses that the endpoints of one participant may have, those of the participant among them.
const MAX_LINKS: usize = 16;

/// Payload of a fragment to a peer of this host: three datagrams of it fit in the smallest receive buffer Linux gives.
const OWN_HOST_FRAGMENT: u16 = 32_768;

/// Where a participant is reached.
pub(super) struct Route {
    /// Discovery.
    pub(super) metatraffic: SocketAddrV4,
    /// Samples for endpoints without an address of their own.
    pub(super) default: SocketAddrV4,
}

impl Participant {
    /// Where a participant is reached whose announcement came from `source`; `None` if nowhere.
    pub(super) fn route(&self, data: &ParticipantData, source: Ipv4Addr) -> Option<Route> {
        let metatraffic = self.config.addresses.choose(&data.metatraffic_unicast, source)?;
        // One without an address for samples has no endpoints of a user.
        let default = at_host(*metatraffic.ip(), &data.default_unicast).unwrap_or(metatraffic);
        Some(Route { metatraffic, default })
    }

    /// Follows a change of our own addresses.
    pub(super) fn readdress(&mut self, now: Now) {
        let prefixes: Vec<_> = self.peers.iter().map(|(prefix, _)| prefix).collect();
        for prefix in prefixes {
            self.reroute(prefix);
        }
        self.announce_anew(now);
    }

    /// Chooses anew where a peer is reached. Returns whether it is elsewhere.
    pub(super) fn reroute(&mut self, prefix: GuidPrefix) -> bool {
        let Some(peer) = self.peers.get(prefix) else { return false };
        let Some(route) = self.route(&peer.data, peer.source) else { return false };
        let Some(peer) = self.peers.get_mut(prefix) else { return false };
        let mut has_moved = false;
        for (link, to) in [(peer.metatraffic, route.metatraffic), (peer.default, route.default)] {
            for (address, _) in
                peer.links.iter_mut().filter(|(address, known)| *known == link && *address != to)
            {
                *address = to;
                has_moved = true;
                let (max_datagram, _) = sizes(peer.is_own_host, self.config.fragment_size);
                self.links.redirect(link, Destination::Unicast(to), max_datagram);
            }
        }
        has_moved
    }

    /// The link to an address of a peer.
    pub(super) fn open_link(
        &mut self,
        peer: &mut Peer,
        to: SocketAddrV4,
        receive_buffer: Option<u32>,
    ) -> LinkId {
        if let Some((_, link)) = peer.links.iter().find(|(address, _)| *address == to) {
            return *link;
        }
        let (max_datagram, fragment_size) = sizes(peer.is_own_host, self.config.fragment_size);
        let destination = Destination::Unicast(to);
        let options =
            LinkOptions { destination, peer: peer.data.prefix, max_datagram, fragment_size, receive_buffer };
        let link = self.links.open(options);
        peer.links.push((to, link));
        link
    }

    /// The link to an endpoint: that of its participant, unless it announced an address of its own.
    pub(super) fn link_to(&mut self, remote: Guid) -> Option<LinkId> {
        if remote.prefix == self.config.prefix {
            return Some(self.own);
        }
        let peer = self.peers.get(remote.prefix)?;
        let default = peer.default;
        let Some(Destination::Unicast(metatraffic)) = self.links.destination(peer.metatraffic) else {
            return Some(default);
        };
        let unicast = &peer.endpoints.get(&remote.entity)?.data.unicast;
        let Some(to) = at_host(*metatraffic.ip(), unicast) else { return Some(default) };
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
}

fn at_host(host: Ipv4Addr, addresses: &[SocketAddrV4]) -> Option<SocketAddrV4> {
    addresses.iter().copied().find(|address| *address.ip() == host)
}

/// Longest datagram to a peer, and the payload of a fragment.
fn sizes(is_own_host: bool, fragment_size: u16) -> (usize, u16) {
    if is_own_host {
        return (OWN_HOST_DATAGRAM, OWN_HOST_FRAGMENT.max(fragment_size));
    }
    (REMOTE_DATAGRAM.max(usize::from(fragment_size) + FRAGMENT_OVERHEAD), fragment_size)
}
