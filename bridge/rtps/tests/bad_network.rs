//! Participants over networks that lose, delay, duplicate and reorder datagrams. A seed replays exactly:
//! `DOWNBEAT_SEEDS=105..106 cargo test -p downbeat-rtps --test bad_network`.

mod common;

#[allow(unused_imports)] // by `common`
use common::no_guard as guard;

use std::{ops::Range, time::Duration};

use common::{DELAY, Fate, Network, reliable};
use downbeat_rtps::{
    protocol::Event,
    qos::{History, Qos},
    wire::EntityId,
};

/// Number of samples of each writer.
const SAMPLES: usize = 20;

/// Numbers in 0 to 1 that depend on the seed only (xorshift64).
struct Random(u64);

impl Random {
    fn of(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    fn next(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn up_to(&mut self, most: Duration) -> Duration {
        most.mul_f64(self.next())
    }
}

/// Up to 30 % loss, delays that reorder datagrams, and 5 % duplicates.
fn bad(mut random: Random) -> Fate {
    let loss = 0.3 * random.next();
    Box::new(move |_| {
        if random.next() < loss {
            return Vec::new();
        }
        let mut arrivals = vec![DELAY + random.up_to(Duration::from_millis(3))];
        if random.next() < 0.05 {
            arrivals.push(DELAY + random.up_to(Duration::from_millis(8)));
        }
        arrivals
    })
}

fn seeds() -> Range<u64> {
    let given = std::env::var("DOWNBEAT_SEEDS").ok();
    let range = given.as_deref().and_then(|given| given.split_once(".."));
    range.and_then(|(from, to)| Some(from.parse().ok()?..to.parse().ok()?)).unwrap_or(1..40)
}

/// Returns whether every endpoint is matched with those of all participants and has reported it.
fn is_matched(network: &Network, endpoints: &[EntityId]) -> bool {
    network.nodes.iter().zip(endpoints).all(|(node, endpoint)| {
        node.count(|event| matches!(event, Event::Matched { local, .. } if local == endpoint))
            == endpoints.len()
    })
}

fn converse(seed: u64) {
    let mut random = Random::of(seed);
    let nodes = 2 + (4.0 * random.next()) as usize;
    let mut network = Network::new(nodes as u8);
    network.fate = bad(random);
    let qos = Qos { history: History::KeepAll, ..reliable() };
    let writers: Vec<_> = (0..nodes).map(|node| network.writer(node, "rt/a", qos.clone())).collect();
    let readers: Vec<_> = (0..nodes).map(|node| network.reader(node, "rt/a", qos.clone())).collect();
    let limit = Duration::from_secs(60);
    let matched = |network: &Network| is_matched(network, &writers) && is_matched(network, &readers);
    assert!(network.run_until(limit, matched), "seed {seed}: not all are matched");

    // Half of the samples need several fragments to another host.
    let text = |node: usize, number: usize| format!("{node}:{number}{}", " ".repeat(number % 2 * 5000));
    for number in 0..SAMPLES {
        for (node, writer) in writers.iter().enumerate() {
            network.write(node, *writer, &text(node, number));
        }
        network.run_for(Duration::from_millis(5));
    }
    let received = |network: &Network| {
        let mut texts = network.nodes.iter().zip(&readers).map(|(node, reader)| node.texts(*reader).len());
        texts.all(|count| count == SAMPLES * nodes)
    };
    assert!(network.run_until(limit, received), "seed {seed}: not all samples arrive");
    for (node, reader) in network.nodes.iter().zip(&readers) {
        let texts = node.texts(*reader);
        for source in 0..nodes {
            let start = format!("{source}:");
            let from_source: Vec<_> = texts.iter().filter(|text| text.starts_with(&start)).cloned().collect();
            let written: Vec<_> = (0..SAMPLES).map(|number| text(source, number)).collect();
            assert!(from_source == written, "seed {seed}: samples of {source} out of order");
        }
    }

    let acknowledged = |network: &Network| {
        let mut pairs = network.nodes.iter().zip(&writers);
        pairs.all(|(node, writer)| node.participant.is_acknowledged(*writer))
    };
    assert!(network.run_until(limit, acknowledged), "seed {seed}: not all is acknowledged");
    // Discovery data may still wait for the last acknowledgement, which is requested every 3 s.
    network.run_for(limit);
    let sent = |network: &Network| network.nodes.iter().map(|node| node.sent.0).sum::<u64>();
    let before = sent(&network);
    network.run_for(Duration::from_secs(60));
    // Announcements: to all every 3 s, and to each participant separately every 20 s / 3, at the next
    // announcement.
    let announcements = (nodes * (21 + (nodes - 1) * 8)) as u64;
    assert!(sent(&network) - before <= announcements, "seed {seed}: traffic without a cause");
}

#[test]
fn everything_arrives_once_and_in_order_and_then_nothing_is_sent() {
    seeds().for_each(converse);
}
