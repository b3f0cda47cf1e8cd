//! What the modules with sockets share: requests, how their outcomes are recorded, and the reports of
//! failures.

use std::collections::VecDeque;
use std::io::{self, ErrorKind};
use std::net::SocketAddrV4;
use std::time::Duration;

use downbeat_device::{Device, DeviceLink};
use downbeat_executor::{Context, Publication, Time};
use downbeat_msgs::builtin_interfaces::msg::Time as Stamp;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;

/// Longer datagrams are cut off, and thereby refused by those who read them; longer lines are dropped.
pub const LONGEST: usize = 2048;
/// The most datagrams or lines that are taken in one run of a module: more is a flood, which waits and
/// overflows in the socket.
const MOST_IN_ONE_RUN: usize = 32;
/// How long a module waits before it opens a socket again.
const RETRY: Duration = Duration::from_secs(1);

/// How many lines wait to be sent; older ones are dropped.
const MOST_WAITING: usize = 256;

/// What a module wants of its socket.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Request {
    /// Take the next datagram or line, if there is one.
    Receive,
    /// Send this to the target.
    Send(Vec<u8>),
}

/// A module's socket: receives what has come, and reports failures once.
pub struct Mailbox<D: Device> {
    link: DeviceLink<D>,
    failure: String,
    not_before: Time,
}

impl<D: Device<Request = Request, Exchange = BusExchange>> Mailbox<D> {
    /// A mailbox on this link.
    #[must_use]
    pub fn new(link: DeviceLink<D>) -> Self {
        Self { link, failure: String::new(), not_before: Time::ZERO }
    }

    /// The socket, unless this is a replay.
    pub fn device(&mut self) -> Option<&mut D> {
        self.link.device()
    }

    /// What has come since the last run, at most 32 datagrams or lines: more is a flood, which waits.
    /// Publishes the exchanges on `topic`.
    pub fn receive<P>(&mut self, topic: Publication<BusExchange>, ctx: &mut Context<'_, P>) -> Vec<Vec<u8>> {
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
                    self.report(exchange.error, "; this is tried again every second", ctx.now());
                    break;
                }
            }
        }
        datagrams
    }

    /// Sends a datagram or a line, and publishes on `topic` what became of it.
    pub fn send<P>(&mut self, bytes: Vec<u8>, topic: Publication<BusExchange>, ctx: &mut Context<'_, P>) {
        let exchange = self.link.exchange(&Request::Send(bytes), topic, ctx);
        if exchange.outcome == BusExchange::FAILED {
            self.report(exchange.error, "", ctx.now());
        }
    }

    fn report(&mut self, failure: String, what_follows: &str, now: Time) {
        self.not_before = now + RETRY;
        if self.failure != failure {
            tracing::warn!("{failure}{what_follows}");
            self.failure = failure;
        }
    }
}

/// Lines that wait to be sent.
#[derive(Default)]
pub(crate) struct Waiting {
    lines: VecDeque<Vec<u8>>,
    dropped: u64,
}

impl Waiting {
    pub(crate) fn keep(&mut self, line: &str) {
        if line.len() >= LONGEST || self.lines.len() == MOST_WAITING {
            self.dropped += 1;
            if self.dropped.is_power_of_two() {
                tracing::warn!(
                    "{} lines were not sent: at most {MOST_WAITING} wait, each shorter than {LONGEST} bytes",
                    self.dropped
                );
            }
        }
        if line.len() < LONGEST {
            if self.lines.len() == MOST_WAITING {
                self.lines.pop_front();
            }
            self.lines.push_back([line.as_bytes(), b"\n"].concat());
        }
    }

    /// The next line, with a line feed.
    pub(crate) fn next(&mut self) -> Option<Vec<u8>> {
        self.lines.pop_front()
    }
}

/// Why nothing can listen on an address, with what to do; `protocol` is `TCP` or `UDP`.
pub(crate) fn cannot_listen(error: &io::Error, protocol: &str, address: SocketAddrV4) -> io::Error {
    let remedy = match error.kind() {
        ErrorKind::AddrInUse => {
            let (option, port) = (if protocol == "TCP" { "-ltnp" } else { "-lunp" }, address.port());
            format!("; choose another port, or end the program that `ss {option} 'sport = :{port}'` shows")
        }
        ErrorKind::AddrNotAvailable => {
            "; `ip -brief address` lists the addresses of this machine, and 0.0.0.0 stands for all of them"
                .to_owned()
        }
        ErrorKind::PermissionDenied => "; choose a port from 1024 on".to_owned(),
        _ => String::new(),
    };
    io::Error::new(error.kind(), format!("cannot listen on {protocol} {address}: {error}{remedy}"))
}

/// Why another program cannot be reached, with what to do: `attempted` names its address. An error that says
/// "not yet" stays as it is.
pub(crate) fn cannot_reach(error: io::Error, attempted: &str) -> io::Error {
    let remedy = match error.kind() {
        ErrorKind::WouldBlock => return error,
        ErrorKind::ConnectionRefused | ErrorKind::TimedOut => {
            "; start the program that listens there, or correct the address in the robot file"
        }
        ErrorKind::NetworkUnreachable | ErrorKind::HostUnreachable => {
            "; connect this machine with that network, or correct the address in the robot file"
        }
        _ => "",
    };
    io::Error::new(error.kind(), format!("cannot {attempted}: {error}{remedy}"))
}

/// The record of what became of a request.
pub(crate) fn outcome_of(outcome: io::Result<Vec<u8>>, request: &Request, now: Time) -> BusExchange {
    let (outcome, error) = match outcome {
        Ok(reply) => return BusExchange { reply, ..exchange_of(request, now) },
        Err(error) if error.kind() == ErrorKind::WouldBlock => (BusExchange::TIMEOUT, String::new()),
        Err(error) => (BusExchange::FAILED, error.to_string()),
    };
    BusExchange { outcome, error, ..exchange_of(request, now) }
}

pub(crate) fn exchange_of(request: &Request, now: Time) -> BusExchange {
    let instruction = match request {
        Request::Receive => Vec::new(),
        Request::Send(bytes) => bytes.clone(),
    };
    let stamp = Stamp::from_nanos(now.as_nanos());
    BusExchange { stamp, kind: BusExchange::TRANSFER, instruction, ..BusExchange::default() }
}
