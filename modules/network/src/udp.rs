//! A UDP socket as a device: every datagram in and out is published, so that a replay repeats it without the
//! network.

use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, SocketAddr, SocketAddrV4, UdpSocket};

use downbeat_device::Device;
use downbeat_executor::{Module, Setting, Setup, SetupError, Time};
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use socket2::{Domain, Protocol, Socket, Type};

pub use crate::mailbox::{LONGEST, Request};
use crate::mailbox::{cannot_listen, cannot_reach, exchange_of, outcome_of};

/// Where datagrams go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Target {
    /// To an address, which may be one of broadcast.
    Address(SocketAddr),
    /// To this port of the machine that sent the last datagram which began with these bytes.
    LastSender {
        /// The port.
        port: u16,
        /// The bytes.
        prefix: [u8; 4],
    },
}

/// A UDP socket that is opened when it is first used. Several processes of one machine may share its port.
#[derive(Debug, Default)]
pub struct Udp {
    addresses: Option<(SocketAddrV4, Target)>,
    socket: Option<UdpSocket>,
    last_sender: Option<SocketAddr>,
}

impl Udp {
    /// Sets where the socket receives and to whom it sends. Before that, every exchange fails.
    pub fn configure(&mut self, receives_on: SocketAddrV4, target: Target) {
        self.addresses = Some((receives_on, target));
        self.socket = None;
    }

    fn attempt(&mut self, request: &Request) -> io::Result<Vec<u8>> {
        let (receives_on, target) = self.addresses.ok_or(ErrorKind::AddrNotAvailable)?;
        let socket = match self.socket.take() {
            Some(socket) => socket,
            None => open(receives_on).map_err(|error| cannot_listen(&error, "UDP", receives_on))?,
        };
        let result = match request {
            Request::Receive => self
                .receive(&socket, target)
                .map_err(|error| cannot_reach(error, &format!("receive on UDP {receives_on}"))),
            Request::Send(bytes) => self.send(&socket, bytes, target),
        };
        // Unreachable targets are reported on the socket, which stays usable.
        self.socket = Some(socket);
        result
    }

    fn send(&self, socket: &UdpSocket, bytes: &[u8], target: Target) -> io::Result<Vec<u8>> {
        let address = match (target, self.last_sender) {
            (Target::Address(address), _) => address,
            (Target::LastSender { port, .. }, Some(sender)) => SocketAddr::new(sender.ip(), port),
            (Target::LastSender { .. }, None) => {
                return Err(io::Error::new(
                    ErrorKind::NotConnected,
                    "cannot send a datagram: no program has sent one to which it is the answer",
                ));
            }
        };
        let sent = socket.send_to(bytes, address).map(|_| Vec::new());
        sent.map_err(|error| cannot_reach(error, &format!("send to UDP {address}")))
    }

    fn receive(&mut self, socket: &UdpSocket, target: Target) -> io::Result<Vec<u8>> {
        let mut buffer = [0; LONGEST];
        match socket.recv_from(&mut buffer) {
            Ok((length, sender)) => {
                let bytes = buffer.get(..length).unwrap_or_default();
                if let Target::LastSender { prefix, .. } = target
                    && bytes.starts_with(&prefix)
                {
                    self.last_sender = Some(sender);
                }
                Ok(bytes.to_vec())
            }
            Err(error) => Err(error),
        }
    }
}

/// Finds a port of this machine that is free, and keeps it until the socket is dropped: only those who share
/// it, as the modules here do, can use it. What is sent to addresses of broadcast does not come to the
/// socket.
///
/// # Errors
/// If no port is free.
pub fn keep_free_port() -> io::Result<(UdpSocket, u16)> {
    let socket = open(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 0))?;
    let port = socket.local_addr()?.port();
    Ok((socket, port))
}

/// The address that a setting of a module gives.
///
/// # Errors
/// Refuses a value that is no IPv4 address.
pub fn address_of<M: Module>(setup: &Setup<'_, M>, setting: Setting<String>) -> Result<Ipv4Addr, SetupError> {
    let address = setup.value(setting).and_then(|address| address.parse().ok());
    address.ok_or_else(|| setup.refuse_value(setting, "it is no IPv4 address, such as 192.168.1.255"))
}

fn open(address: SocketAddrV4) -> io::Result<UdpSocket> {
    let socket = Socket::new(Domain::IPV4, Type::DGRAM, Some(Protocol::UDP))?;
    socket.set_reuse_address(true)?;
    #[cfg(unix)]
    socket.set_reuse_port(true)?;
    socket.set_broadcast(true)?;
    socket.set_nonblocking(true)?;
    socket.bind(&address.into())?;
    Ok(socket.into())
}

impl Device for Udp {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = "datagrams";

    fn exchange(&mut self, request: &Request, now: Time) -> BusExchange {
        outcome_of(self.attempt(request), request, now)
    }

    fn answers(exchange: &BusExchange, request: &Request) -> bool {
        exchange.instruction == exchange_of(request, Time::ZERO).instruction
    }

    fn failed(request: &Request, now: Time, reason: &str) -> BusExchange {
        BusExchange { outcome: BusExchange::FAILED, error: reason.to_owned(), ..exchange_of(request, now) }
    }
}
