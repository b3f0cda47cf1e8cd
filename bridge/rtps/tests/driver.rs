//! Participants with sockets and threads over loopback.
#![allow(clippy::unwrap_used)]

use bytes::Bytes;
use downbeat_rtps::protocol::{EndpointConfig, WriteError, WriteOptions};
use downbeat_rtps::qos::{Durability, History, Qos, Reliability};
use downbeat_rtps::{EndpointEvent, JoinError, Options, Participant, Range, Reader, Writer};
use std::net::{Ipv4Addr, UdpSocket};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};
use test_machine::free_domain;

/// Generous: the machine may be busy.
const WATCHDOG: Duration = Duration::from_secs(30);

fn join(domain_id: u16) -> Participant {
    Participant::join(&Options::new(domain_id, Range::Localhost)).unwrap()
}

/// Two participants in a free domain.
fn join_two() -> (Participant, Participant) {
    let domain = free_domain();
    (join(domain), join(domain))
}

fn reliable() -> Qos {
    Qos { history: History::KeepLast(10), reliability: Reliability::Reliable, ..Qos::writer_default() }
}

fn keep_all() -> Qos {
    Qos { history: History::KeepAll, ..reliable() }
}

fn on(topic: &str, qos: Qos) -> EndpointConfig {
    EndpointConfig::new(topic, "T", qos)
}

fn payload(body: &[u8]) -> Bytes {
    [&[0, 1, 0, 0], body].concat().into()
}

/// Creates a reader that sends its payloads to a channel.
fn subscribe(participant: &Participant, topic: &str, qos: Qos) -> (Reader, Receiver<Bytes>) {
    let (sender, samples) = channel();
    let on_sample = move |sample: downbeat_rtps::protocol::Sample| {
        // The test may have stopped listening.
        let _ = sender.send(sample.payload);
    };
    (participant.create_reader(on(topic, qos), Box::new(on_sample)).unwrap(), samples)
}

fn wait_until(what: &str, holds: impl Fn() -> bool) {
    let start = Instant::now();
    while !holds() {
        assert!(start.elapsed() < WATCHDOG, "{what}");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn matched(writer: &Writer, reader: &Reader) {
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
}

#[test]
fn samples_of_all_sizes_arrive_in_order() {
    let (alice, bob) = join_two();
    let (reader, samples) = subscribe(&bob, "t", keep_all());
    let writer = alice.create_writer(on("t", keep_all())).unwrap();
    matched(&writer, &reader);
    let sizes = [0, 1, 100, 1_300, 1_500, 65_000, 70_000, 1_000_000, 8_000_000, 8];
    for size in sizes {
        writer.write(payload(&vec![7; size]), WriteOptions::default()).unwrap();
    }
    for size in sizes {
        assert_eq!(samples.recv_timeout(WATCHDOG).unwrap().len(), 4 + size);
    }
    assert!(writer.flush(WATCHDOG));
}

#[test]
fn an_answer_from_a_handler_arrives() {
    const ROUNDS: u32 = 200;
    let (alice, bob) = join_two();
    let pong = bob.create_writer(on("pong", reliable())).unwrap();
    let answer = move |sample: downbeat_rtps::protocol::Sample| {
        pong.write(sample.payload, WriteOptions::default()).unwrap();
    };
    let _pings = bob.create_reader(on("ping", reliable()), Box::new(answer)).unwrap();
    let (pongs, answers) = subscribe(&alice, "pong", reliable());
    let ping = alice.create_writer(on("ping", reliable())).unwrap();
    matched(&ping, &pongs);
    for round in 0..ROUNDS {
        let question = payload(&round.to_le_bytes());
        ping.write(question.clone(), WriteOptions::default()).unwrap();
        assert_eq!(answers.recv_timeout(WATCHDOG).unwrap(), question);
    }
}

#[test]
fn several_threads_write_and_the_order_of_each_is_kept() {
    const COUNT: u32 = 5_000;
    let (alice, bob) = join_two();
    let topics = ["a", "b", "c"];
    let readers: Vec<_> = topics.iter().map(|topic| subscribe(&bob, topic, keep_all())).collect();
    let threads: Vec<_> = topics
        .iter()
        .zip(&readers)
        .map(|(topic, (reader, _))| {
            let writer = alice.create_writer(on(topic, keep_all())).unwrap();
            matched(&writer, reader);
            std::thread::spawn(move || {
                for number in 0..COUNT {
                    let sample = payload(&number.to_le_bytes());
                    // Waits for room if the reader is slower.
                    while writer.write(sample.clone(), WriteOptions::default()) == Err(WriteError::WindowFull)
                    {
                        assert!(writer.flush(WATCHDOG));
                    }
                }
                assert!(writer.flush(WATCHDOG));
            })
        })
        .collect();
    for (_, samples) in &readers {
        for number in 0..COUNT {
            assert_eq!(samples.recv_timeout(WATCHDOG).unwrap(), payload(&number.to_le_bytes()));
        }
    }
    threads.into_iter().for_each(|thread| thread.join().unwrap());
}

#[test]
fn an_isolated_participant_receives_its_own_samples_and_binds_no_port() {
    let domain = free_domain();
    let alone = Participant::join(&Options::new(domain, Range::Off)).unwrap();
    let (reader, samples) = subscribe(&alone, "t", reliable());
    let writer = alone.create_writer(on("t", reliable())).unwrap();
    matched(&writer, &reader);
    writer.write(payload(&[1]), WriteOptions::default()).unwrap();
    assert_eq!(samples.recv_timeout(WATCHDOG).unwrap(), payload(&[1]));
    assert!(UdpSocket::bind((Ipv4Addr::LOCALHOST, 7400 + 250 * domain + 10)).is_ok());
}

#[test]
fn ports_in_use_are_skipped() {
    let domain = free_domain();
    let port = 7400 + 250 * domain + 10;
    let _taken = UdpSocket::bind((Ipv4Addr::LOCALHOST, port)).unwrap();
    // The port of announcements is bound by a program that does not share it.
    let _group = UdpSocket::bind((Ipv4Addr::UNSPECIFIED, 7400 + 250 * domain)).unwrap();
    let (alice, bob) = (join(domain), join(domain));
    let (reader, samples) = subscribe(&bob, "t", reliable());
    let writer = alice.create_writer(on("t", reliable())).unwrap();
    matched(&writer, &reader);
    writer.write(payload(&[1]), WriteOptions::default()).unwrap();
    assert_eq!(samples.recv_timeout(WATCHDOG).unwrap(), payload(&[1]));
}

#[test]
fn a_domain_without_ports_is_refused() {
    let refused = Participant::join(&Options::new(233, Range::Localhost));
    assert!(matches!(refused, Err(JoinError::Domain(233))));
}

#[test]
fn a_late_handler_receives_the_current_state() {
    let (alice, bob) = join_two();
    let (reader, _samples) = subscribe(&bob, "t", reliable());
    let latched = Qos { durability: Durability::TransientLocal, ..reliable() };
    let (_picky, _none) = subscribe(&bob, "t", latched);
    let writer = alice.create_writer(on("t", reliable())).unwrap();
    matched(&writer, &reader);
    let (sender, events) = channel();
    writer.on_event(Box::new(move |event| {
        let _ = sender.send(event.clone());
    }));
    let received: Vec<_> = (0..2).map(|_| events.recv_timeout(WATCHDOG).unwrap()).collect();
    assert!(received.contains(&EndpointEvent::Matched { peer: reader.guid() }), "{received:?}");
    assert!(received.iter().any(|event| matches!(event, EndpointEvent::Incompatible { .. })), "{received:?}");
    let peer = reader.guid();
    drop(reader);
    assert_eq!(events.recv_timeout(WATCHDOG).unwrap(), EndpointEvent::Unmatched { peer });
}

#[test]
fn handles_may_be_dropped_in_a_handler_and_after_the_participant() {
    let (alice, bob) = join_two();
    let alice = Arc::new(std::sync::Mutex::new(Some(alice)));
    let writer = alice.lock().unwrap().as_ref().unwrap().create_writer(on("t", reliable())).unwrap();
    let (sender, gone) = channel();
    let held = Arc::clone(&alice);
    let leave = move |_| {
        drop(held.lock().unwrap().take());
        let _ = sender.send(());
    };
    let (reader, _samples) = subscribe(&bob, "back", reliable());
    let back = bob.create_writer(on("there", reliable())).unwrap();
    let there = {
        let alice = alice.lock().unwrap();
        alice.as_ref().unwrap().create_reader(on("there", reliable()), Box::new(leave)).unwrap()
    };
    matched(&back, &there);
    back.write(payload(&[1]), WriteOptions::default()).unwrap();
    gone.recv_timeout(WATCHDOG).unwrap();
    wait_until("alice has left", || back.matched() == 0 && reader.matched() == 0);
    assert!(writer.write(payload(&[1]), WriteOptions::default()).is_err());
    assert!(!writer.flush(Duration::ZERO) || writer.matched() == 0);
}
