//! Matches by quality of service, and their events.
#![allow(clippy::unwrap_used)]

use super::{NO_TIMES, Ran};
use crate::engine::Domain;
use crate::peer::chatter;
use crate::support::{cdr, events, next, subscribe, wait_for, wait_until};
use downbeat_bridge::middleware::{Aliveness, Endpoint, EndpointEvent, QosPolicyKind, WriteOptions};
use downbeat_msgs::qos::{Durability, Liveliness, QosProfile, Reliability};
use std::sync::mpsc::Receiver;
use std::time::{Duration, Instant};

pub(super) fn a_reader_that_asks_for_more_than_is_offered_is_not_matched(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let offered = QosProfile { reliability: Reliability::BestEffort, ..QosProfile::DEFAULT };
    let writer = alice.create_writer(&chatter(offered)).unwrap();
    let (reliable, _) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    let (transient_local, _) =
        subscribe(&*bob, &chatter(QosProfile { durability: Durability::TransientLocal, ..offered }));
    let (suits, _) = subscribe(&*bob, &chatter(offered));
    // Created last, so discovered last: the others have been judged by then.
    wait_until("the reader that suits is matched", || suits.matched() == 1 && writer.matched() >= 1);
    assert_eq!((writer.matched(), reliable.matched(), transient_local.matched()), (1, 0, 0));
}

pub(super) fn each_policy_keeps_apart_what_does_not_suit_and_is_named_on_both_sides(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let ms = |ms| Some(Duration::from_millis(ms));
    let default = QosProfile::DEFAULT;
    let manual = QosProfile { liveliness: Liveliness::ManualByTopic, ..default };
    let lease = |lease| QosProfile { liveliness_lease_duration: lease, ..default };
    let pairs = [
        (QosProfile::SENSOR_DATA, default, QosPolicyKind::Reliability),
        (default, QosProfile::LATCHED, QosPolicyKind::Durability),
        (
            QosProfile { deadline: ms(500), ..default },
            QosProfile { deadline: ms(250), ..default },
            QosPolicyKind::Deadline,
        ),
        (default, manual, QosPolicyKind::Liveliness),
        (lease(ms(500)), lease(ms(250)), QosPolicyKind::Liveliness),
    ];
    for (number, (offered, requested, policy)) in pairs.into_iter().enumerate() {
        let on = |qos| Endpoint { topic_name: format!("rt/pair_{number}"), ..chatter(qos) };
        let writer = alice.create_writer(&on(offered)).unwrap();
        let (reader, _samples) = subscribe(&*bob, &on(requested));
        let (of_writer, of_reader) =
            (events(|handler| writer.on_event(handler)), events(|handler| reader.on_event(handler)));
        let incompatible = |peer| EndpointEvent::IncompatibleQos { peer, policy };
        assert_eq!(next(&of_writer), incompatible(reader.gid()));
        assert_eq!(next(&of_reader), incompatible(writer.gid()));
        assert_eq!((writer.matched(), reader.matched()), (0, 0), "{offered:?} {requested:?}");
    }
}

pub(super) fn a_peer_with_another_type_is_reported_on_both_sides_and_not_matched(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let ours = chatter(QosProfile::DEFAULT);
    let other = Endpoint { type_name: "std_msgs::msg::dds_::Int32_".into(), ..ours.clone() };
    let writer = alice.create_writer(&ours).unwrap();
    let (reader, _samples) = subscribe(&*bob, &other);
    let (of_writer, of_reader) =
        (events(|handler| writer.on_event(handler)), events(|handler| reader.on_event(handler)));
    let incompatible = |peer, endpoint: &Endpoint| EndpointEvent::IncompatibleType {
        peer,
        type_name: endpoint.type_name.as_str().into(),
    };
    assert_eq!(next(&of_writer), incompatible(reader.gid(), &other));
    assert_eq!(next(&of_reader), incompatible(writer.gid(), &ours));
    assert_eq!((writer.matched(), reader.matched()), (0, 0));
    // A handler that is registered later receives the present state.
    let later = events(|handler| writer.on_event(handler));
    assert_eq!(next(&later), incompatible(reader.gid(), &other));
}

pub(super) fn matches_are_reported_as_they_come_and_go(domain: &Domain<'_>) {
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let of_writer = events(|handler| writer.on_event(handler));
    let (reader, _samples) = subscribe(&*bob, &chatter(QosProfile::SENSOR_DATA));
    let peer = reader.gid();
    assert_eq!(next(&of_writer), EndpointEvent::Matched { peer });
    wait_until("the reader is matched", || reader.matched() == 1);
    // A handler that is registered later receives the present state.
    let of_reader = events(|handler| reader.on_event(handler));
    assert_eq!(next(&of_reader), EndpointEvent::Matched { peer: writer.gid() });
    drop(reader);
    assert_eq!(next(&of_writer), EndpointEvent::Unmatched { peer });
    let (again, _samples) = subscribe(&*bob, &chatter(QosProfile::SENSOR_DATA));
    assert_eq!(next(&of_writer), EndpointEvent::Matched { peer: again.gid() });
    let of_again = events(|handler| again.on_event(handler));
    assert_eq!(next(&of_again), EndpointEvent::Matched { peer: writer.gid() });
    let peer = writer.gid();
    drop(writer);
    assert_eq!(next(&of_again), EndpointEvent::Unmatched { peer });
}

pub(super) fn missed_deadlines_are_reported_on_both_sides(domain: &Domain<'_>) -> Ran {
    if !domain.engine.has_network {
        return Ran::NotApplicable(NO_TIMES);
    }
    let (alice, bob) = (domain.join(), domain.join());
    let (other, _others) = subscribe(&*alice, &chatter(QosProfile::SENSOR_DATA));
    // Exact on the wire.
    let qos = QosProfile { deadline: Some(Duration::from_millis(250)), ..QosProfile::DEFAULT };
    let writer = alice.create_writer(&chatter(qos)).unwrap();
    let (reader, samples) = subscribe(&*bob, &chatter(qos));
    wait_until("all are matched", || writer.matched() == 2 && reader.matched() == 1);
    let (of_writer, of_reader) =
        (events(|handler| writer.on_event(handler)), events(|handler| reader.on_event(handler)));
    // One is for somebody else: its number never comes, and yet it is not lost.
    let for_another = WriteOptions { only_to: Some(other.gid()), ..WriteOptions::default() };
    for options in [WriteOptions::default(), for_another, WriteOptions::default()] {
        writer.write_with(cdr([1; 4]), options).unwrap();
    }
    next(&samples);
    next(&samples);
    let missed = |of: &Receiver<EndpointEvent>| {
        let is_match = |event: &EndpointEvent| matches!(event, EndpointEvent::Matched { .. });
        std::iter::repeat_with(|| next(of)).find(|event| !is_match(event)).unwrap()
    };
    for event in [missed(&of_writer), missed(&of_reader)] {
        assert!(matches!(event, EndpointEvent::DeadlineMissed { count: 1.. }), "{event:?}");
    }
    Ran::Done(None)
}

pub(super) fn a_writer_with_manual_liveliness_lives_as_long_as_it_says_so(domain: &Domain<'_>) -> Ran {
    if !domain.engine.has_network {
        return Ran::NotApplicable(NO_TIMES);
    }
    let (alice, bob) = (domain.join(), domain.join());
    let lease = Duration::from_millis(500);
    let qos = QosProfile {
        liveliness: Liveliness::ManualByTopic,
        liveliness_lease_duration: Some(lease),
        ..QosProfile::DEFAULT
    };
    let writer = alice.create_writer(&chatter(qos)).unwrap();
    let (reader, _samples) = subscribe(&*bob, &chatter(qos));
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    let (of_writer, of_reader) =
        (events(|handler| writer.on_event(handler)), events(|handler| reader.on_event(handler)));
    let peer = writer.gid();
    let until = |now| {
        wait_for(&of_reader, EndpointEvent::LivelinessChanged { peer, now });
    };
    // Without a sample, for longer than a lease.
    let start = Instant::now();
    while start.elapsed() < lease * 3 {
        writer.assert_liveliness();
        let lost = of_writer.recv_timeout(lease / 5);
        assert!(!matches!(lost, Ok(EndpointEvent::LivelinessLost)), "after {:?}", start.elapsed());
    }
    until(Aliveness::Alive);
    let events = of_reader.try_iter().collect::<Vec<_>>();
    assert_eq!(events, [], "it did not die");
    wait_for(&of_writer, EndpointEvent::LivelinessLost);
    until(Aliveness::NotAlive);
    writer.assert_liveliness();
    until(Aliveness::Alive);
    drop(writer);
    until(Aliveness::Gone);
    Ran::Done(None)
}
