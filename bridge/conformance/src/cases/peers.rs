//! Processes that end, and what others see of it.
#![allow(clippy::unwrap_used)]

use super::Ran;
use crate::engine::Domain;
use crate::peer::chatter;
use crate::peer_process::Role;
use crate::support::{cdr, holds_within, subscribe, wait_until};
use downbeat_bridge::middleware::{DiscoveryRange, Endpoint, Gid};
use downbeat_msgs::qos::QosProfile;
use std::net::{Ipv4Addr, UdpSocket};
use std::time::{Duration, Instant};

/// At once, on a machine that may be busy.
const SOON: Duration = Duration::from_secs(5);

pub(super) fn a_peer_that_leaves_disappears_immediately(domain: &Domain<'_>) -> Ran {
    let (mut reads, mut writes) = match (domain.start_peer(Role::Reads), domain.start_peer(Role::Writes)) {
        (Ok(reads), Ok(writes)) => (reads, writes),
        (Err(reason), _) | (_, Err(reason)) => return Ran::NotApplicable(reason),
    };
    let alice = domain.join();
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let (reader, _samples) = subscribe(&*alice, &chatter(QosProfile::DEFAULT));
    // She hears herself, too.
    let others = |peers: Vec<Gid>, own: Gid| peers.iter().filter(|peer| **peer != own).count();
    let matched =
        || (others(writer.matched_readers(), reader.gid()), others(reader.matched_writers(), writer.gid()));
    wait_until("both processes are matched", || matched() == (1, 1));
    let start = Instant::now();
    reads.leave();
    writes.leave();
    let listed = || alice.remote_endpoints().iter().filter(|end| end.topic_name == "rt/chatter").count();
    if holds_within(SOON, || (matched(), listed()) == ((0, 0), 0)) {
        format!("{} ms with its end", start.elapsed().as_millis()).into()
    } else {
        Ran::Failed(format!("{:?} are still matched, {} listed after {SOON:?}", matched(), listed()))
    }
}

pub(super) fn a_killed_reader_does_not_stop_the_writer(domain: &Domain<'_>) -> Ran {
    const SAMPLES: usize = 2 * Endpoint::SEND_WINDOW as usize;
    let mut killed = match domain.start_peer(Role::Reads) {
        Ok(killed) => killed,
        Err(reason) => return Ran::NotApplicable(reason),
    };
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let (_reader, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT.keep_last(10_000)));
    wait_until("both are matched", || writer.matched() == 2);
    killed.kill();
    let (mut refused, mut slowest, mut received) = (0, Duration::ZERO, 0);
    for _ in 0..SAMPLES {
        let start = Instant::now();
        refused += usize::from(writer.write(cdr([7; 8])).is_err());
        slowest = slowest.max(start.elapsed());
        // Not faster than the other one reads, so that what is refused is so for the one that was killed.
        received +=
            samples.recv_timeout(Duration::from_millis(if refused > 0 { 0 } else { 1000 })).iter().count();
    }
    let slowest = slowest.as_secs_f64() * 1e3;
    if refused == 0 && received == SAMPLES {
        format!("none of {SAMPLES} refused, the slowest write took {slowest:.1} ms").into()
    } else {
        Ran::Failed(format!("{refused} of {SAMPLES} refused, the slowest write took {slowest:.1} ms"))
    }
}

pub(super) fn the_hash_of_a_type_is_announced(domain: &Domain<'_>) -> Ran {
    const HASH: &str = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
    let (alice, bob) = (domain.join(), domain.join());
    let endpoint = Endpoint { type_hash: Some(HASH.to_owned()), ..chatter(QosProfile::DEFAULT) };
    let _writer = alice.create_writer(&endpoint).unwrap();
    let found = || bob.remote_endpoints().into_iter().find(|found| found.topic_name == endpoint.topic_name);
    wait_until("the writer is found", || found().is_some());
    match found().and_then(|found| found.type_hash) {
        Some(hash) if hash == HASH => Ran::Done(None),
        other => Ran::Failed(format!("received {other:?}")),
    }
}

/// Announcements go to the unicast ports of the first participants on the host that is named (RTPS 2.5,
/// 9.6.2.4.3).
pub(super) fn static_peers_are_announced_to(domain: &Domain<'_>) -> Ran {
    if !domain.engine.has_network {
        return Ran::NotApplicable("it has no network");
    }
    // An address of this machine that nobody announces to unasked.
    let host = Ipv4Addr::new(127, 0, 0, 77);
    let socket = UdpSocket::bind((host, 7400 + 250 * domain.domain_id + 10)).unwrap();
    socket.set_read_timeout(Some(SOON)).unwrap();
    let _alice = domain.join_with(|options| {
        options.discovery_range = DiscoveryRange::Subnet;
        options.static_peers = vec![host.to_string()];
    });
    let mut packet = [0; 64];
    match socket.recv(&mut packet) {
        Ok(length) if packet[..length].starts_with(b"RTPS") => Ran::Done(None),
        Ok(_) => Ran::Failed("something else than RTPS came".into()),
        Err(_) => Ran::Failed(format!("no announcement came in {SOON:?}")),
    }
}
