#![allow(clippy::unwrap_used)]

use super::*;
use crate::middleware::in_process::Hub;
use crate::middleware::{Sample, WriteError};
use bytes::Bytes;
use downbeat_msgs::qos::QosProfile;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, channel};

const LONG: Duration = Duration::from_secs(30);

/// A participant that rejoins a hub, and where to tell trouble.
fn rejoining(hub: &Hub) -> (Rejoining, TroubleSink) {
    let hub = hub.clone();
    let participant = Rejoining::join(move |_| Ok(Box::new(hub.join()) as Box<dyn Middleware>)).unwrap();
    let sink = participant.shared.sink.clone();
    (participant, sink)
}

/// Tells of trouble, and waits until the participant is there again.
fn rejoin(participant: &Rejoining, sink: &TroubleSink) -> BTreeMap<Gid, Gid> {
    let (sender, steps) = channel();
    participant.on_rejoin(Box::new(move |step| {
        let _ = sender.send(step.clone());
    }));
    sink.tell(Trouble::Engine("a test says so".to_owned()));
    assert_eq!(steps.recv_timeout(LONG).unwrap(), RejoinStep::Leaving);
    let RejoinStep::Joined { participant: gid, endpoints } = steps.recv_timeout(LONG).unwrap() else {
        panic!("left twice")
    };
    assert_eq!(gid, participant.gid());
    endpoints
}

fn endpoint(qos: QosProfile) -> Endpoint {
    Endpoint::new("rt/text", "T", qos)
}

fn listen(on: &dyn Middleware, qos: QosProfile) -> (Box<dyn Reader>, Receiver<Bytes>) {
    let (sender, samples) = channel();
    let on_sample = move |sample: Sample| {
        let _ = sender.send(sample.cdr);
    };
    (on.create_reader(&endpoint(qos), Box::new(on_sample)).unwrap(), samples)
}

fn cdr(text: &str) -> Bytes {
    [&[0, 1, 0, 0], text.as_bytes()].concat().into()
}

#[test]
fn endpoints_are_there_again_with_other_identities() {
    let hub = Hub::new();
    let (participant, sink) = rejoining(&hub);
    let other = hub.join();
    let writer = participant.create_writer(&endpoint(QosProfile::DEFAULT)).unwrap();
    let (reader, samples) = listen(&participant, QosProfile::DEFAULT);
    let (_others, heard) = listen(&other, QosProfile::DEFAULT);
    let others = other.create_writer(&endpoint(QosProfile::DEFAULT)).unwrap();
    let (before, writer_before, reader_before) = (participant.gid(), writer.gid(), reader.gid());

    let endpoints = rejoin(&participant, &sink);
    assert_ne!(participant.gid(), before);
    assert_eq!(endpoints, [(writer_before, writer.gid()), (reader_before, reader.gid())].into());
    assert_eq!((writer.matched(), reader.matched()), (1, 1));
    writer.write(cdr("ours")).unwrap();
    assert_eq!(heard.recv_timeout(LONG).unwrap(), cdr("ours"));
    others.write(cdr("theirs")).unwrap();
    assert_eq!(samples.recv_timeout(LONG).unwrap(), cdr("theirs"));
}

#[test]
fn what_was_latched_reaches_those_that_come_after_the_rejoining() {
    let hub = Hub::new();
    let (participant, sink) = rejoining(&hub);
    let writer = participant.create_writer(&endpoint(QosProfile::LATCHED)).unwrap();
    writer.write(cdr("first")).unwrap();
    writer.write(cdr("last")).unwrap();
    rejoin(&participant, &sink);
    let (_reader, samples) = listen(&hub.join(), QosProfile::LATCHED);
    assert_eq!(samples.try_iter().collect::<Vec<_>>(), [cdr("last")]);
}

#[test]
fn an_endpoint_that_was_dropped_does_not_come_back_and_handlers_of_matches_stay() {
    let hub = Hub::new();
    let (participant, sink) = rejoining(&hub);
    let other = hub.join();
    let (_others, _) = listen(&other, QosProfile::DEFAULT);
    let (kept, dropped) = (endpoint(QosProfile::DEFAULT), Endpoint::new("rt/gone", "T", QosProfile::DEFAULT));
    let writer = participant.create_writer(&kept).unwrap();
    drop(participant.create_writer(&dropped).unwrap());
    let (sender, matches) = channel();
    writer.on_match(Box::new(move || {
        let _ = sender.send(());
    }));
    rejoin(&participant, &sink);
    matches.recv_timeout(LONG).unwrap();
    let topics: Vec<_> = other.remote_endpoints().into_iter().map(|endpoint| endpoint.topic_name).collect();
    assert_eq!(topics, ["rt/text"]);
}

#[test]
fn while_the_domain_cannot_be_joined_writes_are_refused_and_it_can_be_left() {
    let (hub, is_closed) = (Hub::new(), Arc::new(AtomicBool::new(false)));
    let join = {
        let is_closed = Arc::clone(&is_closed);
        move |_| {
            let refused = || MiddlewareError::Join { domain_id: 0, reason: "closed".to_owned() };
            let is_open = !is_closed.load(Ordering::SeqCst);
            is_open.then(|| Box::new(hub.join()) as Box<dyn Middleware>).ok_or_else(refused)
        }
    };
    let participant = Rejoining::join(join).unwrap();
    let writer = participant.create_writer(&endpoint(QosProfile::DEFAULT)).unwrap();
    is_closed.store(true, Ordering::SeqCst);
    let (sender, steps) = channel();
    participant.on_rejoin(Box::new(move |step| {
        let _ = sender.send(step.clone());
    }));
    participant.shared.sink.tell(Trouble::Engine("a test says so".to_owned()));
    assert_eq!(steps.recv_timeout(LONG).unwrap(), RejoinStep::Leaving);
    while writer.write(cdr("text")) != Err(WriteError::Away) {
        std::thread::yield_now();
    }
    assert!(matches!(participant.create_writer(&endpoint(QosProfile::DEFAULT)), Err(MiddlewareError::Away)));
    drop(writer);
    drop(participant);
}
