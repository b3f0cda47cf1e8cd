//! What those get that come later.
#![allow(clippy::unwrap_used)]

use super::{NO_TIMES, Ran};
use crate::engine::Domain;
use crate::peer::chatter;
use crate::support::{cdr, next, subscribe, wait_until};
use downbeat_bridge::middleware::Sample;
use downbeat_msgs::qos::{Durability, QosProfile};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

const TRANSIENT_LOCAL: QosProfile =
    QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT };

pub(super) fn a_late_reader_of_a_transient_local_writer_catches_up_in_order(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(TRANSIENT_LOCAL.keep_last(3))).unwrap();
    for number in 1..=5_u32 {
        writer.write(cdr(number.to_le_bytes())).unwrap();
    }
    let (_reader, samples) = subscribe(&*bob, &chatter(TRANSIENT_LOCAL));
    let mut received = Vec::new();
    while received.last() != Some(&cdr(5_u32.to_le_bytes())) {
        received.push(next(&samples).cdr);
    }
    // The history holds at least its depth; rustdds forgets what is beyond it only every few seconds.
    let expected: Vec<_> = (1..=5_u32).map(|number| cdr(number.to_le_bytes())).collect();
    assert!(received.len() >= 3 && expected.ends_with(&received), "{received:?}");
}

pub(super) fn a_late_reader_gets_no_more_than_the_history_depth(domain: &Domain<'_>) -> Ran {
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(TRANSIENT_LOCAL.keep_last(3))).unwrap();
    for number in 1..=20_u32 {
        writer.write(cdr(number.to_le_bytes())).unwrap();
    }
    let (reader, samples) = subscribe(&*bob, &chatter(TRANSIENT_LOCAL.keep_last(100)));
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    let count = until(&samples, &20_u32.to_le_bytes());
    match count {
        3 => Ran::Done(None),
        count => Ran::Failed(format!("{count} samples came, the depth is 3")),
    }
}

pub(super) fn a_late_volatile_reader_gets_no_history(domain: &Domain<'_>) -> Ran {
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(TRANSIENT_LOCAL.keep_last(5))).unwrap();
    for number in 1..=5_u32 {
        writer.write(cdr(number.to_le_bytes())).unwrap();
    }
    let (reader, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    // What came before this one is history.
    writer.write(cdr(6_u32.to_le_bytes())).unwrap();
    match until(&samples, &6_u32.to_le_bytes()) - 1 {
        0 => Ran::Done(None),
        count => Ran::Failed(format!("{count} samples came that were written before it was there")),
    }
}

pub(super) fn a_late_reader_gets_no_sample_past_its_lifespan(domain: &Domain<'_>) -> Ran {
    if !domain.engine.has_network {
        return Ran::NotApplicable(NO_TIMES);
    }
    let (alice, bob) = (domain.join(), domain.join());
    let lifespan = Duration::from_millis(250);
    let qos = QosProfile { lifespan: Some(lifespan), ..TRANSIENT_LOCAL };
    let writer = alice.create_writer(&chatter(qos)).unwrap();
    writer.write(cdr(1_u32.to_le_bytes())).unwrap();
    let written = Instant::now();
    wait_until("it has expired", || written.elapsed() > lifespan * 2);
    let (reader, samples) = subscribe(&*bob, &chatter(TRANSIENT_LOCAL));
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    writer.write(cdr(2_u32.to_le_bytes())).unwrap();
    match until(&samples, &2_u32.to_le_bytes()) - 1 {
        0 => Ran::Done(None),
        count => Ran::Failed(format!("{count} samples came that had expired")),
    }
}

/// Takes samples up to the one with this body; returns how many.
fn until(samples: &Receiver<Sample>, body: &[u8]) -> usize {
    let mut count = 1;
    while !next(samples).cdr.ends_with(body) {
        count += 1;
    }
    count
}
