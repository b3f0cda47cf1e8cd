//! Local addresses, and the choice among the addresses that a peer announces.

use std::net::{Ipv4Addr, SocketAddrV4};

/// The addresses at which this participant is reached and to which it announces itself. Replaced as a whole
/// when interfaces change.
///
/// Without addresses, only the endpoints of the participant itself match, and nothing is sent.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Addresses {
    /// Addresses for discovery, in order of preference.
    pub metatraffic_unicast: Vec<SocketAddrV4>,
    /// Groups in which the participant receives announcements.
    pub metatraffic_multicast: Vec<SocketAddrV4>,
    /// Addresses for samples.
    pub default_unicast: Vec<SocketAddrV4>,
    /// Groups and unicast addresses to which the participant announces itself unconditionally.
    pub announce_to: Vec<SocketAddrV4>,
    /// Interfaces in use. They determine which peers are in the same subnet.
    pub interfaces: Vec<Interface>,
}

/// An address of this host with its subnet.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Interface {
    pub address: Ipv4Addr,
    pub prefix_length: u8,
}

impl Interface {
    fn reaches(self, address: Ipv4Addr) -> bool {
        let mask = u32::MAX.checked_shl(32 - u32::from(self.prefix_length.min(32))).unwrap_or(0);
        (u32::from(self.address) ^ u32::from(address)) & mask == 0
    }
}

impl Addresses {
    /// Returns whether `address` is on this host.
    pub(crate) fn is_own_host(&self, address: Ipv4Addr) -> bool {
        address.is_loopback() || self.interfaces.iter().any(|interface| interface.address == address)
    }

    /// Chooses the address at which to reach a peer, among those it announced. `source` is the sender of its
    /// announcement.
    ///
    /// A peer with several interfaces announces all of them, and some may be unreachable from here (a
    /// container bridge, a tunnel). The source of its announcement is known to be reachable.
    pub(crate) fn choose(&self, announced: &[SocketAddrV4], source: Ipv4Addr) -> Option<SocketAddrV4> {
        let usable = || announced.iter().copied().filter(|address| is_single(*address.ip()));
        let is_on_loopback = self.interfaces.iter().any(|interface| interface.address.is_loopback());
        let loopback = || {
            (is_on_loopback && self.is_own_host(source))
                .then(|| usable().find(|address| address.ip().is_loopback()))
                .flatten()
        };
        // A loopback address of another host would refer to this host.
        let remote = || usable().filter(|address| self.is_own_host(source) || !address.ip().is_loopback());
        loopback()
            .or_else(|| remote().find(|address| *address.ip() == source))
            .or_else(|| {
                remote().find(|address| self.interfaces.iter().any(|ours| ours.reaches(*address.ip())))
            })
            .or_else(|| remote().next())
    }
}

fn is_single(address: Ipv4Addr) -> bool {
    !address.is_multicast() && !address.is_unspecified() && !address.is_broadcast()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(ip: [u8; 4]) -> SocketAddrV4 {
        SocketAddrV4::new(ip.into(), 7410)
    }

    fn ours() -> Addresses {
        let interface = |ip: [u8; 4], prefix_length| Interface { address: Ipv4Addr::from(ip), prefix_length };
        Addresses {
            interfaces: vec![interface([127, 0, 0, 1], 8), interface([10, 0, 0, 5], 24)],
            ..Addresses::default()
        }
    }

    #[test]
    fn the_source_of_the_announcement_is_preferred() {
        let announced = [at([172, 17, 0, 1]), at([10, 0, 0, 7]), at([10, 9, 0, 7])];
        assert_eq!(ours().choose(&announced, [10, 9, 0, 7].into()), Some(at([10, 9, 0, 7])));
    }

    #[test]
    fn then_an_address_in_a_local_subnet_and_then_the_first() {
        let announced = [at([172, 17, 0, 1]), at([10, 0, 0, 7])];
        assert_eq!(ours().choose(&announced, [10, 9, 0, 7].into()), Some(at([10, 0, 0, 7])));
        assert_eq!(ours().choose(&announced[..1], [10, 9, 0, 7].into()), Some(announced[0]));
    }

    #[test]
    fn loopback_is_for_peers_of_this_host_only() {
        let announced = [at([10, 0, 0, 5]), at([127, 0, 0, 1])];
        assert_eq!(ours().choose(&announced, [10, 0, 0, 5].into()), Some(announced[1]));
        assert_eq!(ours().choose(&announced[1..], [10, 0, 0, 9].into()), None);
    }

    #[test]
    fn groups_are_not_addresses_of_a_peer() {
        let announced = [at([239, 255, 0, 1]), at([255, 255, 255, 255])];
        assert_eq!(ours().choose(&announced, [10, 0, 0, 9].into()), None);
    }
}
