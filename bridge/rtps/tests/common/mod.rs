//! Participants connected in memory, with a clock that the test controls.

#![allow(dead_code)] // each test program uses a part

use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddrV4},
    time::{Duration, Instant},
};

use bytes::Bytes;
use downbeat_rtps::{
    protocol::{
        Addresses, Config, Destination, EndpointConfig, Event, Guard, Interface, Now, Participant,
        WriteOptions,
    },
    qos::{Durability, History, Qos, Reliability},
    wire::{EntityId, Guid, GuidPrefix, SequenceNumber, Submessage, parse},
};

/// The group of announcements.
pub const GROUP: SocketAddrV4 = SocketAddrV4::new(Ipv4Addr::new(239, 255, 0, 1), 7400);
pub const METATRAFFIC_PORT: u16 = 7410;
pub const USER_PORT: u16 = 7411;

/// Default transmission time of a datagram; `Fate` may define another one.
pub const DELAY: Duration = Duration::from_micros(50);

/// A datagram in flight.
pub struct Flight {
    /// Index of the node that sent it.
    pub sender: usize,
    pub from: SocketAddrV4,
    pub to: SocketAddrV4,
    pub bytes: Vec<u8>,
}

/// Returns the delay of each arrival of a datagram: none is a loss, two are a duplicate.
pub type Fate = Box<dyn FnMut(&Flight) -> Vec<Duration>>;

/// A host with one participant.
pub struct Node {
    pub participant: Participant,
    pub address: Ipv4Addr,
    pub events: Vec<Event>,
    /// `false` while it is suspended: it neither receives nor runs timers.
    pub is_running: bool,
    /// Number and bytes of the datagrams that it sent.
    pub sent: (u64, u64),
    next_timeout: Option<Instant>,
}

impl Node {
    /// The texts that a reader received, without encapsulation.
    pub fn texts(&self, of: EntityId) -> Vec<String> {
        let samples = self.events.iter().filter_map(|event| match event {
            Event::Sample { reader, sample } if *reader == of => Some(&sample.payload[4..]),
            _ => None,
        });
        samples.map(|text| String::from_utf8_lossy(text).into_owned()).collect()
    }

    pub fn count(&self, is_counted: impl Fn(&Event) -> bool) -> usize {
        self.events.iter().filter(|event| is_counted(event)).count()
    }
}

/// Hosts of one subnet.
pub struct Network {
    pub nodes: Vec<Node>,
    pub fate: Fate,
    /// Called for each datagram when it is sent.
    pub watch: Box<dyn FnMut(&Flight)>,
    /// The range of the last heartbeat of each writer to each participant.
    pub heartbeats: BTreeMap<(GuidPrefix, EntityId), (SequenceNumber, SequenceNumber)>,
    /// Pairs of nodes between which all datagrams are lost, in this direction.
    pub cut: Vec<(usize, usize)>,
    /// Offset by which the wall clocks were set forward.
    pub wall_offset_ns: i64,
    start: Instant,
    pub elapsed: Duration,
    /// By time of arrival, then in the order of sending.
    flying: BTreeMap<(Duration, u64), Flight>,
    launched: u64,
}

/// 2027-01-15.
const WALL_START_NS: i64 = 1_800_000_000_000_000_000;

impl Network {
    pub fn new(nodes: u8) -> Self {
        let mut network = Self {
            nodes: Vec::new(),
            fate: Box::new(|_| vec![DELAY]),
            watch: Box::new(|_| {}),
            heartbeats: BTreeMap::new(),
            cut: Vec::new(),
            wall_offset_ns: 0,
            start: Instant::now(),
            elapsed: Duration::ZERO,
            flying: BTreeMap::new(),
            launched: 0,
        };
        for _ in 0..nodes {
            network.join(|_| {});
        }
        network
    }

    /// Adds a host with a participant whose configuration `change` modifies. Returns its index.
    pub fn join(&mut self, change: impl FnOnce(&mut Config)) -> usize {
        self.join_at(Ipv4Addr::from(0x0a00_0001 + self.nodes.len() as u32), change)
    }

    pub fn join_at(&mut self, address: Ipv4Addr, change: impl FnOnce(&mut Config)) -> usize {
        let mut unique = [0; 10];
        unique[..4].copy_from_slice(&address.octets());
        unique[4..8].copy_from_slice(&(self.nodes.len() as u32).to_be_bytes());
        let mut config = Config::new(unique, 0, addresses(address));
        config.secret = self.nodes.len() as u64;
        change(&mut config);
        let participant = match crate::guard(&config) {
            None => Participant::new(config, self.now()),
            Some((prefix, guard)) => Participant::with_guard(Config { prefix, ..config }, guard, self.now()),
        };
        let next_timeout = participant.next_timeout();
        self.nodes.push(Node {
            participant,
            address,
            events: Vec::new(),
            is_running: true,
            sent: (0, 0),
            next_timeout,
        });
        self.nodes.len() - 1
    }

    pub fn now(&self) -> Now {
        let wall_ns = WALL_START_NS + self.wall_offset_ns + self.elapsed.as_nanos() as i64;
        Now { steady: self.start + self.elapsed, wall_ns }
    }

    /// Calls a participant and transmits its datagrams.
    pub fn call<T>(&mut self, node: usize, call: impl FnOnce(&mut Participant, Now) -> T) -> T {
        let now = self.now();
        let result = call(&mut self.nodes[node].participant, now);
        self.collect(node);
        result
    }

    /// Injects a datagram from another sender.
    pub fn inject(&mut self, node: usize, from: SocketAddrV4, bytes: &[u8]) {
        self.call(node, |participant, now| participant.handle_datagram(now, from, bytes));
    }

    fn collect(&mut self, index: usize) {
        let now = self.now();
        let mut datagram = Vec::new();
        for turn in 0.. {
            assert!(turn < 1_000_000, "a participant never stops sending");
            let node = &mut self.nodes[index];
            let Some(destination) = node.participant.poll_transmit(now, &mut datagram) else { break };
            let to = match destination {
                Destination::Unicast(to) | Destination::Multicast(to) => to,
                Destination::Own => panic!("own datagrams do not leave"),
            };
            node.sent.0 += 1;
            node.sent.1 += datagram.len() as u64;
            let from = SocketAddrV4::new(node.address, METATRAFFIC_PORT);
            let flight = Flight { sender: index, from, to, bytes: datagram.clone() };
            (self.watch)(&flight);
            self.note_heartbeats(&flight.bytes);
            for delay in (self.fate)(&flight) {
                self.launched += 1;
                let copy = Flight { bytes: flight.bytes.clone(), ..flight };
                self.flying.insert((self.elapsed + delay, self.launched), copy);
            }
        }
        let node = &mut self.nodes[index];
        while let Some(event) = node.participant.poll_event() {
            node.events.push(event);
        }
        node.next_timeout = node.participant.next_timeout();
    }

    fn note_heartbeats(&mut self, datagram: &[u8]) {
        let Ok((_, submessages)) = parse(datagram) else { return };
        let mut destination = GuidPrefix::UNKNOWN;
        for submessage in submessages.map_while(Result::ok) {
            match submessage {
                Submessage::InfoDestination(prefix) => destination = prefix,
                Submessage::Heartbeat(heartbeat) => {
                    let range = (heartbeat.first, heartbeat.last);
                    self.heartbeats.insert((destination, heartbeat.writer), range);
                }
                _ => {}
            }
        }
    }

    /// Runs the network for a duration.
    pub fn run_for(&mut self, duration: Duration) {
        self.run_until(duration, |_| false);
    }

    /// Runs until `is_done`, at most for `limit`. Returns whether it became true.
    pub fn run_until(&mut self, limit: Duration, is_done: impl Fn(&Self) -> bool) -> bool {
        let end = self.elapsed + limit;
        loop {
            if is_done(self) {
                return true;
            }
            let running = self.nodes.iter().filter(|node| node.is_running);
            let timeout = running.filter_map(|node| node.next_timeout).min();
            let timeout = timeout.map(|at| at.saturating_duration_since(self.start));
            let arrival = self.flying.keys().next().map(|(at, _)| *at);
            let Some(next) = timeout.into_iter().chain(arrival).min().filter(|next| *next <= end) else {
                self.elapsed = end;
                return is_done(self);
            };
            self.elapsed = self.elapsed.max(next);
            if arrival == Some(next) {
                let (_, flight) = self.flying.pop_first().expect("something arrives");
                self.deliver(&flight);
            } else {
                let now = self.now();
                for index in 0..self.nodes.len() {
                    let node = &self.nodes[index];
                    if node.is_running && node.next_timeout.is_some_and(|at| at <= now.steady) {
                        self.call(index, |participant, now| participant.handle_timeout(now));
                    }
                }
            }
        }
    }

    fn deliver(&mut self, flight: &Flight) {
        for index in 0..self.nodes.len() {
            let node = &self.nodes[index];
            let is_for_it = flight.to.ip().is_multicast() || *flight.to.ip() == node.address;
            if is_for_it && node.is_running && !self.cut.contains(&(flight.sender, index)) {
                self.call(index, |participant, now| {
                    participant.handle_datagram(now, flight.from, &flight.bytes);
                });
            }
        }
    }

    pub fn writer(&mut self, node: usize, topic: &str, qos: Qos) -> EntityId {
        self.call(node, |participant, now| participant.create_writer(now, endpoint(topic, qos)))
            .expect("writer")
    }

    pub fn reader(&mut self, node: usize, topic: &str, qos: Qos) -> EntityId {
        self.call(node, |participant, now| participant.create_reader(now, endpoint(topic, qos)))
            .expect("reader")
    }

    pub fn write(&mut self, node: usize, writer: EntityId, text: &str) {
        let written = self.call(node, |participant, now| {
            participant.write(now, writer, payload(text), WriteOptions::default())
        });
        written.expect("room to write");
    }

    pub fn guid(&self, node: usize, entity: EntityId) -> Guid {
        Guid::new(self.nodes[node].participant.prefix(), entity)
    }
}

/// The guard of each participant, and the prefix that belongs to it: none. Test programs name the function
/// that says it `guard`.
pub fn no_guard(_: &Config) -> Option<(GuidPrefix, Box<dyn Guard>)> {
    None
}

pub fn addresses(address: Ipv4Addr) -> Addresses {
    Addresses {
        metatraffic_unicast: vec![SocketAddrV4::new(address, METATRAFFIC_PORT)],
        metatraffic_multicast: vec![GROUP],
        default_unicast: vec![SocketAddrV4::new(address, USER_PORT)],
        announce_to: vec![GROUP],
        interfaces: vec![Interface { address, prefix_length: 24 }],
    }
}

pub fn endpoint(topic: &str, qos: Qos) -> EndpointConfig {
    EndpointConfig {
        user_data: Bytes::from_static(b"typehash=RIHS01_00;"),
        ..EndpointConfig::new(topic, "std_msgs::msg::dds_::String_", qos)
    }
}

/// The text with an encapsulation header.
pub fn payload(text: &str) -> Bytes {
    [&[0, 1, 0, 0], text.as_bytes()].concat().into()
}

/// The default QoS of ROS 2.
pub fn reliable() -> Qos {
    Qos { history: History::KeepLast(10), ..Qos::writer_default() }
}

pub fn best_effort() -> Qos {
    Qos { reliability: Reliability::BestEffort, ..reliable() }
}

pub fn latched(depth: u32) -> Qos {
    Qos { durability: Durability::TransientLocal, history: History::KeepLast(depth), ..reliable() }
}
