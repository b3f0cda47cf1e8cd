//! Announces the participant to hosts that multicast does not reach: `ROS_STATIC_PEERS`.
//!
//! rustdds 0.15.1 announces itself to multicast groups and to this machine. An announcement (RTPS 2.5, 8.5.3) says where
//! to answer, whoever brings it: so what this participant multicasts is heard here, as others hear it, and sent on to each
//! static peer, at the ports that the first participants of a host listen to (9.6.2.4.3). A peer that has not heard of us
//! answers there, and rustdds takes it from that.

use super::returned::listen;
use super::rtps::{sender_of, unicast_ports};
use std::io;
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, ToSocketAddrs, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Participants of a host that are announced to.
const PARTICIPANTS: u16 = 10;
/// How often it is announced; as Fast DDS does.
const PERIOD: Duration = Duration::from_secs(3);
/// Names are looked up again, since a host may come later.
const LOOK_UP: Duration = Duration::from_secs(60);
/// No announcement is larger.
const LARGEST: usize = 65_536;

/// It announces until it is dropped.
pub(super) struct StaticPeers {
    is_stopping: Arc<AtomicBool>,
    addresses: Arc<Mutex<Vec<SocketAddr>>>,
    thread: Option<JoinHandle<()>>,
}

impl StaticPeers {
    /// Listens from now on, so before the participant is there; `own` is told later.
    pub(super) fn start(domain_id: u16, hosts: Vec<String>) -> io::Result<Listening> {
        let socket = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 0))?;
        socket.set_nonblocking(true)?;
        Ok(Listening { heard: listen(domain_id)?, socket, domain_id, hosts })
    }

    /// Where the peers listen, as far as is known.
    pub(super) fn addresses(&self) -> Arc<Mutex<Vec<SocketAddr>>> {
        Arc::clone(&self.addresses)
    }
}

/// Hears announcements, of whom it is to pass on is not known yet.
pub(super) struct Listening {
    heard: UdpSocket,
    socket: UdpSocket,
    domain_id: u16,
    hosts: Vec<String>,
}

impl Listening {
    /// Passes on the announcements of the participant with that identity.
    pub(super) fn announce(self, own: [u8; 12]) -> io::Result<StaticPeers> {
        let is_stopping = Arc::<AtomicBool>::default();
        let stop = Arc::clone(&is_stopping);
        let addresses = Arc::<Mutex<Vec<SocketAddr>>>::default();
        let known = Arc::clone(&addresses);
        let run = move || self.run(own, &known, &stop);
        let thread = std::thread::Builder::new().name("downbeat-peers".to_owned()).spawn(run)?;
        Ok(StaticPeers { is_stopping, addresses, thread: Some(thread) })
    }

    fn run(&self, own: [u8; 12], known: &Mutex<Vec<SocketAddr>>, is_stopping: &AtomicBool) {
        let mut packet = vec![0; LARGEST];
        let mut announcement = Vec::new();
        let (mut addresses, mut looked_up, mut announced) = (self.look_up(), Instant::now(), None);
        while !is_stopping.load(Ordering::Relaxed) {
            // A turn without any packet is an error of kind `WouldBlock`.
            if let Ok(length) = self.heard.recv(&mut packet)
                && sender_of(&packet[..length]) == Some(own)
                && announcement != packet[..length]
            {
                announcement = packet[..length].to_vec();
                announced = None;
            }
            if announcement.is_empty() || announced.is_some_and(|at: Instant| at.elapsed() < PERIOD) {
                continue;
            }
            if looked_up.elapsed() > LOOK_UP {
                (addresses, looked_up) = (self.look_up(), Instant::now());
            }
            known.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&addresses);
            for address in &addresses {
                // One that cannot be reached now may be later.
                let _ = self.socket.send_to(&announcement, address);
            }
            announced = Some(Instant::now());
        }
    }

    /// Where the hosts listen, by address or name.
    fn look_up(&self) -> Vec<SocketAddr> {
        let mut addresses = Vec::new();
        for host in &self.hosts {
            let found = (host.as_str(), 0).to_socket_addrs();
            let found = found.map(|found| found.filter_map(ipv4).collect::<Vec<_>>()).unwrap_or_default();
            if found.is_empty() {
                tracing::warn!(
                    "ROS_STATIC_PEERS: {host:?} has no IPv4 address here; it is looked up again in a minute"
                );
            }
            for address in found {
                let ports = unicast_ports(self.domain_id, PARTICIPANTS);
                addresses.extend(ports.map(|port| SocketAddr::V4(SocketAddrV4::new(address, port))));
            }
        }
        addresses
    }
}

impl Drop for StaticPeers {
    fn drop(&mut self) {
        self.is_stopping.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // It does not panic; there is nothing to tell about a join that fails.
            let _ = thread.join();
        }
    }
}

fn ipv4(address: SocketAddr) -> Option<Ipv4Addr> {
    match address {
        SocketAddr::V4(address) => Some(*address.ip()),
        SocketAddr::V6(_) => None,
    }
}
