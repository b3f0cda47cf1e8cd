//! Writers and readers together over a simulated network.

#![allow(clippy::unwrap_used)] // a test may fail

mod acknowledging;
mod bounds;
mod delivery;
mod late_joiners;
mod qos;

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};

use bytes::Bytes;

use crate::qos::{Durability, History, Liveliness, Qos, Reliability};
use crate::wire::{
    AckNack, EntityId, Gap, Guid, GuidPrefix, Header, Heartbeat, InlineQos, MessageBuilder, SequenceNumber,
    SequenceNumberSet, Submessage, VendorId, parse,
};

use super::*;

const MS: Duration = Duration::from_millis(1);
const WRITER: EntityId = EntityId::user_writer(1);
const READER: EntityId = EntityId::user_reader(2);
const DEPTH: usize = 10;
const RECEIVE_BUFFER: u32 = 4 << 20;

/// A participant with at most one writer and one reader.
struct Side {
    links: Links,
    /// The link to each of the sides.
    to: Vec<LinkId>,
    writer: Writer,
    reader: Reader,
    received: Vec<Received>,
    events: Vec<WriterEvent>,
    socket: Option<Socket>,
}

/// The receive buffer of a peer that reads with pauses.
#[derive(Default)]
struct Socket {
    waiting: VecDeque<Vec<u8>>,
    used: usize,
    reads_at: Option<Instant>,
    next_pause: Option<Instant>,
    dropped: usize,
}

struct World {
    start: Instant,
    now: Now,
    random: u64,
    sides: Vec<Side>,
    flying: Vec<(Instant, u64, usize, Vec<u8>)>,
    /// Per cent.
    loss: u64,
    duplication: u64,
    jitter: Duration,
    /// Pairs of sides between which all datagrams are lost.
    cut: Vec<(usize, usize)>,
    sent: u64,
    /// Received acknowledgements, and received heartbeats that request one.
    acknowledgements: u64,
    asking: u64,
    /// The largest delay of timers.
    lateness: Duration,
}

fn prefix(side: usize) -> GuidPrefix {
    GuidPrefix([side as u8 + 1; 12])
}

fn reliable() -> Qos {
    let history = History::KeepLast(DEPTH as u32);
    Qos { reliability: Reliability::Reliable, history, ..Qos::reader_default() }
}

fn latched() -> Qos {
    Qos { durability: Durability::TransientLocal, ..reliable() }
}

fn best_effort() -> Qos {
    Qos { reliability: Reliability::BestEffort, ..reliable() }
}

impl World {
    /// `count` sides with writers and readers with this QoS, without matches. Sides of this engine announce
    /// receive buffers.
    fn new(count: usize, qos: &Qos, is_ours: bool) -> Self {
        let start = Instant::now();
        let sides = (0..count).map(|side| {
            let mut links = Links::new();
            let to = (0..count)
                .map(|other| {
                    links.open(LinkOptions {
                        destination: Destination::Unicast(SocketAddrV4::new(
                            Ipv4Addr::LOCALHOST,
                            other as u16,
                        )),
                        peer: prefix(other),
                        max_datagram: 65_000,
                        fragment_size: if is_ours { 64_000 } else { 32_000 },
                        receive_buffer: is_ours.then_some(RECEIVE_BUFFER),
                    })
                })
                .collect();
            Side {
                links,
                to,
                writer: Writer::new(WriterConfig {
                    guid: Guid::new(prefix(side), WRITER),
                    qos: qos.clone(),
                    send_window: 64,
                    send_window_bytes: 64 << 20,
                }),
                reader: Reader::new(ReaderConfig {
                    guid: Guid::new(prefix(side), READER),
                    qos: qos.clone(),
                    max_sample_size: 16 << 20,
                    max_open_bytes: 32 << 20,
                }),
                received: Vec::new(),
                events: Vec::new(),
                socket: None,
            }
        });
        Self {
            start,
            now: Now { steady: start, wall_ns: 1_700_000_000_000_000_000 },
            random: 1,
            sides: sides.collect(),
            flying: Vec::new(),
            loss: 0,
            duplication: 0,
            jitter: Duration::ZERO,
            cut: Vec::new(),
            sent: 0,
            acknowledgements: 0,
            asking: 0,
            lateness: Duration::ZERO,
        }
    }

    /// Two sides of this engine, matched.
    fn pair(qos: &Qos) -> Self {
        let mut world = Self::new(2, qos, true);
        world.match_both(0, 1);
        world
    }

    fn random(&mut self, below: u64) -> u64 {
        self.random ^= self.random << 13;
        self.random ^= self.random >> 7;
        self.random ^= self.random << 17;
        self.random % below.max(1)
    }

    fn match_both(&mut self, writer: usize, reader: usize) {
        self.match_reader(writer, reader);
        self.match_writer(writer, reader);
    }

    fn match_reader(&mut self, writer: usize, reader: usize) {
        let offered = self.sides[writer].writer.qos().clone();
        let requested = self.sides[reader].reader.qos().clone();
        let side = &mut self.sides[writer];
        let matched = MatchedReader {
            guid: Guid::new(prefix(reader), READER),
            is_reliable: requested.reliability == Reliability::Reliable,
            wants_history: offered.durability == Durability::TransientLocal
                && requested.durability == Durability::TransientLocal,
            link: side.to[reader],
        };
        side.writer.match_reader(self.now, matched, &mut side.links);
    }

    fn match_writer(&mut self, writer: usize, reader: usize) {
        let offered = self.sides[writer].writer.qos().clone();
        let is_ours = self.sides[reader].links.window_size(self.sides[reader].to[writer]).is_some();
        let side = &mut self.sides[reader];
        let is_reliable = side.reader.qos().reliability == Reliability::Reliable
            && offered.reliability == Reliability::Reliable;
        side.reader.match_writer(
            self.now,
            MatchedWriter {
                guid: Guid::new(prefix(writer), WRITER),
                is_reliable,
                lifespan: offered.lifespan,
                liveliness_lease: offered.lease,
                link: side.to[writer],
                numbers: Numbers::Doubtful,
                vendor: if is_ours { VendorId::OURS } else { VendorId::CYCLONE },
            },
        );
    }

    fn write(&mut self, side: usize, payload: impl Into<Bytes>) -> Result<SequenceNumber, WindowFull> {
        self.write_with(side, payload, WriteOptions::default())
    }

    fn write_with(
        &mut self,
        side: usize,
        payload: impl Into<Bytes>,
        options: WriteOptions,
    ) -> Result<SequenceNumber, WindowFull> {
        let side = &mut self.sides[side];
        side.writer.write(self.now, payload.into(), options, &mut side.links)
    }

    /// Writes samples that contain their number, each after running what is due.
    fn write_numbered(&mut self, side: usize, numbers: std::ops::Range<u32>) {
        for number in numbers {
            self.write(side, sample(number)).unwrap();
            self.transmit();
        }
    }

    fn advance(&mut self, by: Duration) {
        self.now.steady += by;
        self.now.wall_ns += by.as_nanos() as i64;
    }

    fn run(&mut self, duration: Duration) {
        let end = self.now.steady + duration;
        loop {
            self.transmit();
            let next = self.next_event().filter(|next| *next <= end);
            self.advance(next.unwrap_or(end).saturating_duration_since(self.now.steady));
            self.step();
            if next.is_none() {
                return self.transmit();
            }
        }
    }

    /// Runs until all samples are acknowledged.
    fn settle(&mut self) {
        for _ in 0..200_000 {
            self.transmit();
            let is_quiet = self.flying.is_empty()
                && self
                    .sides
                    .iter()
                    .all(|side| side.writer.is_acknowledged() && side.links.next_timeout().is_none());
            let Some(next) = self.next_event().filter(|_| !is_quiet) else { return };
            self.advance(next.saturating_duration_since(self.now.steady));
            self.step();
        }
        panic!("nothing is settled after {:?}", self.now.steady - self.start);
    }

    fn next_event(&mut self) -> Option<Instant> {
        let flying = self.flying.iter().map(|(at, ..)| *at).min();
        let sockets = self.sides.iter().filter_map(|side| side.socket.as_ref()?.reads_at).min();
        let timers = self.sides.iter().flat_map(|side| {
            [side.links.next_timeout(), side.writer.next_timeout(), side.reader.next_timeout()]
        });
        let timer = timers.flatten().min().map(|at| at + self.lateness);
        [flying, sockets, timer].into_iter().flatten().min()
    }

    fn step(&mut self) {
        self.flying.sort_by_key(|(at, order, ..)| (*at, *order));
        while self.flying.first().is_some_and(|(at, ..)| *at <= self.now.steady) {
            let (_, _, side, datagram) = self.flying.remove(0);
            match &mut self.sides[side].socket {
                Some(socket) => socket.arrive(self.now.steady, datagram),
                None => self.receive(side, &datagram),
            }
        }
        for side in 0..self.sides.len() {
            let pause = 2 * MS + Duration::from_micros(self.random(1500));
            let distance = Duration::from_millis(5 + self.random(30));
            let now = self.now.steady;
            if let Some(datagram) =
                self.sides[side].socket.as_mut().and_then(|socket| socket.read(now, pause, distance))
            {
                self.receive(side, &datagram);
            }
            let side = &mut self.sides[side];
            side.writer.handle_timeout(self.now, &mut side.links);
            side.reader.handle_timeout(self.now, &mut side.received, &mut side.links);
            side.events.extend(std::iter::from_fn(|| side.writer.poll_event()));
        }
    }

    fn transmit(&mut self) {
        for from in 0..self.sides.len() {
            while let Some((to, datagram)) = self.poll_transmit(from) {
                self.sent += 1;
                let copies = 1 + u64::from(self.random(100) < self.duplication);
                for _ in 0..copies {
                    let is_lost = self.random(100) < self.loss || self.cut.contains(&(from, to));
                    let jitter = self.random(self.jitter.as_nanos() as u64 + 1);
                    let at = self.now.steady + Duration::from_micros(50) + Duration::from_nanos(jitter);
                    if !is_lost {
                        self.flying.push((at, self.sent, to, datagram.clone()));
                    }
                }
            }
        }
    }

    fn poll_transmit(&mut self, from: usize) -> Option<(usize, Vec<u8>)> {
        let side = &mut self.sides[from];
        while let Some(link) = side.links.next(self.now.steady) {
            let mut datagram = Vec::new();
            let mut builder =
                MessageBuilder::new(&mut datagram, side.links.max_datagram(link), Header::ours(prefix(from)));
            while let Some(sender) = side.links.pop(link) {
                let emitted = match sender {
                    WRITER => side.writer.emit(self.now, link, &mut side.links, &mut builder),
                    _ => side.reader.emit(self.now, link, &mut builder),
                };
                side.links.put_back(link, sender, emitted);
                if emitted == Emitted::More {
                    break;
                }
            }
            if !builder.is_empty() {
                let to = side.to.iter().position(|to| *to == link).unwrap();
                return Some((to, datagram));
            }
        }
        None
    }

    fn receive(&mut self, side: usize, datagram: &[u8]) {
        let now = self.now;
        let Side { links, writer, reader, received, .. } = &mut self.sides[side];
        let (header, submessages) = parse(datagram).unwrap();
        let mut timestamp = None;
        let from = |entity| Guid::new(header.prefix, entity);
        for submessage in submessages {
            match submessage.unwrap() {
                Submessage::InfoTimestamp(time) => timestamp = time,
                Submessage::Data(data) => {
                    reader.handle_data(now, from(data.writer), timestamp, &data, received)
                }
                Submessage::DataFragment(data) => {
                    reader.handle_fragment(now, from(data.writer), timestamp, &data, received);
                }
                Submessage::Heartbeat(it) => {
                    self.asking += u64::from(!it.is_final);
                    reader.handle_heartbeat(now, from(it.writer), &it, received, links)
                }
                Submessage::HeartbeatFragment(it) => {
                    reader.handle_heartbeat_fragment(now, from(it.writer), &it, links);
                }
                Submessage::Gap(it) => reader.handle_gap(now, from(it.writer), &it, received),
                Submessage::AckNack(it) => {
                    self.acknowledgements += 1;
                    writer.handle_ack_nack(now, from(it.reader), &it, links);
                }
                Submessage::NackFragment(it) => writer.handle_nack_fragment(now, from(it.reader), &it, links),
                _ => {}
            }
        }
    }

    /// The numbers in the samples that a side has received since the last call.
    fn numbers(&mut self, side: usize) -> Vec<u32> {
        let received = std::mem::take(&mut self.sides[side].received);
        received
            .iter()
            .filter_map(|received| match received {
                Received::Sample(sample) => Some(number(&sample.payload)),
                _ => None,
            })
            .collect()
    }

    fn lost(&self, side: usize) -> u64 {
        let received = self.sides[side].received.iter();
        received.map(|received| if let Received::Lost { count, .. } = received { *count } else { 0 }).sum()
    }
}

impl Socket {
    const SIZE: usize = 212_992;

    /// What the kernel counts for a datagram.
    fn cost(datagram: &[u8]) -> usize {
        (datagram.len() + 400).next_power_of_two() + 256
    }

    fn arrive(&mut self, now: Instant, datagram: Vec<u8>) {
        if self.used + Self::cost(&datagram) > Self::SIZE {
            self.dropped += 1;
            return;
        }
        self.used += Self::cost(&datagram);
        self.waiting.push_back(datagram);
        self.reads_at.get_or_insert(now);
    }

    fn read(&mut self, now: Instant, pause: Duration, distance: Duration) -> Option<Vec<u8>> {
        self.reads_at.filter(|at| *at <= now)?;
        if self.next_pause.is_some_and(|at| at <= now) {
            self.next_pause = Some(now + distance);
            self.reads_at = Some(now + pause);
            return None;
        }
        self.next_pause.get_or_insert(now + distance);
        let datagram = self.waiting.pop_front()?;
        self.used -= Self::cost(&datagram);
        self.reads_at = (!self.waiting.is_empty()).then_some(now + MS / 20);
        Some(datagram)
    }
}

fn sample(number: u32) -> Vec<u8> {
    [[0; 4], number.to_le_bytes()].concat()
}

/// A large payload that holds its sample's number, and at regular distances its position.
fn large(number: u32, size: usize) -> Vec<u8> {
    let mut bytes = vec![number as u8; size];
    bytes[..8].copy_from_slice(&sample(number));
    for position in (8..size - 4).step_by(999) {
        bytes[position..position + 4].copy_from_slice(&(position as u32).to_le_bytes());
    }
    bytes
}

fn number(payload: &[u8]) -> u32 {
    u32::from_le_bytes(payload[4..8].try_into().unwrap())
}
