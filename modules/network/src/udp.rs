//! A UDP socket as a device: every datagram in and out is published, so that a replay repeats it without the network.

use std::io::{self, ErrorKind};
use std::net::{SocketAddr, SocketAddrV4, UdpSocket};
use std::time::Duration;

use downbeat_executor::{Context, Publication, Time};
use downbeat_modules::device::{Device, DeviceLink};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use socket2::{Domain, Protocol, Socket, Type};

/// Longer datagrams are cut off, and thereby refused by those who read them.
pub const LONGEST: usize = 2048;
/// The most datagrams that are taken in one run of a module: more is a flood, which waits and overflows in the socket.
const MOST_IN_ONE_RUN: usize = 32;
/// How long a module waits before it opens a socket again.
const RETRY: Duration = Duration::from_secs(1);

/// What a module wants of its socket.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Take the next datagram, if there is one.
    Receive,
    /// Send this to the target.
    Send(Vec<u8>),
}

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
            None => open(receives_on)?,
        };
        let result = match request {
            Request::Receive => self.receive(&socket, target),
            Request::Send(bytes) => match target {
                Target::Address(address) => socket.send_to(bytes, address).map(|_| Vec::new()),
                Target::LastSender { port, .. } => match self.last_sender {
                    Some(sender) => socket.send_to(bytes, (sender.ip(), port)).map(|_| Vec::new()),
                    None => Err(io::Error::new(ErrorKind::NotConnected, "nobody to answer to")),
                },
            },
        };
        // Unreachable targets are reported on the socket, which stays usable.
        self.socket = Some(socket);
        result
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
        let outcome = match self.attempt(request) {
            Ok(reply) => return BusExchange { reply, ..exchange_of(request, now) },
            Err(error) if error.kind() == ErrorKind::WouldBlock => (BusExchange::TIMEOUT, String::new()),
            Err(error) => (BusExchange::FAILED, error.to_string()),
        };
        BusExchange { outcome: outcome.0, error: outcome.1, ..exchange_of(request, now) }
    }

    fn answers(exchange: &BusExchange, request: &Request) -> bool {
        let expected = exchange_of(request, Time::ZERO);
        exchange.kind == expected.kind && exchange.instruction == expected.instruction
    }

    fn failed(request: &Request, now: Time, reason: &str) -> BusExchange {
        BusExchange { outcome: BusExchange::FAILED, error: reason.to_owned(), ..exchange_of(request, now) }
    }
}

fn exchange_of(request: &Request, now: Time) -> BusExchange {
    let instruction = match request {
        Request::Receive => Vec::new(),
        Request::Send(bytes) => bytes.clone(),
    };
    let stamp = Stamp::from_nanos(now.as_nanos());
    BusExchange { stamp, kind: BusExchange::TRANSFER, instruction, ..BusExchange::default() }
}

/// A module's socket: receives what has come, and reports failures once.
pub(crate) struct Mailbox {
    link: DeviceLink<Udp>,
    failure: String,
    not_before: Time,
}

impl Mailbox {
    pub(crate) fn new(link: DeviceLink<Udp>) -> Self {
        Self { link, failure: String::new(), not_before: Time::ZERO }
    }

    pub(crate) fn configure(&mut self, receives_on: SocketAddrV4, target: Target) {
        if let Some(udp) = self.link.device() {
            udp.configure(receives_on, target);
        }
    }

    /// The datagrams that have come since the last run.
    pub(crate) fn receive<P>(
        &mut self,
        topic: Publication<BusExchange>,
        ctx: &mut Context<'_, P>,
    ) -> Vec<Vec<u8>> {
        let mut datagrams = Vec::new();
        if ctx.now() < self.not_before {
            return datagrams;
        }
        while datagrams.len() < MOST_IN_ONE_RUN {
            let exchange = self.link.exchange(&Request::Receive, topic, ctx);
            match exchange.outcome {
                BusExchange::OK => datagrams.push(exchange.reply.to_vec()),
                BusExchange::TIMEOUT => break,
                _ => {
                    self.report("receive", exchange.error, ctx.now());
                    break;
                }
            }
        }
        datagrams
    }

    pub(crate) fn send<P>(
        &mut self,
        bytes: Vec<u8>,
        topic: Publication<BusExchange>,
        ctx: &mut Context<'_, P>,
    ) {
        let exchange = self.link.exchange(&Request::Send(bytes), topic, ctx);
        if exchange.outcome == BusExchange::FAILED {
            self.report("send", exchange.error, ctx.now());
        }
    }

    fn report(&mut self, attempted: &str, failure: String, now: Time) {
        self.not_before = now + RETRY;
        if self.failure != failure {
            tracing::warn!("cannot {attempted} datagrams: {failure}; this is tried again every second");
            self.failure = failure;
        }
    }
}
