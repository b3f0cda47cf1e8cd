//! Two to eight participants over a network that loses, duplicates, reorders and delays datagrams and is
//! interrupted and restored, while participants crash, restart, are suspended and have their clocks set. A
//! seed determines what happens.
//!
//! `DOWNBEAT_SIMULATION_SEEDS=10000` runs this number of seeds, `DOWNBEAT_SIMULATION_SEED=17` replays one,
//! and `DOWNBEAT_SIMULATION_TRACE=1` prints datagrams and events.

mod common;

#[allow(unused_imports)] // by `common`
use common::no_guard as guard;

use std::{cell::Cell, collections::BTreeMap, rc::Rc, time::Duration};

use bytes::Bytes;
use common::{Flight, Network};
use downbeat_rtps::{
    protocol::{Event, Sample, WriteError, WriteOptions},
    qos::{Durability, History, Qos, Reliability},
    wire::{EntityId, Guid, Submessage, parse},
};

const MS: Duration = Duration::from_millis(1);
const SECOND: Duration = Duration::from_secs(1);
/// Interruptions and suspensions are shorter than the lease, with a margin of some announcements for losses.
const LONGEST_OUTAGE: Duration = Duration::from_secs(5);
#[allow(dead_code)] // other programs that include this file have their own
const SEEDS: u64 = 200;

/// A generator of numbers (xorshift64*).
#[derive(Clone)]
struct Random(u64);

impl Random {
    fn new(seed: u64) -> Self {
        Self((seed + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15))
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        (self.0.wrapping_mul(0x2545_f491_4f6c_dd1d) >> 33) % limit
    }

    fn chance(&mut self, per_cent: u64) -> bool {
        self.below(100) < per_cent
    }

    fn pick(&mut self, length: usize) -> usize {
        self.below(length as u64) as usize
    }

    fn up_to(&mut self, limit: Duration) -> Duration {
        Duration::from_micros(self.below(limit.as_micros() as u64 + 1))
    }
}

/// The current behaviour of the network.
#[derive(Clone)]
struct Weather {
    random: Random,
    loss: u64,
    duplication: u64,
    delay: Duration,
}

impl Weather {
    fn fate(&mut self) -> Vec<Duration> {
        let copies = 1 + u64::from(self.random.chance(self.duplication));
        let mut delays = Vec::new();
        for _ in 0..copies {
            if !self.random.chance(self.loss) {
                delays.push(common::DELAY + self.random.up_to(self.delay));
            }
        }
        delays
    }
}

struct Endpoint {
    node: usize,
    id: EntityId,
    topic: usize,
    qos: Qos,
    /// Number of written samples, of a writer.
    written: u64,
    is_alive: bool,
}

impl Endpoint {
    fn is_writer(&self) -> bool {
        self.id.is_writer()
    }

    fn depth(&self) -> u64 {
        match self.qos.history {
            History::KeepLast(depth) => depth.into(),
            History::KeepAll => u64::MAX,
        }
    }
}

/// What a reader has received from a writer.
#[derive(Default)]
struct Stream {
    /// The index of the next sample if none is lost; `None` before the first one.
    next: Option<u64>,
    /// The index of the first sample.
    first: u64,
    /// The index since which nothing was lost.
    whole_since: u64,
    /// Missing samples between received ones.
    missing: u64,
    /// Missing samples that were written while the two certainly knew each other.
    missing_due: u64,
    /// Samples that were reported as lost.
    lost: u64,
    /// The first sample that concerns the reader, as the writer sees it.
    start: Option<u64>,
    /// The writer did not know the reader for a while: samples that it wrote then are not reported as lost.
    is_torn: bool,
}

struct Simulation {
    network: Network,
    random: Random,
    weather: Rc<std::cell::RefCell<Weather>>,
    topics: Vec<Qos>,
    endpoints: Vec<Endpoint>,
    /// By index of the reader and of the writer.
    streams: BTreeMap<(usize, usize), Stream>,
    wakes: Vec<(Duration, usize)>,
    heals: Option<Duration>,
    /// Hash of all datagrams and their send times.
    trace: Rc<Cell<u64>>,
}

impl Simulation {
    fn new(seed: u64) -> Self {
        let mut random = Random::new(seed);
        let weather = Weather {
            random: Random::new(seed ^ 0x5eed),
            loss: [0, 2, 10, 30][random.pick(4)],
            duplication: [0, 5, 20][random.pick(3)],
            delay: [Duration::ZERO, 2 * MS, 40 * MS][random.pick(3)],
        };
        let weather = Rc::new(std::cell::RefCell::new(weather));
        let trace = Rc::new(Cell::new(0xcbf2_9ce4_8422_2325_u64));
        let mut network = Network::new(0);
        let of_fate = Rc::clone(&weather);
        network.fate = Box::new(move |_| of_fate.borrow_mut().fate());
        let of_watch = Rc::clone(&trace);
        network.watch =
            Box::new(move |flight: &Flight| {
                if is_traced() {
                    let (_, submessages) = parse(&flight.bytes).expect("a message");
                    let submessages =
                        submessages.map(|it| format!("{:.160}", format!("{it:?}"))).collect::<Vec<_>>();
                    eprintln!("{} to {}: {submessages:#?}", flight.sender, flight.to);
                }
                let to = flight.to.ip().octets();
                let bytes = flight.bytes.iter().chain(&to);
                of_watch.set(bytes.fold(of_watch.get(), |hash, byte| {
                    (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
                }));
            });
        let topics = (0..1 + random.pick(3)).map(|_| topic_qos(&mut random)).collect();
        let mut simulation = Self {
            network,
            random,
            weather,
            topics,
            endpoints: Vec::new(),
            streams: BTreeMap::new(),
            wakes: Vec::new(),
            heals: None,
            trace,
        };
        for _ in 0..2 + simulation.random.pick(7) {
            let address = 0x0a00_0001 + simulation.network.nodes.len() as u32;
            simulation.join(address.into());
        }
        simulation
    }

    fn join(&mut self, address: std::net::Ipv4Addr) {
        let receive_buffer = self.random.chance(70).then_some(4 << 20);
        let node = self.network.join_at(address, |config| config.receive_buffer = receive_buffer);
        for _ in 0..1 + self.random.pick(3) {
            self.add_endpoint(node);
        }
    }

    fn add_endpoint(&mut self, node: usize) {
        let topic = self.random.pick(self.topics.len());
        let mut qos = self.topics[topic].clone();
        let name = format!("rt/topic_{topic}");
        let id = if self.random.chance(50) {
            self.network.writer(node, &name, qos.clone())
        } else {
            if self.random.chance(20) {
                qos.durability = Durability::Volatile;
            }
            if self.random.chance(10) {
                qos.reliability = Reliability::BestEffort;
            }
            self.network.reader(node, &name, qos.clone())
        };
        self.endpoints.push(Endpoint { node, id, topic, qos, written: 0, is_alive: true });
        self.take_events();
    }

    fn remove_endpoint(&mut self, index: usize) {
        let Endpoint { node, id, .. } = self.endpoints[index];
        self.endpoints[index].is_alive = false;
        assert!(self.network.call(node, |participant, now| participant.remove_endpoint(now, id)));
        self.take_events();
    }

    fn write(&mut self, index: usize, size: usize) {
        let Endpoint { node, id, written, .. } = self.endpoints[index];
        let payload = content(written, size);
        let result = self
            .network
            .call(node, |participant, now| participant.write(now, id, payload, WriteOptions::default()));
        match result {
            Ok(number) => {
                assert_eq!(number.0 as u64, written + 1);
                self.endpoints[index].written += 1;
            }
            Err(WriteError::WindowFull) => {}
            Err(error) => panic!("writing failed: {error}"),
        }
        self.take_events();
    }

    /// The running nodes.
    fn running(&self) -> Vec<usize> {
        (0..self.network.nodes.len()).filter(|node| self.network.nodes[*node].is_running).collect()
    }

    /// Performs a random action.
    fn act(&mut self) {
        let running = self.running();
        let alive = |is_writer: bool| {
            let alive = |endpoint: &&Endpoint| {
                endpoint.is_alive && endpoint.is_writer() == is_writer && running.contains(&endpoint.node)
            };
            let indices = self.endpoints.iter().enumerate().filter(|(_, endpoint)| alive(endpoint));
            indices.map(|(index, _)| index).collect::<Vec<_>>()
        };
        match self.random.below(100) {
            0..80 => {
                let writers = alive(true);
                let size = match self.random.below(100) {
                    0..90 => self.random.below(200),
                    90..98 => self.random.below(5000),
                    _ => self.random.below(200_000),
                };
                if !writers.is_empty() {
                    let writer = writers[self.random.pick(writers.len())];
                    for _ in 0..1 + self.random.pick(10) {
                        self.write(writer, 12 + size as usize);
                    }
                }
            }
            80..84 if self.heals.is_none() => {
                let nodes = self.network.nodes.len();
                let is_left: Vec<_> = (0..nodes).map(|_| self.random.chance(50)).collect();
                let pairs = (0..nodes).flat_map(|from| (0..nodes).map(move |to| (from, to)));
                let is_one_way = self.random.chance(20);
                self.network.cut = pairs
                    .filter(|(from, to)| is_left[*from] != is_left[*to] && !(is_one_way && is_left[*from]))
                    .collect();
                self.heals = Some(self.network.elapsed + self.random.up_to(LONGEST_OUTAGE));
            }
            84..87 if running.len() > 1 => {
                let node = running[self.random.pick(running.len())];
                self.network.nodes[node].is_running = false;
                self.wakes.push((self.network.elapsed + self.random.up_to(LONGEST_OUTAGE), node));
            }
            87..90 if running.len() > 1 => {
                let node = running[self.random.pick(running.len())];
                let address = self.network.nodes[node].address;
                if self.random.chance(50) {
                    self.network.call(node, |participant, now| participant.leave(now));
                }
                self.network.nodes[node].is_running = false;
                let gone = self.endpoints.iter_mut().filter(|endpoint| endpoint.node == node);
                gone.for_each(|endpoint| endpoint.is_alive = false);
                self.join(address);
            }
            90..93 => self.network.wall_offset_ns += self.random.below(1 << 40) as i64 - (1 << 39),
            93..97 if self.endpoints.len() < 40 => {
                let node = running[self.random.pick(running.len())];
                self.add_endpoint(node);
            }
            97..100 => {
                let endpoints = alive(self.random.clone().chance(50));
                if !endpoints.is_empty() {
                    let index = endpoints[self.random.pick(endpoints.len())];
                    self.remove_endpoint(index);
                }
            }
            _ => {}
        }
    }

    fn run_for(&mut self, duration: Duration) {
        let end = self.network.elapsed + duration;
        loop {
            let wake = self.wakes.iter().map(|(at, _)| *at).min();
            let next = [wake, self.heals].into_iter().flatten().min().filter(|next| *next <= end);
            let until = next.unwrap_or(end);
            self.network.run_for(until.saturating_sub(self.network.elapsed));
            self.take_events();
            let now = self.network.elapsed;
            for (_, node) in self.wakes.extract_if(.., |(at, _)| *at <= now) {
                self.network.nodes[node].is_running = true;
            }
            if self.heals.is_some_and(|at| at <= now) {
                self.heals = None;
                self.network.cut.clear();
            }
            if next.is_none() {
                return;
            }
        }
    }

    fn take_events(&mut self) {
        for node in 0..self.network.nodes.len() {
            for event in std::mem::take(&mut self.network.nodes[node].events) {
                self.take_event(node, event);
            }
        }
    }

    fn take_event(&mut self, node: usize, event: Event) {
        if is_traced() {
            eprintln!("{:?}, {node}: {:.160}", self.network.elapsed, format!("{event:?}"));
        }
        match event {
            Event::Sample { reader, sample } => {
                let Some(key) = self.key(node, reader, sample.writer) else {
                    panic!("who wrote {sample:?}?")
                };
                self.take_sample(key, &sample);
            }
            Event::Lost { reader, writer, count } => {
                if let Some(key) = self.key(node, reader, writer) {
                    self.streams.entry(key).or_default().lost += count;
                }
            }
            Event::Matched { local, remote } if local.is_writer() => {
                let Some((reader, writer)) = self.key(node, local, remote) else { return };
                let offered = &self.endpoints[writer];
                let has_history = is_latched(&offered.qos) && is_latched(&self.endpoints[reader].qos);
                let start = if has_history {
                    offered.written.saturating_sub(offered.depth())
                } else {
                    offered.written
                };
                self.streams.entry((reader, writer)).or_default().start = Some(start);
            }
            Event::Unmatched { local, remote } => {
                let Some(key) = self.key(node, local, remote) else { return };
                let stream = self.streams.entry(key).or_default();
                if local.is_writer() {
                    (stream.start, stream.is_torn) = (None, true);
                } else {
                    *stream = Stream { start: stream.start, is_torn: stream.is_torn, ..Stream::default() };
                }
            }
            Event::Warning { fault, from, count } => panic!("{fault:?} from {from:?}, {count} times"),
            _ => {}
        }
    }

    fn take_sample(&mut self, key: (usize, usize), sample: &Sample) {
        let index = sample.number.0 as u64 - 1;
        let is_whole = sample.payload == content(index, sample.payload.len());
        assert!(is_whole, "sample {index} of {key:?} was changed on its way");
        let stream = self.streams.entry(key).or_default();
        match stream.next {
            None => (stream.first, stream.whole_since) = (index, index),
            Some(next) => {
                assert!(index >= next, "sample {index} of {key:?} came after {}", next - 1);
                stream.missing += index - next;
                stream.missing_due += stream.start.map_or(0, |start| index.saturating_sub(start.max(next)));
                if index > next {
                    stream.whole_since = index;
                }
                if stream.is_torn {
                    (stream.first, stream.missing, stream.missing_due, stream.lost) = (index, 0, 0, 0);
                }
                let Stream { missing_due, lost, .. } = *stream;
                assert!(
                    missing_due <= lost,
                    "{key:?}: {index} came after {}: {missing_due} missing, {lost} lost",
                    next - 1
                );
            }
        }
        stream.is_torn = false;
        stream.next = Some(index + 1);
    }

    /// The indices of the reader and the writer that are `local` on `node`, and `remote`.
    fn key(&self, node: usize, local: EntityId, remote: Guid) -> Option<(usize, usize)> {
        let other = self.network.nodes.iter().position(|node| node.participant.prefix() == remote.prefix)?;
        let find = |node, id| self.endpoints.iter().position(|it| (it.node, it.id) == (node, id));
        let (local, remote) = (find(node, local)?, find(other, remote.entity)?);
        Some(if self.endpoints[local].is_writer() { (remote, local) } else { (local, remote) })
    }

    /// Restores the network and checks the final state.
    fn conclude(&mut self) {
        {
            let mut weather = self.weather.borrow_mut();
            (weather.loss, weather.duplication, weather.delay) = (0, 0, MS);
        }
        self.run_for(LONGEST_OUTAGE);
        assert!(self.wakes.is_empty() && self.network.cut.is_empty());
        // Crashed participants are removed after their lease.
        self.run_for(30 * SECOND);
        for index in 0..self.endpoints.len() {
            if self.endpoints[index].is_alive && self.endpoints[index].is_writer() {
                self.write(index, 20);
            }
        }
        self.run_for(5 * SECOND);
        self.check_matches();
        self.check_streams();
        self.check_quiet();
    }

    fn check_matches(&self) {
        for local in self.endpoints.iter().filter(|endpoint| endpoint.is_alive) {
            let mut expected: Vec<_> = self
                .endpoints
                .iter()
                .filter(|other| {
                    other.is_alive && other.topic == local.topic && other.is_writer() != local.is_writer()
                })
                .filter(|other| {
                    let (writer, reader) = if local.is_writer() { (local, *other) } else { (*other, local) };
                    downbeat_rtps::qos::incompatible(&writer.qos, &reader.qos).is_none()
                })
                .map(|other| self.network.guid(other.node, other.id))
                .collect();
            let mut matched = self.network.nodes[local.node].participant.matched(local.id);
            expected.sort();
            matched.sort();
            assert_eq!(matched, expected, "endpoint {} of participant {}", local.id, local.node);
            let participant = &self.network.nodes[local.node].participant;
            assert!(
                !local.is_writer() || participant.is_acknowledged(local.id),
                "{} waits forever",
                local.id
            );
        }
    }

    /// Checks that the history of each reliable writer has arrived.
    fn check_streams(&self) {
        for (key, stream) in &self.streams {
            let (reader, writer) = (&self.endpoints[key.0], &self.endpoints[key.1]);
            let is_reliable = [reader, writer].iter().all(|it| it.qos.reliability == Reliability::Reliable);
            let Some(start) = stream.start.filter(|_| reader.is_alive && writer.is_alive && is_reliable)
            else {
                continue;
            };
            let due = start.max(writer.written.saturating_sub(writer.depth()));
            // Samples written before the first received one may be lost as well.
            let Stream { missing, missing_due, lost, first, .. } = *stream;
            assert!(
                (missing_due..=missing + first).contains(&lost),
                "{key:?}: {missing_due} to {missing} missing, {lost} lost"
            );
            if due < writer.written {
                assert_eq!(stream.next, Some(writer.written), "{key:?} lacks the newest sample");
                assert!(
                    stream.whole_since <= due,
                    "{key:?} lacks samples from {due} on: {}",
                    stream.whole_since
                );
            }
        }
    }

    /// Checks that only announcements are sent.
    fn check_quiet(&mut self) {
        let (others, announcements) = (Rc::new(Cell::new(0)), Rc::new(Cell::new(0)));
        let counts = (Rc::clone(&others), Rc::clone(&announcements));
        self.network.watch = Box::new(move |flight| {
            let count = if is_announcement(&flight.bytes) { &counts.1 } else { &counts.0 };
            count.set(count.get() + 1);
        });
        self.run_for(30 * SECOND);
        assert_eq!(others.get(), 0, "unexpected datagrams");
        // One to the group every 3 s, and occasionally one to each other participant.
        let running = self.running().len();
        let allowed = running * (12 + 4 * running);
        assert!(announcements.get() <= allowed, "{} announcements in 30 s", announcements.get());
    }
}

fn is_announcement(datagram: &[u8]) -> bool {
    let (_, mut submessages) = parse(datagram).expect("a message");
    submessages.all(|submessage| match submessage.expect("a submessage") {
        Submessage::InfoTimestamp(_) | Submessage::InfoDestination(_) => true,
        Submessage::Data(data) => data.writer == EntityId::SPDP_WRITER,
        _ => false,
    })
}

fn topic_qos(random: &mut Random) -> Qos {
    let history = match random.below(3) {
        0 => History::KeepAll,
        _ => History::KeepLast(1 + random.below(12) as u32),
    };
    let durability = match history {
        History::KeepLast(_) if random.chance(50) => Durability::TransientLocal,
        _ => Durability::Volatile,
    };
    let reliability = if random.chance(20) { Reliability::BestEffort } else { Reliability::Reliable };
    Qos { history, durability, reliability, ..Qos::writer_default() }
}

fn is_latched(qos: &Qos) -> bool {
    qos.durability == Durability::TransientLocal
}

/// The payload of the sample with this index.
fn content(index: u64, size: usize) -> Bytes {
    let mut bytes = vec![index as u8; size];
    bytes[..4].copy_from_slice(&[0, 1, 0, 0]);
    bytes[4..12].copy_from_slice(&index.to_le_bytes());
    for (position, byte) in bytes.iter_mut().enumerate().skip(12).step_by(100) {
        *byte = (position / 100) as u8;
    }
    bytes.into()
}

/// Prints the seed of a run that fails.
struct Announce(u64);

impl Drop for Announce {
    fn drop(&mut self) {
        if std::thread::panicking() {
            eprintln!("replay with DOWNBEAT_SIMULATION_SEED={}", self.0);
        }
    }
}

/// Runs a seed. Returns a hash of all that was sent.
fn simulate(seed: u64) -> u64 {
    let _announce = Announce(seed);
    let mut simulation = Simulation::new(seed);
    let actions = 30 + simulation.random.below(80);
    for _ in 0..actions {
        simulation.act();
        let longest = if simulation.random.chance(20) { SECOND } else { 20 * MS };
        let pause = simulation.random.up_to(longest);
        simulation.run_for(pause);
    }
    simulation.conclude();
    simulation.trace.get()
}

fn is_traced() -> bool {
    std::env::var_os("DOWNBEAT_SIMULATION_TRACE").is_some()
}

fn variable(name: &str) -> Option<u64> {
    std::env::var(name)
        .ok()
        .map(|text| text.parse().unwrap_or_else(|_| panic!("{name} is not a number: {text}")))
}

#[test]
fn histories_arrive_once_and_in_order_and_then_nothing_is_sent() {
    match variable("DOWNBEAT_SIMULATION_SEED") {
        Some(seed) => _ = simulate(seed),
        None => (0..variable("DOWNBEAT_SIMULATION_SEEDS").unwrap_or(crate::SEEDS))
            .for_each(|seed| _ = simulate(seed)),
    }
}

#[test]
fn a_seed_replays_exactly() {
    for seed in [3, 5, 8] {
        assert_eq!(simulate(seed), simulate(seed), "seed {seed}");
    }
}
