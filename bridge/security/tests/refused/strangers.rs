//! Somebody without an enclave learns nothing.

use std::sync::{Arc, Mutex};

use bytes::Bytes;
use downbeat_rtps::protocol::EndpointConfig;
use downbeat_rtps::wire::{ParticipantData, Payload, Submessage, parse};

use crate::common::{Flight, latched, payload};
use crate::keystore::valid;
use crate::world::{Ca, ROBOT, SECOND, World};

/// In topics, types, names of nodes and parameters, and samples.
const SECRETS: [&str; 6] =
    ["secret_topic", "SecretType_", "secret_node", "secret_parameter", "secret content", "secret_hash"];

fn secret(topic: &str) -> EndpointConfig {
    let type_name = "secret_msgs::msg::dds_::SecretType_";
    let user_data = Bytes::from_static(b"typehash=secret_hash;");
    EndpointConfig { user_data, ..EndpointConfig::new(topic, type_name, latched(5)) }
}

#[test]
fn everything_that_is_sent_contains_no_topic_type_name_or_content() {
    let ca = Ca::new(1, valid());
    let mut world = World::new(&ca.enclave("/robot"));
    let sent = Arc::new(Mutex::new(Vec::<(usize, Vec<u8>)>::new()));
    let log = sent.clone();
    world.network.watch = Box::new(move |flight: &Flight| {
        log.lock().unwrap().push((flight.sender, flight.bytes.clone()));
    });
    let friend = world.join(&ca.enclave("/talker"));
    // A stranger is there from the start.
    let stranger = world.network.join(|_| {});
    for topic in ["rt/secret_topic", "rt/secret_node/describe"] {
        let writer = world.network.call(ROBOT, |robot, now| robot.create_writer(now, secret(topic))).unwrap();
        world.network.call(friend, |friend, now| friend.create_reader(now, secret(topic))).unwrap();
        world.network.call(stranger, |it, now| it.create_reader(now, secret("rt/*"))).unwrap();
        world.network.write(ROBOT, writer, "secret content, secret_parameter");
        world.network.run_for(2 * SECOND);
        assert_eq!(world.network.nodes[ROBOT].participant.matched(writer).len(), 1);
        let long = payload(&"secret content".repeat(10_000));
        let options = downbeat_rtps::protocol::WriteOptions::default();
        world.network.call(ROBOT, |robot, now| robot.write(now, writer, long, options)).unwrap();
    }
    world.network.run_for(30 * SECOND);
    world.network.call(ROBOT, |robot, now| robot.leave(now));
    world.network.run_for(SECOND);
    let received = |event: &_| matches!(event, downbeat_rtps::protocol::Event::Sample { .. });
    assert_eq!(world.network.nodes[friend].count(received), 4);
    assert_eq!(world.network.nodes[stranger].count(received), 0);
    assert_eq!(world.network.nodes[stranger].participant.remote_endpoints().count(), 0);
    let sent = sent.lock().unwrap();
    let (mut datagrams, mut announcements) = (0, 0);
    for (_, datagram) in sent.iter().filter(|(sender, _)| *sender != stranger) {
        datagrams += 1;
        for secret in SECRETS {
            let is_there = datagram.windows(secret.len()).any(|part| part == secret.as_bytes());
            assert!(!is_there, "{secret} is in clear in {datagram:02x?}");
        }
        let (_, submessages) = parse(datagram).unwrap();
        for submessage in submessages.map_while(Result::ok) {
            if let Submessage::Data(data) = submessage
                && let Payload::Data(payload) = data.payload
                && let Ok(announced) = ParticipantData::parse(payload)
            {
                announcements += 1;
                assert_eq!(announced.name, "");
            }
        }
    }
    assert!(datagrams > 100 && announcements > 10, "{datagrams} datagrams, {announcements} announcements");
}
