//! The choice of links to endpoints.
//!
//! All endpoints of a peer are reached at one host. Addresses of other hosts that it or its endpoints
//! announce are not used: they are not validated, and sending samples there could be part of an attack on a
//! third party.

use std::net::{Ipv4Addr, SocketAddrV4};

use super::{Destination, LinkId, LinkOptions, Now, Participant, links::OWN_HOST_DATAGRAM, peers::Peer};
use crate::wire::{Guid, GuidPrefix, ParticipantData};

/// Longest datagram to another host: one that fits in an Ethernet frame.
const REMOTE_DATAGRAM: usize = 1_472;

/// The most bytes of a datagram in addition to the payload of a fragment.
const FRAGMENT_OVERHEAD: usize = 200;

/// The most addresses of the endpoints of one participant, including those of the participant.
const MAX_LINKS: usize = 16;

/// Payload of a fragment to a peer on this host: three such datagrams fit into the smallest receive buffer of
/// Linux.
const OWN_HOST_FRAGMENT: u16 = 32_768;

/// The addresses at which a participant is reached.
pub(super) struct Route {
    /// Discovery.
    pub(super) metatraffic: SocketAddrV4,
    /// Samples for endpoints without their own address.
    pub(super) default: SocketAddrV4,
}

impl Participant {
    /// Returns where to reach a participant whose announcement came from `source`; `None` if it is not
    /// reachable.
    pub(super) fn route(&self, data: &ParticipantData, source: Ipv4Addr) -> Option<Route> {
        let metatraffic = self.config.addresses.choose(&data.metatraffic_unicast, source)?;
        // A participant without an address for samples has no user endpoints.
        let default = at_host(*metatraffic.ip(), &data.default_unicast).unwrap_or(metatraffic);
        Some(Route { metatraffic, default })
    }

    /// Updates all routes after a change of local addresses.
    pub(super) fn readdress(&mut self, now: Now) {
        let prefixes: Vec<_> = self.peers.iter().map(|(prefix, _)| prefix).collect();
        for prefix in prefixes {
            self.reroute(prefix);
        }
        self.announce_anew(now);
    }

    /// Chooses the route to a peer again. Returns whether it has changed.
    pub(super) fn reroute(&mut self, prefix: GuidPrefix) -> bool {
        let Some(peer) = self.peers.get(prefix) else { return false };
        let Some(route) = self.route(&peer.data, peer.source) else { return false };
        let Some(peer) = self.peers.get_mut(prefix) else { return false };
        let mut has_moved = false;
        peer.host = *route.metatraffic.ip();
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

    /// Returns the link to an address of a peer, and opens it if needed.
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
        self.links.restrict(link, !peer.account.is_known());
        peer.links.push((to, link));
        link
    }

    /// Returns the link to an endpoint: that of its participant, unless it announced its own address.
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
        // Limited, because a link costs more than announcing an address.
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
