//! Participants with the enclaves of a keystore, connected in memory.
#![allow(clippy::unwrap_used)]

#[path = "../../rtps/tests/common/mod.rs"]
mod common;
mod keystore;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use common::{Network, best_effort, latched, reliable};
use downbeat_rtps::protocol::{Event, Severity};
use downbeat_rtps::wire::{EntityId, Submessage, parse};
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
    let forged = forged_data(&network, writer);
    let from = network.nodes[0].address;
    network.inject(1, std::net::SocketAddrV4::new(from, 7410), &forged);
    network.run_for(SECOND);
    assert_eq!(network.nodes[1].texts(reader), ["true"]);
    let reports = reports(&network, 1);
    assert!(reports.iter().any(|text| text.contains("not protected")), "{reports:?}");
}

/// A sample in clear, as its writer would send it next.
fn forged_data(network: &Network, writer: EntityId) -> Vec<u8> {
    use downbeat_rtps::wire::{Data, Header, InlineQos, MessageBuilder, Payload, SequenceNumber};
    let mut bytes = Vec::new();
    let header = Header::ours(network.nodes[0].participant.prefix());
    let mut builder = MessageBuilder::new(&mut bytes, 1000, header);
    builder.info_destination(network.nodes[1].participant.prefix());
    let payload = Payload::Data(&[0, 1, 0, 0, b'n', b'o', 0, 0]);
    let data = Data {
        reader: EntityId::UNKNOWN,
        writer,
        number: SequenceNumber(2),
        inline_qos: InlineQos::default(),
        payload,
    };
    assert!(builder.data(&data));
    assert!(matches!(parse(&bytes).unwrap().1.last(), Some(Ok(Submessage::Data(_)))));
    bytes
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
