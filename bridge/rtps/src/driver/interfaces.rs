//! The IPv4 addresses of this machine at which a participant can be reached.

use super::Range;
use std::io;
use std::net::Ipv4Addr;

/// One address of one network interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Interface {
    /// The index the system gives the interface; an interface that was removed and comes back has another.
    index: u32,
    pub(super) address: Ipv4Addr,
    /// Bits of the address that its whole subnet shares.
    pub(super) prefix_length: u8,
}

/// The addresses to use, loopback only for [`Range::Localhost`] and where there is no network.
///
/// An interface counts once it is running. While it was counted `before` it stays for as long as it has its address, so that
/// a cable that is out for a moment changes nothing for participants on this machine.
pub(super) fn list(range: Range, before: &[Interface]) -> io::Result<Vec<Interface>> {
    let loopback = Interface { index: 1, address: Ipv4Addr::LOCALHOST, prefix_length: 8 };
    if range == Range::Localhost {
        return Ok(vec![loopback]);
    }
    let mut found = Vec::new();
    for interface in if_addrs::get_if_addrs()? {
        let if_addrs::IfAddr::V4(address) = &interface.addr else { continue };
        let is_running = interface.is_oper_up();
        let interface = Interface {
            index: interface.index.unwrap_or_default(),
            address: address.ip,
            prefix_length: address.prefixlen,
        };
        if !interface.address.is_loopback() && (is_running || before.contains(&interface)) {
            found.push(interface);
        }
    }
    if found.is_empty() {
        found.push(loopback);
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn localhost_is_loopback_alone_and_a_subnet_has_it_only_without_a_network() {
        let addresses = |range| list(range, &[]).unwrap().into_iter().map(|interface| interface.address);
        assert!(addresses(Range::Localhost).eq([Ipv4Addr::LOCALHOST]));
        let subnet: Vec<_> = addresses(Range::Subnet).collect();
        assert!(!subnet.is_empty());
        assert!(subnet.len() == 1 || !subnet.contains(&Ipv4Addr::LOCALHOST), "{subnet:?}");
    }
}
