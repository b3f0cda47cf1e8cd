//! Hosts that a participant announces itself to in addition to its group.

use super::ports::Ports;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, ToSocketAddrs};

/// Number of participants per host that are announced to.
const PARTICIPANTS: usize = 10;

/// Hosts given by name. Names are resolved periodically, because hosts may start later or change their
/// address.
#[derive(Clone, Debug)]
pub(super) struct Names(Vec<String>);

/// Separates hosts given by address, converted to the sockets to announce to, from hosts given by name.
pub(super) fn split(hosts: &[String], ports: Ports) -> (Vec<SocketAddrV4>, Names) {
    let (mut sockets, mut names) = (Vec::new(), Vec::new());
    for host in hosts {
        match host.parse::<Ipv4Addr>() {
            Ok(address) => sockets.extend(ports.announcements_to(address, PARTICIPANTS)),
            Err(_) => names.push(host.clone()),
        }
    }
    (sockets, Names(names))
}

impl Names {
    pub(super) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Resolves all names. May take many seconds if no name server answers.
    pub(super) fn look_up(&self, ports: Ports) -> Vec<SocketAddrV4> {
        let mut sockets = Vec::new();
        for name in &self.0 {
            let found = (name.as_str(), 0).to_socket_addrs();
            let found: Vec<_> = found.into_iter().flatten().filter_map(ipv4).collect();
            if found.is_empty() {
                tracing::warn!(
                    "static peer {name:?} has no IPv4 address here; its name is resolved again in a minute"
                );
            }
            sockets
                .extend(found.into_iter().flat_map(|address| ports.announcements_to(address, PARTICIPANTS)));
        }
        sockets
    }
}

fn ipv4(address: SocketAddr) -> Option<Ipv4Addr> {
    match address {
        SocketAddr::V4(address) => Some(*address.ip()),
        SocketAddr::V6(_) => None,
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn only_names_are_resolved() {
        let ports = Ports::of_domain(0).unwrap();
        let (sockets, names) = split(&["10.0.0.7".into(), "localhost".into()], ports);
        assert_eq!(sockets.len(), PARTICIPANTS);
        assert_eq!(sockets[1], SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 7), 7412));
        assert!(names.look_up(ports).contains(&SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7410)));
    }
}
