//! Messages that were recorded and are sent again.

use std::sync::{Arc, Mutex};

use downbeat_rtps::wire::GuidPrefix;

use crate::common::Flight;
use crate::keystore::valid;
use crate::world::{Ca, ROBOT, SECOND, World};

/// A conversation of a robot with another participant: the prefixes, and what each sent.
fn recorded(ca: &Ca, name: &str, seed: u64) -> (World, Vec<(usize, std::net::SocketAddrV4, Vec<u8>)>) {
    let mut world = World::with_seed(&ca.enclave("/robot"), seed);
    let sent = Arc::new(Mutex::new(Vec::new()));
    let log = sent.clone();
    world.network.watch = Box::new(move |flight: &Flight| {
        log.lock().unwrap().push((flight.sender, flight.from, flight.bytes.clone()));
    });
    let node = world.join(&ca.enclave(name));
    let (writer, _) = world.equip(node);
    world.network.run_for(SECOND);
    world.assert_matched(1);
    for text in ["one", "two"] {
        world.network.write(node, writer, text);
        world.network.run_for(SECOND);
    }
    assert_eq!(world.texts(), ["one", "two"]);
    world.network.watch = Box::new(|_| {});
    let sent = std::mem::take(&mut *sent.lock().unwrap());
    (world, sent)
}

#[test]
fn a_whole_conversation_to_a_robot_with_the_same_guid_proves_nothing() {
    let ca = Ca::new(1, valid());
    for (name, why) in [
        ("/talker", "challenge2 of the handshake message is not"),
        ("/listener", "challenge1 of the handshake message is not"),
    ] {
        let (before, sent) = recorded(&ca, name, 1);
        // It has other random numbers, and the other participant is gone.
        let mut world = World::with_seed(&ca.enclave("/robot"), 100);
        let prefix = |world: &World| -> GuidPrefix { world.network.nodes[ROBOT].participant.prefix() };
        assert_eq!(prefix(&world), prefix(&before));
        for (sender, from, datagram) in &sent {
            if *sender != ROBOT {
                world.network.inject(ROBOT, *from, datagram);
            }
        }
        world.network.run_for(2 * SECOND);
        world.assert_alone();
        assert!(world.texts().is_empty());
        world.assert_said(why);
    }
}

#[test]
fn everything_again_to_the_same_robot_changes_nothing() {
    let ca = Ca::new(1, valid());
    for name in ["/talker", "/listener"] {
        let (mut world, sent) = recorded(&ca, name, 1);
        for _ in 0..2 {
            for (sender, from, datagram) in &sent {
                world.network.inject(1 - sender, *from, datagram);
            }
            world.network.run_for(2 * SECOND);
        }
        assert_eq!(world.texts(), ["one", "two"], "{name}: nothing is delivered twice");
        world.assert_matched(1);
        // A late match would not receive this one.
        let writer = world.writer;
        world.network.write(ROBOT, writer, "still here");
        world.network.run_for(SECOND);
        let heard = world.network.nodes[1].events.iter().any(|event| {
            matches!(event, downbeat_rtps::protocol::Event::Sample { sample, .. }
                if sample.payload.ends_with(b"still here"))
        });
        assert!(heard, "{name}");
    }
}

#[test]
fn an_earlier_conversation_after_the_participant_has_proven_itself_again_changes_nothing() {
    let ca = Ca::new(1, valid());
    let (_, sent) = recorded(&ca, "/talker", 1);
    let (mut world, _) = recorded(&ca, "/talker", 200);
    for (sender, from, datagram) in &sent {
        world.network.inject(1 - sender, *from, datagram);
        world.network.run_for(SECOND / 100);
    }
    world.network.run_for(10 * SECOND);
    assert_eq!(world.texts(), ["one", "two"]);
    world.assert_matched(1);
}
