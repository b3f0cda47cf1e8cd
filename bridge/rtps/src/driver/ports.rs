//! The UDP ports and the multicast group of a domain.

use std::net::{Ipv4Addr, SocketAddrV4};

/// The multicast group of announcements (RTPS 2.5, 9.6.2.4.1).
const GROUP: Ipv4Addr = Ipv4Addr::new(239, 255, 0, 1);

/// The UDP ports of a domain (RTPS 2.5, 9.6.2.3).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Ports {
    base: u16,
}

impl Ports {
    /// Returns `None` if the domain has no ports.
    pub(super) fn of_domain(domain_id: u16) -> Option<Self> {
        (domain_id <= 232).then(|| Self { base: 7400 + 250 * domain_id })
    }

    /// The address of announcements to the group.
    pub(super) fn group(self) -> SocketAddrV4 {
        SocketAddrV4::new(GROUP, self.base)
    }

    /// The ports for discovery and user data of each possible participant of a host, in order.
    pub(super) fn of_participants(self) -> impl Iterator<Item = (u16, u16)> {
        let base = self.base;
        (0..120).filter_map(move |index: u16| {
            Some((base.checked_add(10 + 2 * index)?, base.checked_add(11 + 2 * index)?))
        })
    }

    /// The addresses at which the first `count` participants of a host expect announcements.
    pub(super) fn announcements_to(self, host: Ipv4Addr, count: usize) -> impl Iterator<Item = SocketAddrV4> {
        self.of_participants().take(count).map(move |(meta, _)| SocketAddrV4::new(host, meta))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn ports_follow_the_standard_and_end_at_the_last_udp_port() {
        let ports = Ports::of_domain(1).unwrap();
        assert_eq!(ports.group().port(), 7650);
        assert_eq!(ports.of_participants().next(), Some((7660, 7661)));
        assert_eq!(ports.of_participants().nth(3), Some((7666, 7667)));
        assert_eq!(ports.of_participants().count(), 120);
        assert_eq!(Ports::of_domain(233), None);
        let (meta, user) = Ports::of_domain(232).unwrap().of_participants().last().unwrap();
        assert!(user == meta + 1 && user > 65_530, "{user}");
    }
}
