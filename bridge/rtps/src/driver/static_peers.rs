//! Hosts that a participant announces itself to besides its group.

use super::sockets::Ports;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, ToSocketAddrs};

/// Participants of a host that are announced to.
const PARTICIPANTS: usize = 10;

/// Hosts by name, which have to be looked up again: they may come later, and move.
#[derive(Clone, Debug)]
pub(super) struct Names(Vec<String>);

/// Tells hosts that are given by address, with the sockets to announce to, from those that are given by name.
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

    /// Looks all of them up. May take many seconds where no name server answers.
    pub(super) fn look_up(&self, ports: Ports) -> Vec<SocketAddrV4> {
        let mut sockets = Vec::new();
        for name in &self.0 {
            let found = (name.as_str(), 0).to_socket_addrs();
            let found: Vec<_> = found.into_iter().flatten().filter_map(ipv4).collect();
            if found.is_empty() {
                tracing::warn!(
                    "static peer {name:?} has no IPv4 address here; its name is looked up again in a minute"
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
    fn addresses_need_no_look_up_and_names_do() {
        let ports = Ports::of_domain(0).unwrap();
        let (sockets, names) = split(&["10.0.0.7".into(), "localhost".into()], ports);
        assert_eq!(sockets.len(), PARTICIPANTS);
        assert_eq!(sockets[1], SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, 7), 7412));
        assert!(names.look_up(ports).contains(&SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7410)));
    }
}
