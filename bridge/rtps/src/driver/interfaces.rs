//! The IPv4 addresses of this machine.

use super::Range;
use super::ports::Ports;
use crate::protocol;
use std::io;
use std::net::{Ipv4Addr, SocketAddrV4};

/// One address of one network interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interface {
    /// The index that the operating system assigned to the interface. It changes if the interface is removed
    /// and added again.
    index: u32,
    pub(super) address: Ipv4Addr,
    /// Number of address bits that identify the subnet.
    prefix_length: u8,
}

/// The addresses of this machine at one moment.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Interfaces {
    /// All interfaces including loopback.
    all: Vec<Interface>,
    /// The interfaces at which other participants reach this one.
    used: Vec<Interface>,
}

impl Interfaces {
    /// Reads the addresses of interfaces that are running.
    ///
    /// An interface that was there `before` is kept as long as it has its address, so that a briefly
    /// disconnected cable does not affect participants on this machine.
    pub(super) fn read(range: Range, before: &Self) -> io::Result<Self> {
        let mut all = Vec::new();
        for interface in if_addrs::get_if_addrs()? {
            let if_addrs::IfAddr::V4(address) = &interface.addr else { continue };
            let is_running = interface.is_oper_up();
            let index = interface.index.unwrap_or_default();
            let interface = Interface { index, address: address.ip, prefix_length: address.prefixlen };
            if is_running || before.all.contains(&interface) {
                all.push(interface);
            }
        }
        Ok(Self::of(range, all))
    }

    fn of(range: Range, mut all: Vec<Interface>) -> Self {
        if !all.iter().any(|interface| interface.address.is_loopback()) {
            // Loopback always exists, but a container may hide it.
            all.push(Interface { index: 1, address: Ipv4Addr::LOCALHOST, prefix_length: 8 });
        }
        let (loopback, outside): (Vec<_>, Vec<_>) =
            all.iter().copied().partition(|interface| interface.address.is_loopback());
        let used = match range {
            Range::Off => Vec::new(),
            Range::Subnet if !outside.is_empty() => outside,
            Range::Subnet | Range::Localhost => loopback,
        };
        Self { all, used }
    }

    /// The interfaces at which other participants reach this one: none for [`Range::Off`]; loopback for
    /// [`Range::Localhost`] or if there is no network; otherwise all except loopback.
    pub(super) fn used(&self) -> &[Interface] {
        &self.used
    }

    /// The addresses of a participant that has these ports and announces itself to its group and to
    /// `announce_to`.
    pub(super) fn addresses(
        &self,
        ports: Ports,
        (meta, user): (u16, u16),
        announce_to: impl IntoIterator<Item = SocketAddrV4>,
    ) -> protocol::Addresses {
        if self.used.is_empty() {
            return protocol::Addresses::default();
        }
        let at = |port| self.used.iter().map(move |used| SocketAddrV4::new(used.address, port)).collect();
        let interface = |interface: &Interface| protocol::Interface {
            address: interface.address,
            prefix_length: interface.prefix_length,
        };
        protocol::Addresses {
            metatraffic_unicast: at(meta),
            metatraffic_multicast: vec![ports.group()],
            default_unicast: at(user),
            announce_to: std::iter::once(ports.group()).chain(announce_to).collect(),
            interfaces: self.all.iter().map(interface).collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    const LOOPBACK: Interface = Interface { index: 1, address: Ipv4Addr::LOCALHOST, prefix_length: 8 };
    const OUTSIDE: Interface = Interface { index: 2, address: Ipv4Addr::new(10, 0, 0, 5), prefix_length: 24 };

    #[test]
    fn localhost_uses_only_loopback_and_a_subnet_uses_it_only_without_a_network() {
        let used = |range, all: &[Interface]| Interfaces::of(range, all.to_vec()).used;
        assert_eq!(used(Range::Off, &[LOOPBACK, OUTSIDE]), []);
        assert_eq!(used(Range::Localhost, &[LOOPBACK, OUTSIDE]), [LOOPBACK]);
        assert_eq!(used(Range::Subnet, &[LOOPBACK, OUTSIDE]), [OUTSIDE]);
        assert_eq!(used(Range::Subnet, &[LOOPBACK]), [LOOPBACK]);
        assert_eq!(used(Range::Subnet, &[]), [LOOPBACK]);
    }

    #[test]
    fn this_machine_has_loopback() {
        let interfaces = Interfaces::read(Range::Localhost, &Interfaces::default()).unwrap();
        assert!(interfaces.used.iter().any(|used| used.address == Ipv4Addr::LOCALHOST), "{interfaces:?}");
    }
}
