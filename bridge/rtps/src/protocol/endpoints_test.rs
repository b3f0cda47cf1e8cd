//! Writers and readers together, over an imagined network.

#![allow(clippy::unwrap_used)] // a test may fail

use std::collections::VecDeque;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::{Duration, Instant};

use bytes::Bytes;

use crate::qos::{Durability, History, Liveliness, Qos, Reliability};
use crate::wire::{
    AckNack, EntityId, Gap, Guid, GuidPrefix, Header, Heartbeat, InlineQos, MessageBuilder, SequenceNumber,
    SequenceNumberSet, Submessage, parse,
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

/// The receive buffer of a peer that reads it with pauses.
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
    /// Between which sides nothing gets through.
    cut: Vec<(usize, usize)>,
    sent: u64,
    /// Timers are late by up to this.
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
    /// `count` sides with writers and readers of this quality, nobody matched. Ours announce receive buffers.
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
                is_ours,
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

    /// Writes samples that tell their number, each after what is due.
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

    /// Runs until all is acknowledged.
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
                    reader.handle_heartbeat(now, from(it.writer), &it, received, links)
                }
                Submessage::HeartbeatFragment(it) => {
                    reader.handle_heartbeat_fragment(now, from(it.writer), &it, links);
                }
                Submessage::Gap(it) => reader.handle_gap(now, from(it.writer), &it, received),
                Submessage::AckNack(it) => writer.handle_ack_nack(now, from(it.reader), &it, links),
                Submessage::NackFragment(it) => writer.handle_nack_fragment(now, from(it.reader), &it, links),
                _ => {}
            }
        }
    }

    /// What the samples tell that a side received since.
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

#[test]
fn samples_arrive_once_and_in_order() {
    let mut world = World::pair(&reliable());
    world.write_numbered(0, 0..1000);
    world.settle();
    assert_eq!(world.numbers(1), (0..1000).collect::<Vec<_>>());
}

#[test]
fn samples_arrive_once_and_in_order_over_a_bad_network() {
    for seed in 1..30 {
        let mut world = World::pair(&Qos { history: History::KeepAll, ..reliable() });
        (world.random, world.loss, world.duplication, world.jitter) = (seed * 77, 30, 10, 5 * MS);
        for number in 0..200 {
            while world.write(0, sample(number)).is_err() {
                world.run(MS);
            }
            world.transmit();
        }
        world.settle();
        assert_eq!(world.numbers(1), (0..200).collect::<Vec<_>>(), "seed {seed}");
        assert_eq!(world.lost(1), 0);
    }
}

#[test]
fn large_samples_arrive_whole_over_a_bad_network() {
    for (seed, is_ours) in (1..20).flat_map(|seed| [(seed, true), (seed, false)]) {
        let mut world = World::new(2, &Qos { history: History::KeepAll, ..reliable() }, is_ours);
        (world.random, world.loss, world.duplication, world.jitter) = (seed * 77, 20, 10, 5 * MS);
        world.match_both(0, 1);
        for number in 0..5 {
            world.write(0, large(number, 1_000_003)).unwrap();
            world.run(MS);
        }
        world.settle();
        let received = std::mem::take(&mut world.sides[1].received);
        assert_eq!(received.len(), 5, "seed {seed} {is_ours}");
        for (number, received) in received.iter().enumerate() {
            let Received::Sample(sample) = received else { panic!("{received:?}") };
            assert!(sample.payload == large(number as u32, 1_000_003));
        }
    }
}

#[test]
fn large_samples_cost_one_datagram_per_fragment_and_few_answers() {
    let mut world = World::pair(&reliable());
    world.settle();
    let before = world.sent;
    for number in 0..8 {
        world.write(0, large(number, 1_000_000)).unwrap();
        world.settle();
    }
    assert_eq!(world.numbers(1), (0..8).collect::<Vec<_>>());
    let fragments = 8 * 16;
    assert!(world.sent - before <= fragments + fragments / 4, "{} datagrams", world.sent - before);
}

#[test]
fn after_the_acknowledgements_it_is_quiet() {
    for qos in [reliable(), latched(), best_effort()] {
        let mut world = World::pair(&qos);
        world.write_numbered(0, 0..100);
        world.run(Duration::from_secs(5));
        let sent = world.sent;
        world.run(Duration::from_secs(3600));
        assert_eq!(world.sent, sent);
        assert!(world.sides[0].writer.is_acknowledged());
        assert_eq!(world.sides[0].writer.next_timeout(), None);
    }
}

#[test]
fn a_flood_of_small_samples_shares_datagrams() {
    let mut world = World::pair(&Qos { history: History::KeepLast(2000), ..reliable() });
    world.settle();
    let before = world.sent;
    for number in 0..1000 {
        world.write(0, sample(number)).unwrap();
    }
    world.settle();
    assert_eq!(world.numbers(1).len(), 1000);
    assert!(world.sent - before < 10, "{} datagrams", world.sent - before);
}

#[test]
fn not_every_sample_of_a_quick_succession_is_acknowledged() {
    let mut world = World::pair(&Qos { history: History::KeepLast(2000), ..reliable() });
    world.settle();
    let before = world.sent;
    for number in 0..1000 {
        world.write(0, sample(number)).unwrap();
        world.run(MS / 10);
    }
    world.settle();
    assert_eq!(world.numbers(1).len(), 1000);
    assert!(world.sent - before < 1060, "{} datagrams", world.sent - before);
}

#[test]
fn the_last_samples_are_kept_and_the_others_counted_as_lost() {
    let mut world = World::pair(&reliable());
    world.write_numbered(0, 0..5);
    world.settle();
    world.cut.push((0, 1));
    world.write_numbered(0, 5..50);
    world.cut.clear();
    world.settle();
    assert_eq!(world.lost(1), 35);
    assert_eq!(world.numbers(1), (0..5).chain(40..50).collect::<Vec<_>>());
}

#[test]
fn a_late_joiner_gets_exactly_the_depth() {
    let mut world = World::new(3, &latched(), true);
    world.match_both(0, 1);
    world.write_numbered(0, 0..25);
    world.settle();
    world.match_both(0, 2);
    world.settle();
    assert_eq!(world.numbers(2), (15..25).collect::<Vec<_>>());
    world.write_numbered(0, 25..27);
    world.settle();
    assert_eq!((world.numbers(2), world.lost(2)), (vec![25, 26], 0));
}

#[test]
fn a_late_joiner_gets_large_samples_though_its_first_answers_are_lost() {
    for is_ours in [true, false] {
        let mut world = World::new(2, &latched(), is_ours);
        for number in 0..12 {
            world.write(0, large(number, 3_000_000)).unwrap();
        }
        world.match_reader(0, 1);
        world.run(200 * MS);
        world.match_writer(0, 1);
        world.settle();
        assert_eq!((world.numbers(1), world.lost(1)), ((2..12).collect(), 0));
    }
}

#[test]
fn a_late_best_effort_reader_of_a_latched_topic_gets_the_depth() {
    let mut world = World::new(2, &Qos { reliability: Reliability::BestEffort, ..latched() }, true);
    world.write_numbered(0, 0..25);
    world.match_writer(0, 1);
    world.match_reader(0, 1);
    world.settle();
    assert_eq!(world.numbers(1), (15..25).collect::<Vec<_>>());
}

#[test]
fn a_volatile_late_joiner_gets_nothing_old() {
    let mut world = World::new(3, &reliable(), true);
    world.match_both(0, 1);
    world.write_numbered(0, 0..25);
    world.match_both(0, 2);
    world.write_numbered(0, 25..27);
    world.settle();
    assert_eq!((world.numbers(2), world.lost(2)), (vec![25, 26], 0));
}

#[test]
fn a_volatile_late_joiner_of_a_latched_writer_gets_nothing_old() {
    let mut world = World::new(2, &latched(), true);
    world.write_numbered(0, 0..25);
    world.sides[1].reader = Reader::new(ReaderConfig {
        guid: Guid::new(prefix(1), READER),
        qos: reliable(),
        max_sample_size: 1000,
        max_open_bytes: 1000,
    });
    world.match_both(0, 1);
    world.write_numbered(0, 25..27);
    // A reader that heard no heartbeat to itself may ask for all of it.
    let all = &mut SequenceNumberSet::new(SequenceNumber::FIRST);
    (1..=25).for_each(|number| assert!(all.insert(SequenceNumber(number))));
    let ask = AckNack { reader: READER, writer: WRITER, missing: *all, count: 1, is_final: false };
    let side = &mut world.sides[0];
    side.writer.handle_ack_nack(world.now, Guid::new(prefix(1), READER), &ask, &mut side.links);
    world.settle();
    assert_eq!((world.numbers(1), world.lost(1)), (vec![25, 26], 0));
}

#[test]
fn a_reader_asks_for_a_first_heartbeat_ever_more_rarely() {
    let mut world = World::new(2, &reliable(), true);
    world.match_writer(0, 1);
    let mut asked = Vec::new();
    for _ in 0..6 {
        let sent = world.sent;
        while world.sent == sent {
            let next = world.next_event().unwrap();
            world.advance(next - world.now.steady);
            world.step();
            world.transmit();
        }
        asked.push((world.now.steady - world.start).as_millis());
    }
    assert_eq!(asked, [10, 30, 70, 150, 310, 630]);
    world.run(Duration::from_secs(60));
    let sent = world.sent;
    world.run(Duration::from_secs(30));
    assert_eq!(world.sent - sent, 10);
    world.match_reader(0, 1);
    world.run(MS);
    let sent = world.sent;
    world.run(Duration::from_secs(60));
    assert_eq!(world.sent, sent);
}

#[test]
fn a_reader_that_has_forgotten_gets_the_history_again() {
    let mut world = World::pair(&latched());
    world.write_numbered(0, 0..25);
    world.settle();
    assert_eq!(world.numbers(1).len(), 25);
    world.sides[1].reader.unmatch_writer(Guid::new(prefix(0), WRITER));
    world.run(Duration::from_secs(1));
    world.match_writer(0, 1);
    world.run(Duration::from_secs(1));
    assert_eq!(world.numbers(1), (15..25).collect::<Vec<_>>());
    world.write_numbered(0, 25..26);
    world.settle();
    assert_eq!(world.numbers(1), [25]);
}

#[test]
fn a_volatile_reader_that_has_forgotten_gets_what_is_written_then() {
    let mut world = World::pair(&reliable());
    world.write_numbered(0, 0..25);
    world.settle();
    world.numbers(1);
    world.sides[1].reader.unmatch_writer(Guid::new(prefix(0), WRITER));
    world.run(Duration::from_secs(1));
    world.match_writer(0, 1);
    world.run(Duration::from_secs(1));
    world.write_numbered(0, 25..26);
    world.settle();
    assert_eq!((world.numbers(1), world.lost(1)), (vec![25], 0));
}

#[test]
fn a_dead_reader_delays_nobody_and_costs_its_window() {
    for (size, count) in [(100, 5000), (100_000, 200), (1_000_000, 50)] {
        let mut world = World::new(3, &reliable(), true);
        world.match_both(0, 1);
        world.match_both(0, 2);
        world.run(MS);
        world.cut = vec![(0, 2), (2, 0)];
        for number in 0..count {
            world.write(0, large(number, size)).unwrap();
            world.run(10 * MS);
        }
        assert_eq!((world.numbers(1).len(), world.lost(1)), (count as usize, 0));
        assert!(!world.sides[0].writer.is_acknowledged());
        let sent = world.sent;
        world.run(Duration::from_secs(600));
        assert!(world.sent - sent < 250, "{} datagrams to a dead reader", world.sent - sent);
        world.cut.clear();
        world.settle();
        let (lost, numbers) = (world.lost(2), world.numbers(2));
        assert_eq!(numbers[numbers.len() - DEPTH..], (count - DEPTH as u32..count).collect::<Vec<_>>());
        assert_eq!(lost + numbers.len() as u64, u64::from(count));
    }
}

#[test]
fn a_writer_that_keeps_all_waits_for_its_readers() {
    let mut world = World::pair(&Qos { history: History::KeepAll, ..reliable() });
    world.settle();
    world.cut.push((1, 0));
    let written = (0..1000).take_while(|number| world.write(0, sample(*number)).is_ok()).count();
    assert_eq!(written, 64);
    world.run(Duration::from_secs(10));
    assert!(!world.sides[0].writer.can_write(world.now, &world.sides[0].links));
    world.cut.clear();
    world.settle();
    assert!(world.sides[0].writer.can_write(world.now, &world.sides[0].links));
    assert_eq!(world.sides[0].events.last(), Some(&WriterEvent::Acknowledged));
    assert_eq!(world.numbers(1), (0..64).collect::<Vec<_>>());
}

#[test]
fn a_writer_ahead_of_its_pacer_gets_a_full_window_and_loses_nothing() {
    let mut world = World::new(2, &best_effort(), false);
    world.match_both(0, 1);
    let mut written = 0;
    for _ in 0..200 {
        while world.write(0, large(written, 100_000)).is_ok() {
            written += 1;
        }
        world.run(10 * MS);
    }
    assert!(written > 500);
    world.settle();
    assert_eq!(world.numbers(1), (0..written).collect::<Vec<_>>());
}

#[test]
fn a_sample_for_one_reader_is_a_gap_for_the_others() {
    let mut world = World::new(4, &reliable(), true);
    for reader in 1..4 {
        world.match_both(0, reader);
    }
    world.settle();
    for number in 0..90 {
        let only_to = (number % 10 < 9).then(|| Guid::new(prefix(1 + number as usize % 3), READER));
        world.write_with(0, sample(number), WriteOptions { only_to, ..Default::default() }).unwrap();
        world.run(MS / 10);
    }
    world.settle();
    for reader in 1..4 {
        let due = (0..90).filter(|number| number % 10 == 9 || 1 + number % 3 == reader).collect::<Vec<_>>();
        assert_eq!((world.lost(reader as usize), world.numbers(reader as usize)), (0, due));
    }
    // Nobody else hears of it.
    world.run(10 * MS);
    let sent = world.sent;
    let only_to = Some(Guid::new(prefix(1), READER));
    world.write_with(0, sample(90), WriteOptions { only_to, ..Default::default() }).unwrap();
    world.run(Duration::from_secs(1));
    assert!(world.sides[0].writer.is_acknowledged());
    assert_eq!(world.sent - sent, 2);
}

#[test]
fn a_discarded_sample_does_not_come_and_is_not_lost() {
    let mut world = World::new(2, &Qos { history: History::KeepAll, ..latched() }, true);
    world.write_numbered(0, 0..9);
    for number in [2, 3, 7] {
        world.sides[0].writer.discard(SequenceNumber(number));
    }
    world.match_both(0, 1);
    world.settle();
    assert_eq!((world.lost(1), world.numbers(1)), (0, vec![0, 3, 4, 5, 7, 8]));
}

#[test]
fn expired_samples_are_neither_sent_nor_delivered() {
    let mut world = World::new(2, &Qos { lifespan: Some(100 * MS), ..latched() }, true);
    world.write_numbered(0, 0..2);
    world.run(90 * MS);
    world.write_numbered(0, 2..4);
    world.run(20 * MS);
    world.match_both(0, 1);
    world.settle();
    assert_eq!(world.numbers(1), [2, 3]);
    // What waits for an earlier sample until it is too old is not delivered; a step of the wall clock expires nothing here.
    world.now.wall_ns -= 1_000_000_000_000;
    world.write_numbered(0, 4..5);
    world.settle();
    assert_eq!(world.numbers(1), [4]);
    assert!(world.sides[0].writer.next_timeout().is_some());
    world.run(Duration::from_secs(1));
    assert_eq!(world.sides[0].writer.next_timeout(), None);
}

#[test]
fn missed_deadlines_are_counted_on_both_sides() {
    let mut world = World::pair(&Qos { deadline: Some(100 * MS), ..reliable() });
    world.run(Duration::from_secs(1));
    assert!(world.sides[0].events.iter().all(|event| *event == WriterEvent::Acknowledged));
    for number in 0..10 {
        world.write_numbered(0, number..number + 1);
        world.run(90 * MS);
    }
    world.settle();
    assert!(world.sides[0].events.iter().all(|event| *event == WriterEvent::Acknowledged));
    world.numbers(1);
    world.run(290 * MS);
    let offered = world.sides[0].events.iter();
    let offered = offered.filter(|event| **event == WriterEvent::DeadlineMissed { count: 1 }).count();
    assert_eq!((offered, world.sides[1].received.len()), (3, 3));
    // A sleep of the host is one event.
    world.advance(Duration::from_secs(10));
    world.step();
    assert_eq!(world.sides[1].received[3..], [Received::DeadlineMissed { count: 100 }]);
}

#[test]
fn a_silent_writer_loses_its_liveliness() {
    let qos = Qos { liveliness: Liveliness::ManualByTopic, lease: Some(100 * MS), ..reliable() };
    let mut world = World::pair(&qos);
    let writer = Guid::new(prefix(0), WRITER);
    world.write_numbered(0, 0..1);
    for _ in 0..10 {
        world.run(90 * MS);
        let side = &mut world.sides[0];
        side.writer.assert_liveliness(world.now, &mut side.links);
    }
    world.run(MS);
    let changed = |is_alive| Received::LivelinessChanged { writer, is_alive };
    assert_eq!(world.sides[0].events, [WriterEvent::Acknowledged]);
    assert_eq!(world.sides[1].received[0], changed(true));
    assert_eq!(world.numbers(1), [0]);
    world.run(Duration::from_secs(5));
    assert_eq!(world.sides[0].events.pop(), Some(WriterEvent::LivelinessLost));
    assert_eq!(std::mem::take(&mut world.sides[1].received), [changed(false)]);
    world.write_numbered(0, 1..2);
    world.run(MS);
    assert_eq!(world.sides[1].received[0], changed(true));
    assert_eq!(world.numbers(1), [1]);
}

#[test]
fn a_best_effort_reader_gets_the_newest_and_counts_the_others() {
    let mut world = World::pair(&best_effort());
    (world.loss, world.jitter) = (20, MS);
    for number in 0..1000 {
        world.write_numbered(0, number..number + 1);
        world.run(MS / 2);
    }
    world.settle();
    let (lost, numbers) = (world.lost(1), world.numbers(1));
    assert!(numbers.is_sorted() && numbers.len() > 500, "{}", numbers.len());
    let before_first = u64::from(numbers[0]);
    let after_last = u64::from(999 - numbers[numbers.len() - 1]);
    assert_eq!(lost + numbers.len() as u64 + before_first + after_last, 1000);
}

#[test]
fn huge_ranges_cost_nothing() {
    let mut world = World::pair(&reliable());
    world.settle();
    let (reader, writer, huge) = (READER, WRITER, SequenceNumber(1 << 60));
    let guid = Guid::new(prefix(0), WRITER);
    let Side { reader: endpoint, received, links, .. } = &mut world.sides[1];
    let heartbeat = |first, last, count| Heartbeat {
        reader,
        writer,
        first: SequenceNumber(first),
        last,
        count,
        is_final: false,
        is_liveliness: false,
    };
    endpoint.handle_heartbeat(world.now, guid, &heartbeat(1, huge, 1000), received, links);
    let list = SequenceNumberSet::new(huge);
    endpoint.handle_gap(world.now, guid, &Gap { reader, writer, start: SequenceNumber(3), list }, received);
    endpoint.handle_heartbeat(world.now, guid, &heartbeat(1 << 59, huge, 1001), received, links);
    endpoint.handle_heartbeat(world.now, guid, &heartbeat(1 << 60, huge.previous(), 1002), received, links);
    assert_eq!(received.as_slice(), [Received::Lost { writer: guid, count: 2 }]);
    let side = &mut world.sides[0];
    let ask = AckNack { reader, writer, missing: list, count: 1000, is_final: false };
    side.writer.handle_ack_nack(world.now, Guid::new(prefix(1), READER), &ask, &mut side.links);
    world.run(Duration::from_secs(1));
}

#[test]
fn what_cannot_be_delivered_yet_is_bounded() {
    let mut world = World::pair(&reliable());
    world.settle();
    let guid = Guid::new(prefix(0), WRITER);
    let mut memory = 0;
    for number in (2..200_000_i64).step_by(2) {
        let side = &mut world.sides[1];
        let payload = [0; 1000];
        let data = crate::wire::Data {
            reader: READER,
            writer: WRITER,
            number: SequenceNumber(number),
            inline_qos: InlineQos::default(),
            payload: crate::wire::Payload::Data(&payload),
        };
        side.reader.handle_data(world.now, guid, None, &data, &mut side.received);
        memory = memory.max(side.reader.open_bytes());
    }
    assert!((500_000..700_000).contains(&memory), "{memory}");
    for number in 1000..200_000 {
        let side = &mut world.sides[1];
        let fragment = crate::wire::DataFragment {
            reader: READER,
            writer: WRITER,
            number: SequenceNumber(1 + 2 * (number % 500)),
            first: 2,
            count: 1,
            fragment_size: 1000,
            sample_size: 16_000_000,
            inline_qos: InlineQos::default(),
            payload: &[0; 1000],
            is_key: false,
        };
        side.reader.handle_fragment(world.now, guid, None, &fragment, &mut side.received);
        memory = memory.max(side.reader.open_bytes());
    }
    assert!(memory < 2_000_000, "{memory}");
    assert!(world.sides[1].received.is_empty());
    world.sides[1].reader.unmatch_writer(guid);
    assert_eq!(world.sides[1].reader.open_bytes(), 0);
}

#[test]
fn a_sample_beyond_the_limit_is_lost_and_holds_up_nothing() {
    let mut world = World::pair(&reliable());
    world.write(0, large(0, 17 << 20)).unwrap();
    world.write_numbered(0, 1..2);
    world.settle();
    assert_eq!((world.lost(1), world.numbers(1)), (1, vec![1]));
}

#[test]
fn a_reader_that_moves_to_another_link_goes_on() {
    let mut world = World::pair(&reliable());
    world.write_numbered(0, 0..5);
    world.settle();
    world.cut.push((0, 1));
    world.write_numbered(0, 5..9);
    world.cut.clear();
    let side = &mut world.sides[0];
    side.to[1] = side.links.open(LinkOptions {
        destination: Destination::Unicast(SocketAddrV4::new(Ipv4Addr::LOCALHOST, 9)),
        peer: prefix(1),
        max_datagram: 1472,
        fragment_size: 1344,
        receive_buffer: None,
    });
    world.match_reader(0, 1);
    world.settle();
    assert_eq!((world.lost(1), world.numbers(1)), (0, (0..9).collect()));
}

#[test]
fn many_readers_get_all_and_acknowledge_once() {
    let mut world = World::new(9, &Qos { history: History::KeepAll, ..reliable() }, true);
    (1..9).for_each(|reader| world.match_both(0, reader));
    (world.loss, world.jitter) = (10, MS);
    for number in 0..50 {
        world.write(0, large(number, 70_000)).unwrap();
        world.run(5 * MS);
    }
    world.settle();
    for reader in 1..9 {
        assert_eq!((world.lost(reader), world.numbers(reader)), (0, (0..50).collect()));
    }
}

/// What rclpy with the kernel's usual 208 KiB has to get: camera images and large clouds, while it is held up now and then.
#[test]
fn a_stock_receive_buffer_suffices_for_images() {
    for (size, count, period) in [(921_600, 300, 33 * MS), (8_000_000, 20, 500 * MS)] {
        for qos in [reliable(), best_effort()] {
            let mut world = World::new(2, &qos, false);
            world.match_both(0, 1);
            world.sides[1].socket = Some(Socket::default());
            world.lateness = MS;
            for number in 0..count {
                world.write(0, large(number, size)).unwrap();
                world.run(period);
            }
            world.settle();
            let lost = world.sides[1].socket.as_ref().unwrap().dropped;
            let arrived = world.numbers(1).len();
            println!("{size} B, {:?}: {arrived} of {count}, {lost} datagrams dropped", qos.reliability);
            assert_eq!(arrived, count as usize);
        }
    }
}
