//! The UDP sockets of a participant.
//!
//! Two sockets receive datagrams addressed to the participant, and one those addressed to its multicast
//! group. Others send: one to unicast addresses, and one per interface to groups. Receiving sockets are not
//! used for sending, because the options for receiving several datagrams per system call disable IP
//! fragmentation.

use super::interfaces::Interface;
use super::log_limit::LogLimit;
use super::ports::Ports;
use super::{JoinError, Range};
use mio::net::UdpSocket;
use mio::{Interest, Registry, Token};
use quinn_udp::{RecvMeta, UdpSocketState};
use socket2::{Domain, Protocol, SockAddr, SockRef, Socket, Type};
use std::io::{self, IoSliceMut};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4};

/// The size of receive and send buffers, in bytes, that a participant asks the system for.
pub const SOCKET_BUFFER: usize = 4 << 20;
/// Number of datagrams per system call.
const BATCH: usize = 16;
/// The most answers of closed ports that are read at once.
const MOST_REFUSALS: usize = 64;
/// Larger than any UDP datagram; also the most that the kernel coalesces.
const LARGEST: usize = 65_536;

/// The receiving sockets of a participant.
pub(super) struct Receivers {
    pub(super) meta_port: u16,
    pub(super) user_port: u16,
    /// Size of the receive buffer for user data.
    pub(super) buffer: usize,
    sockets: Vec<Receiver>,
    /// The socket of the multicast group, if it could be bound.
    multicast: Option<usize>,
    group: Ipv4Addr,
    joined: Vec<Interface>,
    log: LogLimit,
}

struct Receiver {
    socket: UdpSocket,
    state: UdpSocketState,
}

/// The receive buffers.
pub(super) struct Buffers {
    bytes: Vec<u8>,
    meta: [RecvMeta; BATCH],
}

impl Receivers {
    /// Binds the ports of the first participant of the domain whose ports are free.
    pub(super) fn bind(ports: Ports, range: Range, registry: &Registry) -> Result<Self, JoinError> {
        let group = ports.group();
        if range == Range::Off {
            let (sockets, joined, log) = (Vec::new(), Vec::new(), LogLimit::default());
            return Ok(Self {
                meta_port: 0,
                user_port: 0,
                buffer: 0,
                sockets,
                multicast: None,
                group: *group.ip(),
                joined,
                log,
            });
        }
        let address = address(range);
        let ((meta_port, user_port), pair) = bind_pair(ports, address)?;
        let mut sockets = pair.map(Receiver::new).into_iter().collect::<Result<Vec<_>, _>>()?;
        let buffer = sockets.iter().map(|receiver| buffer_of(&receiver.socket)).min().unwrap_or_default();
        if buffer < SOCKET_BUFFER {
            tracing::warn!(
                "the receive buffer of a UDP socket has only {} KiB instead of {} KiB: large messages may have to be sent \
                 again. Increase the limit with `sysctl -w net.core.rmem_max={SOCKET_BUFFER}`",
                buffer >> 10,
                SOCKET_BUFFER >> 10
            );
        }
        let multicast = match bind_group(group).and_then(Receiver::new_in) {
            Ok(receiver) => {
                sockets.push(receiver);
                Some(sockets.len() - 1)
            }
            Err(error) => {
                tracing::warn!(
                    "UDP port {} cannot be shared for multicast ({error}): only participants are found to which this one announces \
                     itself by address",
                    group.port()
                );
                None
            }
        };
        for (index, receiver) in sockets.iter_mut().enumerate() {
            registry
                .register(&mut receiver.socket, Token(index), Interest::READABLE)
                .map_err(JoinError::Socket)?;
        }
        let (joined, log) = (Vec::new(), LogLimit::default());
        Ok(Self { meta_port, user_port, buffer, sockets, multicast, group: *group.ip(), joined, log })
    }

    /// Joins the group on these interfaces only.
    pub(super) fn join(&mut self, interfaces: &[Interface]) {
        let Some(index) = self.multicast else { return };
        let socket = &self.sockets[index].socket;
        for gone in self.joined.iter().filter(|joined| !interfaces.contains(joined)) {
            // Fails if the interface was removed, which also ends the membership.
            let _ = socket.leave_multicast_v4(&self.group, &gone.address);
        }
        self.joined.retain(|joined| interfaces.contains(joined));
        for new in interfaces {
            if self.joined.contains(new) {
                continue;
            }
            match socket.join_multicast_v4(&self.group, &new.address) {
                // Two addresses of an interface share a membership.
                Err(error) if error.kind() != io::ErrorKind::AddrInUse => {
                    // Retried when the interfaces are read next.
                    if self.log.allow() {
                        tracing::warn!(
                            "multicast cannot be received on {}: {error}; other hosts there are found if they announce themselves \
                             to this one by address",
                            new.address
                        );
                    }
                }
                _ => self.joined.push(*new),
            }
        }
    }

    /// Receives waiting datagrams from a socket and passes each with its sender to `handle`. Returns whether
    /// there may be more.
    pub(super) fn receive(
        &mut self,
        token: Token,
        buffers: &mut Buffers,
        mut handle: impl FnMut(SocketAddrV4, &[u8]),
    ) -> bool {
        let Some(Receiver { socket, state }) = self.sockets.get(token.0) else { return false };
        let mut chunks = buffers.bytes.chunks_exact_mut(LARGEST).map(IoSliceMut::new);
        let mut slices: [IoSliceMut<'_>; BATCH] =
            std::array::from_fn(|_| chunks.next().unwrap_or_else(|| IoSliceMut::new(&mut [])));
        match socket.try_io(|| state.recv(socket.into(), &mut slices, &mut buffers.meta)) {
            Ok(count) => {
                for (slice, meta) in slices.iter().zip(&buffers.meta[..count]) {
                    let SocketAddr::V4(from) = meta.addr else { continue };
                    // Several datagrams of one sender may be coalesced.
                    slice[..meta.len.min(slice.len())]
                        .chunks(meta.stride.max(1))
                        .for_each(|datagram| handle(from, datagram));
                }
                count == BATCH
            }
            Err(error) => {
                // A call that was interrupted or reports the error of an earlier datagram is simply repeated.
                let is_over = error.kind() == io::ErrorKind::WouldBlock;
                if !is_over && self.log.allow() {
                    tracing::warn!("receiving from the network failed: {error}");
                }
                !is_over
            }
        }
    }
}

impl Buffers {
    pub(super) fn new() -> Self {
        // Pages are only touched when datagrams need them.
        Self { bytes: vec![0; BATCH * LARGEST], meta: [RecvMeta::default(); BATCH] }
    }
}

impl Receiver {
    fn new(socket: Socket) -> Result<Self, JoinError> {
        Self::new_in(socket).map_err(JoinError::Socket)
    }

    fn new_in(socket: Socket) -> io::Result<Self> {
        let state = UdpSocketState::new((&socket).into())?;
        Ok(Self { socket: UdpSocket::from_std(socket.into()), state })
    }
}

/// The sending sockets of a participant.
pub(super) struct Senders {
    unicast: UdpSocket,
    /// Addresses whose hosts answered that no socket receives there.
    refusals: Vec<SocketAddrV4>,
    multicast: Vec<(Interface, UdpSocket)>,
    address: Ipv4Addr,
    log: LogLimit,
}

/// The result of sending a datagram.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Sent {
    /// The datagram was sent, or is treated as lost by the network.
    Done,
    /// The send buffer is full: the datagram must be sent again when the socket is writable.
    Full,
}

impl Senders {
    pub(super) fn bind(range: Range, registry: &Registry, token: Token) -> io::Result<Self> {
        let address = address(range);
        let mut unicast = sender(address)?;
        registry.register(&mut unicast, token, Interest::WRITABLE)?;
        // Without it, Linux does not report closed ports to sockets that send to many addresses. Elsewhere
        // they are not reported. The state is that of another socket, because creating it disables IP
        // fragmentation.
        #[cfg(any(target_os = "linux", target_os = "android"))]
        UdpSocketState::new((&sender(address)?).into())?.enable_transport_errors((&unicast).into())?;
        let refusals = Vec::new();
        Ok(Self { unicast, refusals, multicast: Vec::new(), address, log: LogLimit::default() })
    }

    /// Sets the interfaces on which datagrams to groups are sent.
    pub(super) fn set_interfaces(&mut self, interfaces: &[Interface]) {
        self.multicast.retain(|(interface, _)| interfaces.contains(interface));
        for interface in interfaces {
            if self.multicast.iter().any(|(known, _)| known == interface) {
                continue;
            }
            match multicast_sender(self.address, interface.address) {
                Ok(socket) => self.multicast.push((*interface, socket)),
                Err(error) => {
                    // Retried when the interfaces are read next.
                    if self.log.allow() {
                        tracing::warn!("multicast cannot be sent on {}: {error}", interface.address);
                    }
                }
            }
        }
    }

    /// Sends a datagram to one address.
    pub(super) fn send(&mut self, to: SocketAddrV4, datagram: &[u8]) -> Sent {
        let mut sent = send(&self.unicast, to, datagram);
        for _ in 0..MOST_REFUSALS {
            // The error of an earlier datagram, possibly to another address.
            let Err(error) = &sent else { break };
            if error.kind() != io::ErrorKind::ConnectionRefused {
                break;
            }
            self.read_refusals();
            sent = send(&self.unicast, to, datagram);
        }
        self.outcome(to, sent)
    }

    /// Reads the addresses of earlier datagrams whose hosts answered that no socket receives there.
    pub(super) fn read_refusals(&mut self) {
        #[cfg(any(target_os = "linux", target_os = "android"))]
        for _ in 0..MOST_REFUSALS {
            const ERROR_QUEUE: i32 = 0x2000; // MSG_ERRQUEUE of socket.h
            let mut to = SockAddr::from(SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, 0));
            let mut message = socket2::MsgHdrMut::new().with_addr(&mut to);
            if SockRef::from(&self.unicast).recvmsg(&mut message, ERROR_QUEUE).is_err() {
                break;
            }
            if let Some(to) = to.as_socket_ipv4().filter(|to| !self.refusals.contains(to)) {
                self.refusals.push(to);
            }
        }
    }

    /// Takes the addresses whose hosts answered that no socket receives there.
    pub(super) fn take_refusals(&mut self) -> Vec<SocketAddrV4> {
        std::mem::take(&mut self.refusals)
    }

    /// Sends a datagram to a group, on every interface. Announcements are repeated, so one that does not fit
    /// into the send buffer is dropped.
    pub(super) fn send_to_group(&mut self, group: SocketAddrV4, datagram: &[u8]) {
        for index in 0..self.multicast.len() {
            let sent = send(&self.multicast[index].1, group, datagram);
            self.outcome(group, sent);
        }
    }

    fn outcome(&mut self, to: SocketAddrV4, sent: io::Result<usize>) -> Sent {
        match sent {
            Ok(_) => Sent::Done,
            Err(error) if error.kind() == io::ErrorKind::WouldBlock => Sent::Full,
            // Missing buffers or routes, interfaces that are down, and firewalls are treated as losses in the
            // network.
            Err(error) => {
                if self.log.allow() {
                    tracing::warn!(
                        "sending to {to} failed: {error}; what is reliable is sent again when the network is back"
                    );
                }
                Sent::Done
            }
        }
    }
}

fn send(socket: &UdpSocket, to: SocketAddrV4, datagram: &[u8]) -> io::Result<usize> {
    loop {
        match socket.send_to(datagram, SocketAddr::V4(to)) {
            Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
            sent => return sent,
        }
    }
}

/// The address to which sockets are bound.
fn address(range: Range) -> Ipv4Addr {
    match range {
        Range::Off | Range::Localhost => Ipv4Addr::LOCALHOST,
        Range::Subnet => Ipv4Addr::UNSPECIFIED,
    }
}

fn bind_pair(ports: Ports, address: Ipv4Addr) -> Result<((u16, u16), [Socket; 2]), JoinError> {
    let mut last = io::Error::from(io::ErrorKind::AddrNotAvailable);
    for (meta, user) in ports.of_participants() {
        let bind = |port| bind(SocketAddrV4::new(address, port));
        match bind(meta).and_then(|first| Ok([first, bind(user)?])) {
            Ok(pair) => return Ok(((meta, user), pair)),
            Err(error) => last = error,
        }
    }
    let first = ports.of_participants().next().map_or(0, |(meta, _)| meta);
    Err(JoinError::NoFreePort { address, first, source: last })
}

fn socket() -> io::Result<Socket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_nonblocking(true)?;
    Ok(socket)
}

fn bind(address: SocketAddrV4) -> io::Result<Socket> {
    let socket = socket()?;
    // The system may grant less; the actual size is read back.
    let _ = socket.set_recv_buffer_size(SOCKET_BUFFER);
    socket.bind(&SockAddr::from(address))?;
    Ok(socket)
}

/// Creates a socket for the group. All participants of the domain on this machine share its port.
fn bind_group(group: SocketAddrV4) -> io::Result<Socket> {
    let socket = socket()?;
    socket.set_reuse_address(true)?;
    #[cfg(unix)]
    socket.set_reuse_port(true)?;
    let _ = socket.set_recv_buffer_size(SOCKET_BUFFER);
    // The socket receives only datagrams to the group, and only on joined interfaces.
    #[cfg(any(target_os = "linux", target_os = "android"))]
    socket.set_multicast_all_v4(false)?;
    let address = if cfg!(unix) { group } else { SocketAddrV4::new(Ipv4Addr::UNSPECIFIED, group.port()) };
    socket.bind(&SockAddr::from(address))?;
    Ok(socket)
}

fn sender(address: Ipv4Addr) -> io::Result<UdpSocket> {
    let socket = socket()?;
    let _ = socket.set_send_buffer_size(SOCKET_BUFFER);
    socket.bind(&SockAddr::from(SocketAddrV4::new(address, 0)))?;
    Ok(UdpSocket::from_std(socket.into()))
}

fn multicast_sender(address: Ipv4Addr, interface: Ipv4Addr) -> io::Result<UdpSocket> {
    let sender = sender(address)?;
    let socket = SockRef::from(&sender);
    socket.set_multicast_if_v4(&interface)?;
    socket.set_multicast_loop_v4(true)?;
    Ok(sender)
}

/// The receive buffer size of a socket. Linux reports twice the size, including its own overhead.
fn buffer_of(socket: &UdpSocket) -> usize {
    let reported = SockRef::from(socket).recv_buffer_size().unwrap_or_default();
    if cfg!(target_os = "linux") { reported / 2 } else { reported }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::driver::interfaces::Interfaces;
    use mio::{Events, Poll};
    use std::time::Duration;

    const DOMAIN: u16 = 201;

    #[test]
    fn each_participant_of_a_host_has_its_own_ports() {
        let (ports, poll) = (Ports::of_domain(DOMAIN).unwrap(), Poll::new().unwrap());
        let bind = || Receivers::bind(ports, Range::Localhost, poll.registry()).unwrap();
        let (first, second) = (bind(), bind());
        assert_ne!(first.meta_port, second.meta_port);
        assert_eq!((first.user_port, second.user_port), (first.meta_port + 1, second.meta_port + 1));
        let meta_port = first.meta_port;
        drop(first);
        assert_eq!(bind().meta_port, meta_port, "the first that is free");
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_closed_port_is_reported_with_its_address_and_keeps_no_datagram_back() {
        let poll = Poll::new().unwrap();
        let mut senders = Senders::bind(Range::Localhost, poll.registry(), Token(9)).unwrap();
        let bind = || std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let address_of = |socket: &std::net::UdpSocket| match socket.local_addr().unwrap() {
            SocketAddr::V4(address) => address,
            SocketAddr::V6(_) => unreachable!(),
        };
        let (open, closed) = (bind(), [bind(), bind()].map(|socket| address_of(&socket)));
        open.set_read_timeout(Some(Duration::from_secs(10))).unwrap();
        for number in 0..20_u8 {
            for closed in closed {
                assert_eq!(senders.send(closed, &[number]), Sent::Done);
            }
            assert_eq!(senders.send(address_of(&open), &[number]), Sent::Done);
            let mut received = [0; 2];
            assert_eq!((open.recv(&mut received).unwrap(), received[0]), (1, number));
        }
        senders.read_refusals();
        let mut refusals = senders.take_refusals();
        refusals.sort_unstable();
        let mut expected = closed.to_vec();
        expected.sort_unstable();
        assert_eq!(refusals, expected);
    }

    #[test]
    fn datagrams_to_the_group_and_to_the_address_arrive_over_loopback() {
        let (ports, mut poll) = (Ports::of_domain(DOMAIN + 1).unwrap(), Poll::new().unwrap());
        let interfaces = Interfaces::read(Range::Localhost, &Interfaces::default()).unwrap();
        let interfaces = interfaces.used();
        let mut receivers = Receivers::bind(ports, Range::Localhost, poll.registry()).unwrap();
        receivers.join(interfaces);
        let mut senders = Senders::bind(Range::Localhost, poll.registry(), Token(9)).unwrap();
        senders.set_interfaces(interfaces);
        senders.send_to_group(ports.group(), b"group");
        for port in [receivers.meta_port, receivers.user_port] {
            assert_eq!(senders.send(SocketAddrV4::new(Ipv4Addr::LOCALHOST, port), &[7; 65_000]), Sent::Done);
        }
        let (mut events, mut buffers, mut received) = (Events::with_capacity(8), Buffers::new(), Vec::new());
        while received.len() < 3 {
            poll.poll(&mut events, Some(Duration::from_secs(10))).unwrap();
            assert!(!events.is_empty(), "only {received:?} arrived");
            for token in events.iter().filter(|event| event.is_readable()).map(|event| event.token()) {
                receivers.receive(token, &mut buffers, |from, datagram| {
                    assert_eq!(*from.ip(), Ipv4Addr::LOCALHOST);
                    received.push(datagram.len());
                });
            }
        }
        received.sort_unstable();
        assert_eq!(received, [5, 65_000, 65_000]);
    }

    #[test]
    fn a_datagram_that_cannot_be_sent_counts_as_lost() {
        let poll = Poll::new().unwrap();
        let mut senders = Senders::bind(Range::Localhost, poll.registry(), Token(9)).unwrap();
        // Other hosts cannot be reached from loopback.
        assert_eq!(senders.send(SocketAddrV4::new(Ipv4Addr::new(192, 0, 2, 1), 9), b"x"), Sent::Done);
    }
}
