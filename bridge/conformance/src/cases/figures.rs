//! Times. None fails by them.
#![allow(clippy::unwrap_used)]

use crate::engine::Domain;
use crate::peer::chatter;
use crate::support::{cdr, next, subscribe, wait_until};
use downbeat_bridge::middleware::{Endpoint, Middleware, Sample};
use downbeat_msgs::qos::{Durability, History, QosProfile};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

pub(super) fn time_until_a_new_participant_is_matched(domain: &Domain<'_>) -> String {
    let alice = domain.join();
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let times: Vec<Duration> = (0..5)
        .map(|_| {
            let start = Instant::now();
            let bob = domain.join();
            let (reader, _samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
            wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
            let time = start.elapsed();
            drop(reader);
            drop(bob);
            wait_until("it has left", || writer.matched() == 0);
            time
        })
        .collect();
    format!("median {}", milliseconds(percentile(times, 50)))
}

pub(super) fn time_until_a_late_reader_has_a_latched_sample(domain: &Domain<'_>) -> String {
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(QosProfile::LATCHED)).unwrap();
    writer.write(cdr([7; 100])).unwrap();
    let known = || bob.remote_endpoints().iter().any(|endpoint| endpoint.gid == writer.gid());
    wait_until("the writer is known", known);
    let times = (0..5).map(|_| {
        let start = Instant::now();
        let (_reader, samples) = subscribe(&*bob, &chatter(QosProfile::LATCHED));
        next(&samples);
        start.elapsed()
    });
    format!("median {}", milliseconds(percentile(times.collect(), 50)))
}

pub(super) fn round_trip_of_100_bytes(domain: &Domain<'_>) -> String {
    const ROUNDS: usize = 500;
    let (alice, bob) = (domain.join(), domain.join());
    let on = |topic: &str| Endpoint { topic_name: topic.into(), ..chatter(QosProfile::DEFAULT) };
    let back = bob.create_writer(&on("rt/pong")).unwrap();
    let pongs = subscribe(&*alice, &on("rt/pong"));
    let there = alice.create_writer(&on("rt/ping")).unwrap();
    let answer = move |sample: Sample| {
        let _ = back.write(sample.cdr);
    };
    let _pings = bob.create_reader(&on("rt/ping"), Box::new(answer)).unwrap();
    wait_until("both ways are matched", || there.matched() == 1 && pongs.0.matched() == 1);
    // The other side may not be matched yet.
    let ping = || there.write(cdr([0; 100])).unwrap();
    ping();
    while pongs.1.recv_timeout(Duration::from_millis(100)).is_err() {
        ping();
    }
    let times = (0..ROUNDS).map(|_| {
        let start = Instant::now();
        ping();
        next(&pongs.1);
        start.elapsed()
    });
    let times: Vec<_> = times.collect();
    format!(
        "p50 {}, p99 {}",
        milliseconds(percentile(times.clone(), 50)),
        milliseconds(percentile(times, 99))
    )
}

pub(super) fn throughput(domain: &Domain<'_>) -> String {
    let keep_all =
        QosProfile { history: History::KeepAll, durability: Durability::Volatile, ..QosProfile::DEFAULT };
    let (alice, bob) = (domain.join(), domain.join());
    let small =
        rate(&*alice, &*bob, &Endpoint { topic_name: "rt/small".into(), ..chatter(keep_all) }, 100, 10_000);
    let large = Endpoint { topic_name: "rt/large".into(), ..chatter(keep_all) };
    let large = rate(&*alice, &*bob, &Endpoint { send_window: 8, ..large }, 1_000_000, 30);
    format!("{small:.0} samples/s of 100 B, {large:.0} MB/s in samples of 1 MB")
}

/// Samples in a second, each written as soon as it can be.
fn rate(from: &dyn Middleware, to: &dyn Middleware, endpoint: &Endpoint, bytes: usize, count: usize) -> f64 {
    let writer = from.create_writer(endpoint).unwrap();
    let (reader, samples): (_, Receiver<Sample>) = subscribe(to, endpoint);
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    let payload = cdr(vec![7; bytes]);
    let start = Instant::now();
    for _ in 0..count {
        wait_until("there is room", || writer.write(payload.clone()).is_ok());
    }
    (0..count).for_each(|_| drop(next(&samples)));
    count as f64 / start.elapsed().as_secs_f64()
}

fn percentile(mut times: Vec<Duration>, percent: usize) -> Duration {
    times.sort();
    times.get(times.len() * percent / 100).copied().unwrap_or_default()
}

fn milliseconds(time: Duration) -> String {
    format!("{:.2} ms", time.as_secs_f64() * 1e3)
}
