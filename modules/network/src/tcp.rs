//! Lines on TCP as a device: a server or a client whose lines are recorded, so that a replay repeats them
//! without the network.

use std::io::{self, ErrorKind, Read, Write};
use std::net::{SocketAddrV4, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use downbeat_device::Device;
use downbeat_executor::Time;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use socket2::{Domain, Protocol, Socket, Type};

pub use crate::mailbox::Request;
use crate::mailbox::{cannot_listen, cannot_reach, exchange_of, outcome_of};
use crate::udp::LONGEST;

/// How many peers a server has at most; others are turned away.
pub const MOST_PEERS: usize = 8;
/// How much waits for a peer that does not read; then it is left.
const MOST_UNSENT: usize = 256 * LONGEST;
/// How long a client waits for an answer to its connection.
const PATIENCE: Duration = Duration::from_secs(5);

/// Which side opens connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Side {
    /// It listens on this address. Lines go to all peers.
    Server(SocketAddrV4),
    /// It connects to this address, and again when the connection is lost.
    Client(SocketAddrV4),
}

/// A server or client for lines, opened when it is first used. It never waits.
#[derive(Debug, Default)]
pub struct Tcp {
    side: Option<Side>,
    listener: Option<TcpListener>,
    connecting: Option<(Socket, Instant)>,
    peers: Vec<Peer>,
}

#[derive(Debug)]
struct Peer {
    stream: TcpStream,
    received: Vec<u8>,
    unsent: Vec<u8>,
    /// Within a line that was too long.
    is_skipping: bool,
    /// No more comes; what was received is still read.
    is_over: bool,
}

impl Tcp {
    /// Sets the side and the address. Before that, every exchange fails.
    pub fn configure(&mut self, side: Side) {
        *self = Self { side: Some(side), ..Self::default() };
    }

    fn attempt(&mut self, request: &Request) -> io::Result<Vec<u8>> {
        let not_connected = match self.side.ok_or(ErrorKind::AddrNotAvailable)? {
            Side::Server(address) => {
                self.accept(address)?;
                format!("cannot send a line: no program is connected to TCP {address}")
            }
            Side::Client(address) => {
                self.connect(address)
                    .map_err(|error| cannot_reach(error, &format!("connect to TCP {address}")))?;
                format!("cannot send a line: this is not connected to TCP {address} yet")
            }
        };
        match request {
            Request::Receive => {
                let line = self.peers.iter_mut().find_map(Peer::next_line);
                self.peers.retain_mut(|peer| peer.is_open());
                line.ok_or_else(|| ErrorKind::WouldBlock.into())
            }
            Request::Send(_) if self.peers.is_empty() => {
                Err(io::Error::new(ErrorKind::NotConnected, not_connected))
            }
            Request::Send(line) => {
                self.peers.iter_mut().for_each(|peer| peer.send(line));
                Ok(Vec::new())
            }
        }
    }

    fn accept(&mut self, address: SocketAddrV4) -> io::Result<()> {
        let listener = match &mut self.listener {
            Some(listener) => listener,
            none => {
                let listener = TcpListener::bind(address);
                let listener = listener.map_err(|error| cannot_listen(&error, "TCP", address))?;
                listener.set_nonblocking(true)?;
                none.insert(listener)
            }
        };
        loop {
            match listener.accept() {
                Ok((stream, _)) if self.peers.len() < MOST_PEERS => self.peers.push(Peer::new(stream)?),
                Ok((_, peer)) => tracing::warn!("{peer} is turned away: {MOST_PEERS} peers are connected"),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return Ok(()),
                Err(error) => return Err(cannot_listen(&error, "TCP", address)),
            }
        }
    }

    fn connect(&mut self, address: SocketAddrV4) -> io::Result<()> {
        if !self.peers.is_empty() {
            return Ok(());
        }
        let Some((socket, since)) = self.connecting.take() else {
            let socket = Socket::new(Domain::IPV4, Type::STREAM, Some(Protocol::TCP))?;
            socket.set_nonblocking(true)?;
            // What becomes of it is asked next time.
            let _ = socket.connect(&address.into());
            self.connecting = Some((socket, Instant::now()));
            return Ok(());
        };
        if let Some(error) = socket.take_error()? {
            return Err(error);
        }
        if socket.peer_addr().is_ok() {
            self.peers.push(Peer::new(socket.into())?);
        } else if since.elapsed() < PATIENCE {
            self.connecting = Some((socket, since));
        } else {
            return Err(io::Error::new(ErrorKind::TimedOut, "no answer"));
        }
        Ok(())
    }
}

impl Peer {
    fn new(stream: TcpStream) -> io::Result<Self> {
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
        Ok(Self { stream, received: Vec::new(), unsent: Vec::new(), is_skipping: false, is_over: false })
    }

    /// The next whole line, without its end.
    fn next_line(&mut self) -> Option<Vec<u8>> {
        loop {
            if let Some(end) = self.received.iter().position(|byte| *byte == b'\n') {
                let mut line: Vec<u8> = self.received.drain(..=end).collect();
                line.pop();
                line.pop_if(|byte| *byte == b'\r');
                if std::mem::take(&mut self.is_skipping) {
                    continue;
                }
                return Some(line);
            }
            if self.received.len() >= LONGEST {
                if !self.is_skipping {
                    tracing::warn!("a line of more than {LONGEST} bytes was dropped");
                }
                self.is_skipping = true;
                self.received.clear();
            }
            let mut buffer = [0; LONGEST];
            match self.stream.read(&mut buffer) {
                Ok(0) => self.is_over = true,
                Ok(length) => {
                    self.received.extend(buffer.get(..length).unwrap_or_default());
                    continue;
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(_) => self.is_over = true,
            }
            return None;
        }
    }

    fn send(&mut self, line: &[u8]) {
        self.unsent.extend(line);
        self.flush();
    }

    fn flush(&mut self) {
        while !self.unsent.is_empty() {
            match self.stream.write(&self.unsent) {
                Ok(length) if length > 0 => drop(self.unsent.drain(..length)),
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                _ => {
                    self.is_over = true;
                    self.unsent.clear();
                }
            }
        }
        if self.unsent.len() > MOST_UNSENT {
            tracing::warn!("a peer that does not read was left");
            self.is_over = true;
        }
    }

    fn is_open(&mut self) -> bool {
        self.flush();
        !self.is_over || self.received.contains(&b'\n')
    }
}

impl Device for Tcp {
    type Request = Request;
    type Exchange = BusExchange;
    const TOPIC: &'static str = "lines/exchanges";

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
