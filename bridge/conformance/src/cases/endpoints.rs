//! Endpoints, what goes between them, and the graph of them.
#![allow(clippy::unwrap_used)]

use super::Ran;
use crate::engine::Domain;
use crate::peer::chatter;
use crate::support::{cdr, next, subscribe, wait_until};
use bytes::Bytes;
use downbeat_bridge::middleware::{Direction, WriteError};
use downbeat_msgs::qos::{Durability, History, QosProfile, Reliability};
use std::time::Duration;

const TRANSIENT_LOCAL: QosProfile =
    QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT };
const KEEP_ALL: QosProfile = QosProfile { history: History::KeepAll, ..QosProfile::DEFAULT };

pub(super) fn a_sample_arrives_as_it_was_written(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let (reader, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    wait_until("the writer has its reader", || writer.matched() == 1 && reader.matched() == 1);

    let before = unix_time_ns();
    // Body lengths around a multiple of 4, where alignment could add or cut bytes.
    for length in 4..=8_u8 {
        writer.write(cdr((0..length).collect::<Vec<_>>())).unwrap();
        let sample = next(&samples);
        assert_eq!(sample.cdr[..4 + usize::from(length)], cdr((0..length).collect::<Vec<_>>())[..]);
        assert!(sample.cdr[4 + usize::from(length)..].iter().all(|byte| *byte == 0), "only padding follows");
        assert_eq!(sample.writer, writer.gid());
        assert_eq!(sample.sequence_number, i64::from(length) - 3);
        let written = sample.source_time_ns.expect("the time of writing");
        assert!((before - 1..=unix_time_ns()).contains(&written), "{before} <= {written}");
    }
    assert!(writer.flush(Duration::from_secs(10)), "the reader acknowledges");
}

pub(super) fn a_best_effort_reader_hears_a_reliable_writer(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let (reader, samples) = subscribe(&*bob, &chatter(QosProfile::SENSOR_DATA));
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    writer.write(cdr([7; 8])).unwrap();
    assert_eq!(next(&samples).cdr, cdr([7; 8]));
}

pub(super) fn samples_of_a_writer_arrive_in_order_and_none_is_lost(domain: &Domain<'_>) {
    const COUNT: u32 = 2000;
    let (alice, bob) = (domain.join(), domain.join());
    let (reader, samples) = subscribe(&*bob, &chatter(KEEP_ALL));
    let writer = alice.create_writer(&chatter(KEEP_ALL)).unwrap();
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    for number in 0..COUNT {
        writer.write(cdr(number.to_le_bytes())).unwrap();
    }
    for number in 0..COUNT {
        assert_eq!(next(&samples).cdr, cdr(number.to_le_bytes()));
    }
}

pub(super) fn a_participant_hears_itself(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let (own_reader, own_samples) = subscribe(&*alice, &chatter(QosProfile::DEFAULT));
    let own_writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let (reader, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    wait_until("both readers are matched", || {
        [own_reader.matched(), own_writer.matched(), reader.matched()] == [1, 2, 1]
    });
    for number in 0..100_u8 {
        own_writer.write(cdr([number; 4])).unwrap();
    }
    for number in 0..100 {
        assert_eq!(next(&own_samples).cdr, cdr([number; 4]));
        assert_eq!(next(&samples).cdr, cdr([number; 4]));
    }
    assert!(own_writer.flush(Duration::from_secs(10)), "both acknowledge");
    drop(own_reader);
    wait_until("her own reader no longer counts", || own_writer.matched() == 1);
}

pub(super) fn matched_counts_follow_what_comes_and_goes(domain: &Domain<'_>) {
    let (alice, bob, carol) = (domain.join(), domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    assert_eq!(writer.matched(), 0);
    let (of_bob, _bobs) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    let (of_carol, _carols) = subscribe(&*carol, &chatter(QosProfile::DEFAULT));
    wait_until("the writer has two readers", || writer.matched() == 2);
    wait_until("each reader has the writer", || of_bob.matched() == 1 && of_carol.matched() == 1);

    drop(of_bob);
    wait_until("a dropped reader no longer counts", || writer.matched() == 1);
    drop(of_carol);
    drop(carol);
    wait_until("nor does one of a participant that left", || writer.matched() == 0);

    let (again, _samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    wait_until("the reader that came back is matched", || writer.matched() == 1 && again.matched() == 1);
    drop(writer);
    drop(alice);
    wait_until("a writer that left no longer counts", || again.matched() == 0);
}

pub(super) fn a_dropped_reader_hears_nothing_more(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let (dropped, dropped_samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    let (kept, kept_samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    wait_until("both readers are matched", || writer.matched() == 2 && kept.matched() == 1);
    writer.write(cdr([1; 4])).unwrap();
    next(&dropped_samples);
    next(&kept_samples);

    drop(dropped);
    writer.write(cdr([2; 4])).unwrap();
    assert_eq!(next(&kept_samples).cdr, cdr([2; 4]));
    assert!(dropped_samples.recv().is_err(), "its handler was dropped, and with it the sending half");
}

pub(super) fn payloads_of_either_byte_order_arrive_as_they_were_written(domain: &Domain<'_>) -> Ran {
    let (alice, bob) = (domain.join(), domain.join());
    let (reader, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    wait_until("the writer has its reader", || writer.matched() == 1 && reader.matched() == 1);
    for order in 0..=1 {
        let payload = Bytes::from(vec![0, order, 0, 0, 1, 2, 3, 4]);
        if let Err(error) = writer.write(payload.clone()) {
            return Ran::Failed(error.to_string());
        }
        assert_eq!(next(&samples).cdr, payload);
    }
    Ran::Done(None)
}

pub(super) fn a_payload_without_an_encapsulation_header_is_refused(domain: &Domain<'_>) {
    let alice = domain.join();
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    for bytes in [&[0xff; 8][..], &[0, 1, 0], &[]] {
        let found = bytes[..bytes.len().min(4)].to_vec();
        let refused = writer.write(Bytes::copy_from_slice(bytes));
        assert_eq!(refused, Err(WriteError::Encapsulation { found }));
    }
}

pub(super) fn endpoints_of_others_are_listed_until_they_go(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(TRANSIENT_LOCAL)).unwrap();
    let (reader, _samples) = subscribe(&*alice, &chatter(QosProfile::SENSOR_DATA));
    let on_chatter = || {
        let mut endpoints = bob.remote_endpoints();
        endpoints.retain(|endpoint| endpoint.topic_name == "rt/chatter");
        endpoints
    };
    wait_until("bob knows both endpoints of alice", || on_chatter().len() == 2);
    let found =
        |direction| on_chatter().into_iter().find(|endpoint| endpoint.direction == direction).unwrap();
    let (out, into) = (found(Direction::Out), found(Direction::In));
    assert_eq!(
        (out.gid, out.reliability, out.durability),
        (writer.gid(), Reliability::Reliable, Durability::TransientLocal)
    );
    assert_eq!(
        (into.gid, into.reliability, into.durability),
        (reader.gid(), Reliability::BestEffort, Durability::Volatile)
    );
    assert_eq!(out.type_name, "std_msgs::msg::dds_::String_");
    assert!(
        alice.remote_endpoints().iter().all(|endpoint| endpoint.topic_name != "rt/chatter"),
        "not her own"
    );

    drop(writer);
    wait_until("the writer is gone", || on_chatter().len() == 1);
    drop(reader);
    drop(alice);
    wait_until("nothing is left", || on_chatter().is_empty());
}

fn unix_time_ns() -> i64 {
    let now = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap();
    i64::try_from(now.as_nanos()).unwrap()
}
