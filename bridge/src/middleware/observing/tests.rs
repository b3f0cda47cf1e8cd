#![allow(clippy::unwrap_used)]

use super::*;
use crate::middleware::in_process::Hub;
use crate::middleware::{Aliveness, QosPolicyKind};
use downbeat_msgs::qos::Liveliness;
use std::sync::mpsc::{Receiver, channel};

const LONG: Duration = Duration::from_secs(30);
const MS: Duration = Duration::from_millis(1);

fn observing(hub: &Hub) -> Observing {
    Observing::over(Box::new(hub.join()))
}

fn endpoint(qos: QosProfile) -> Endpoint {
    Endpoint::new("rt/text", "T", qos)
}

fn write(writer: &dyn Writer) {
    writer.write(Bytes::from_static(&[0, 1, 0, 0, 7])).unwrap();
}

fn events(on_event: impl FnOnce(EventHandler)) -> Receiver<EndpointEvent> {
    let (sender, events) = channel();
    on_event(Box::new(move |event| {
        // The test may have stopped listening.
        let _ = sender.send(*event);
    }));
    events
}

fn next(events: &Receiver<EndpointEvent>) -> EndpointEvent {
    events.recv_timeout(LONG).unwrap()
}

#[test]
fn a_missed_deadline_is_told_on_both_sides_after_the_first_message() {
    let hub = Hub::new();
    let (alice, bob) = (observing(&hub), observing(&hub));
    let qos = QosProfile { deadline: Some(20 * MS), ..QosProfile::DEFAULT };
    let writer = alice.create_writer(&endpoint(qos)).unwrap();
    let reader = bob.create_reader(&endpoint(qos), Box::new(|_| ())).unwrap();
    let offered = events(|handler| writer.on_event(handler));
    let requested = events(|handler| reader.on_event(handler));
    assert_eq!(next(&offered), EndpointEvent::Matched { peer: reader.gid() });
    assert_eq!(next(&requested), EndpointEvent::Matched { peer: writer.gid() });
    write(&*writer);
    assert!(matches!(next(&offered), EndpointEvent::DeadlineMissed { count: 1.. }));
    assert!(matches!(next(&requested), EndpointEvent::DeadlineMissed { count: 1.. }));
}

#[test]
fn a_writer_that_is_silent_is_told_so_and_so_is_its_reader() {
    let hub = Hub::new();
    let (alice, bob) = (observing(&hub), observing(&hub));
    let qos = QosProfile {
        liveliness: Liveliness::ManualByTopic,
        liveliness_lease_duration: Some(20 * MS),
        ..QosProfile::DEFAULT
    };
    let writer = alice.create_writer(&endpoint(qos)).unwrap();
    let reader = bob.create_reader(&endpoint(qos), Box::new(|_| ())).unwrap();
    let offered = events(|handler| writer.on_event(handler));
    let requested = events(|handler| reader.on_event(handler));
    let peer = writer.gid();
    assert_eq!(next(&offered), EndpointEvent::Matched { peer: reader.gid() });
    assert_eq!(next(&offered), EndpointEvent::LivelinessLost);
    assert_eq!(next(&requested), EndpointEvent::Matched { peer });
    for now in [Aliveness::Alive, Aliveness::NotAlive] {
        assert_eq!(next(&requested), EndpointEvent::LivelinessChanged { peer, now });
    }
    write(&*writer);
    assert_eq!(next(&requested), EndpointEvent::LivelinessChanged { peer, now: Aliveness::Alive });
    assert_eq!(next(&offered), EndpointEvent::LivelinessLost, "once for each silence");
}

#[test]
fn what_held_before_is_told_to_who_listens_later() {
    let hub = Hub::new();
    let (alice, bob) = (observing(&hub), observing(&hub));
    let writer = alice.create_writer(&endpoint(QosProfile::SENSOR_DATA)).unwrap();
    let suits = bob.create_reader(&endpoint(QosProfile::SENSOR_DATA), Box::new(|_| ())).unwrap();
    let other = bob.create_reader(&endpoint(QosProfile::DEFAULT), Box::new(|_| ())).unwrap();
    let told = events(|handler| writer.on_event(handler));
    let policy = QosPolicyKind::Reliability;
    let expected = [
        EndpointEvent::Matched { peer: suits.gid() },
        EndpointEvent::IncompatibleQos { peer: other.gid(), policy },
    ];
    assert_eq!([next(&told), next(&told)], expected);
    let gone = EndpointEvent::Unmatched { peer: suits.gid() };
    drop(suits);
    assert_eq!(next(&told), gone);
}
