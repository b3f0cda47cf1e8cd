//! Participants with the enclaves of a keystore, connected in memory.
#![allow(clippy::unwrap_used)]

#[path = "../../rtps/tests/common/mod.rs"]
mod common;
mod keystore;

use std::net::SocketAddrV4;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{Network, best_effort, latched, reliable};
use downbeat_rtps::protocol::{Event, Severity};
use downbeat_rtps::wire::{
    Data, EntityId, Guid, GuidPrefix, Header, InlineQos, MessageBuilder, Payload, SequenceNumber,
};
use downbeat_security::tokens::{ByteOrder, GenericMessage, Token, class};
use keystore::{as_enclave, guard};

const SECOND: Duration = Duration::from_secs(1);

/// A network of the enclaves of a keystore.
fn network(enclaves: &[&'static str]) -> Network {
    let mut network = Network::new(0);
    for enclave in enclaves {
        as_enclave(enclave, || network.join(|_| {}));
    }
    network
}

/// What a node told its user about security.
fn reports(network: &Network, node: usize) -> Vec<String> {
    let reports = network.nodes[node].events.iter().filter_map(|event| match event {
        Event::Security(report) if report.severity == Severity::Warning => Some(report.text.clone()),
        _ => None,
    });
    reports.collect()
}

#[test]
fn participants_of_a_keystore_exchange_samples_of_every_kind() {
    for enclaves in [["/robot", "/listener"], ["/listener", "/talker"], ["/robot", "/robot"]] {
        let mut network = network(&enclaves);
        let writers = [("rt/a", reliable()), ("rt/b", best_effort()), ("rt/c", latched(5))]
            .map(|(topic, qos)| network.writer(0, topic, qos));
        network.write(0, writers[2], "before");
        let readers = [("rt/a", reliable()), ("rt/b", best_effort()), ("rt/c", latched(5))]
            .map(|(topic, qos)| network.reader(1, topic, qos));
        let is_matched =
            |network: &Network| writers.iter().all(|it| network.nodes[0].participant.matched(*it).len() == 1);
        assert!(network.run_until(2 * SECOND, is_matched), "{enclaves:?}: {:?}", reports(&network, 0));
        let large = "x".repeat(100_000);
        for writer in writers {
            network.write(0, writer, "small");
            network.write(0, writer, &large);
        }
        network.run_for(SECOND);
        let texts = |reader| network.nodes[1].texts(reader);
        assert_eq!(texts(readers[0]), ["small", &large], "{enclaves:?}");
        assert_eq!(texts(readers[1]), ["small", &large], "{enclaves:?}");
        assert_eq!(texts(readers[2]), ["before", "small", &large], "{enclaves:?}");
        assert!(reports(&network, 1).is_empty(), "{:?}", reports(&network, 1));
    }
}

#[test]
fn a_stranger_sees_nothing_and_is_not_heard() {
    let mut network = network(&["/robot", "/listener"]);
    let stranger = network.join(|config| config.name = "stranger".to_owned());
    let seen = Arc::new(Mutex::new(Vec::<u8>::new()));
    let captured = seen.clone();
    network.watch = Box::new(move |flight| captured.lock().unwrap().extend(&flight.bytes));
    let writer = network.writer(0, "rt/secret_topic", reliable());
    let reader = network.reader(1, "rt/secret_topic", reliable());
    let theirs = network.reader(stranger, "rt/another", best_effort());
    network.run_for(2 * SECOND);
    network.write(0, writer, "secret content");
    network.run_for(SECOND);
    assert_eq!(network.nodes[1].texts(reader), ["secret content"]);
    assert!(network.nodes[stranger].texts(theirs).is_empty());
    assert_eq!(network.nodes[stranger].participant.remote_endpoints().count(), 0);
    assert_eq!(network.nodes[0].participant.matched(writer).len(), 1);
    assert!(
        reports(&network, 0).iter().any(|text| text.contains("without security")),
        "{:?}",
        reports(&network, 0)
    );
    let seen = seen.lock().unwrap();
    for word in ["secret_topic", "secret content"] {
        // The stranger is in clear, and has a topic of another name.
        assert!(!seen.windows(word.len()).any(|bytes| bytes == word.as_bytes()), "{word}");
    }
}

#[test]
fn plain_submessages_in_the_name_of_an_authenticated_participant_are_dropped() {
    let mut network = network(&["/robot", "/listener"]);
    let writer = network.writer(0, "rt/a", reliable());
    let reader = network.reader(1, "rt/a", reliable());
    network.run_for(2 * SECOND);
    network.write(0, writer, "true");
    network.run_for(SECOND);
    let [ours, theirs] = [0, 1].map(|node| network.nodes[node].participant.prefix());
    let forged = in_the_name_of(ours, theirs, writer, 2, &[0, 1, 0, 0, b'n', b'o', 0, 0]);
    network.inject(1, SocketAddrV4::new(network.nodes[0].address, 7410), &forged);
    network.run_for(SECOND);
    assert_eq!(network.nodes[1].texts(reader), ["true"]);
    let reports = reports(&network, 1);
    assert!(reports.iter().any(|text| text.contains("not protected")), "{reports:?}");
}

#[test]
fn a_leaving_participant_is_forgotten_at_once_and_a_forged_farewell_is_not_believed() {
    let mut network = network(&["/robot", "/listener"]);
    network.run_for(2 * SECOND);
    assert_eq!(network.nodes[0].participant.remote_participants().count(), 1);
    network.call(1, |participant, now| participant.leave(now));
    network.run_for(Duration::from_millis(50));
    assert_eq!(network.nodes[0].participant.remote_participants().count(), 0);
}

/// A datagram with one sample in clear in the name of a participant.
fn in_the_name_of(
    prefix: GuidPrefix,
    to: GuidPrefix,
    writer: EntityId,
    number: i64,
    payload: &[u8],
) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut builder = MessageBuilder::new(&mut bytes, 60_000, Header::ours(prefix));
    builder.info_destination(to);
    let data = Data {
        reader: EntityId::UNKNOWN,
        writer,
        number: SequenceNumber(number),
        inline_qos: InlineQos::default(),
        payload: Payload::Data(payload),
    };
    assert!(builder.data(&data));
    bytes
}

#[test]
fn somebody_who_says_that_a_participant_has_forgotten_the_other_disturbs_nothing() {
    for enclaves in [["/robot", "/listener"], ["/listener", "/robot"]] {
        let mut network = network(&enclaves);
        let writer = network.writer(0, "rt/a", best_effort());
        let reader = network.reader(1, "rt/a", best_effort());
        network.run_for(2 * SECOND);
        let [ours, theirs] = [0, 1].map(|node| network.nodes[node].participant.prefix());
        let guid = |prefix| Guid::new(prefix, EntityId::PARTICIPANT);
        for number in 0..30_u32 {
            let message = GenericMessage {
                source: (Guid::new(theirs, EntityId::STATELESS_WRITER), 1000 + i64::from(number)),
                related: (Guid::UNKNOWN, 0),
                destination_participant: guid(ours),
                destination_endpoint: Guid::UNKNOWN,
                source_endpoint: Guid::UNKNOWN,
                class: class::AUTHENTICATION_REQUEST.to_owned(),
                tokens: vec![Token::new("DDS:Auth:PKI-DH:1.0+AuthReq")],
            };
            let mut payload = Vec::new();
            message.emit(&mut payload, ByteOrder::Little);
            let number = 1_000_000 + i64::from(number);
            let forged = in_the_name_of(theirs, ours, EntityId::STATELESS_WRITER, number, &payload);
            network.inject(0, SocketAddrV4::new(network.nodes[1].address, 7410), &forged);
            network.write(0, writer, "on");
            network.run_for(SECOND);
        }
        assert_eq!(network.nodes[1].texts(reader).len(), 30, "{enclaves:?}");
        let is_unmatched = |event: &Event| matches!(event, Event::Unmatched { .. });
        assert_eq!(network.nodes[0].count(is_unmatched) + network.nodes[1].count(is_unmatched), 0);
    }
}

/// The datagrams that a node sends, and when.
fn recorded(network: &mut Network, node: usize) -> Arc<Mutex<Vec<Vec<u8>>>> {
    let sent = Arc::new(Mutex::new(Vec::new()));
    let record = sent.clone();
    network.watch = Box::new(move |flight| {
        if flight.sender == node {
            record.lock().unwrap().push(flight.bytes.clone());
        }
    });
    sent
}

#[test]
fn what_a_silent_writer_has_said_is_not_heard_again() {
    let mut network = network(&["/robot", "/listener"]);
    let writers = [best_effort(), reliable()].map(|qos| network.writer(0, "rt/a", qos));
    let reader = network.reader(1, "rt/a", best_effort());
    network.run_for(2 * SECOND);
    let sent = recorded(&mut network, 0);
    for number in 0..8 {
        writers.iter().for_each(|writer| network.write(0, *writer, &number.to_string()));
        network.run_for(Duration::from_millis(100));
    }
    let said = network.nodes[1].texts(reader);
    assert_eq!(said.len(), 16);
    network.watch = Box::new(|_| {});
    // The writer is jammed, and somebody sends the same again at the same pace.
    network.cut.push((0, 1));
    let sent = std::mem::take(&mut *sent.lock().unwrap());
    for _ in 0..3 {
        network.run_for(2 * SECOND);
        for datagram in &sent {
            network.inject(1, SocketAddrV4::new(network.nodes[0].address, 7410), datagram);
            network.run_for(Duration::from_millis(100));
        }
    }
    assert_eq!(network.nodes[1].texts(reader), said);
}

#[test]
fn keys_that_a_participant_has_sent_are_not_taken_for_those_of_the_other() {
    let mut network = network(&["/robot", "/listener"]);
    let sent = recorded(&mut network, 0);
    network.writer(0, "rt/a", reliable());
    network.reader(1, "rt/a", reliable());
    network.run_for(2 * SECOND);
    let theirs = network.nodes[1].participant.prefix();
    let sent = std::mem::take(&mut *sent.lock().unwrap());
    for mut datagram in sent {
        datagram[8..20].copy_from_slice(&theirs.0);
        network.inject(0, SocketAddrV4::new(network.nodes[1].address, 7410), &datagram);
    }
    network.run_for(SECOND);
    let reports = reports(&network, 0);
    assert!(reports.iter().any(|text| text.contains("changed on its way")), "{reports:?}");
    let writer = network.writer(0, "rt/b", reliable());
    let reader = network.reader(1, "rt/b", reliable());
    network.run_for(2 * SECOND);
    network.write(0, writer, "still");
    network.run_for(SECOND);
    assert_eq!(network.nodes[1].texts(reader), ["still"]);
}
