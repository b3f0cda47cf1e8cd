//! A robot receives changed datagrams of an authenticated participant and of a stranger.

use std::sync::{Arc, Mutex};

use fuzzing::{Random, most_in, rounds};

use crate::common::Flight;
use crate::keystore::valid;
use crate::mutation::mutate;
use crate::world::{Ca, ROBOT, SECOND, World};

const MOST_MEMORY: usize = 24 << 20;

#[test]
fn a_robot_survives_changed_datagrams_in_bounded_memory_and_believes_none() {
    let ca = Ca::new(1, valid());
    let (most, ()) = most_in(|| {
        let mut world = World::new(&ca.enclave("/robot"));
        let sent = Arc::new(Mutex::new(Vec::new()));
        let log = sent.clone();
        world.network.watch = Box::new(move |flight: &Flight| {
            log.lock().unwrap().push((flight.sender, flight.from, flight.bytes.clone()));
        });
        let talker = world.join(&ca.enclave("/talker"));
        let (writer, _) = world.equip(talker);
        world.network.run_for(SECOND);
        let large = "large".repeat(2000);
        for text in ["genuine", &large] {
            world.network.write(talker, writer, text);
        }
        world.network.run_for(SECOND);
        world.network.watch = Box::new(|_| {});
        let sent: Vec<_> = sent.lock().unwrap().drain(..).filter(|(sender, ..)| *sender == talker).collect();
        assert!(sent.len() > 20);
        for round in rounds(4000) {
            let mut random = Random::new(round);
            let (_, from, datagram) = random.choose(&sent);
            let mut datagram = datagram.clone();
            mutate(&mut datagram, &mut random);
            world.network.inject(ROBOT, *from, &datagram);
            if random.one_in(20) {
                world.network.run_for(SECOND / 100);
            }
        }
        world.network.run_for(60 * SECOND);
        let texts = world.texts();
        assert!(texts.iter().all(|text| text == "genuine" || *text == large), "{texts:?}");
        // They may have cost it a match, which comes back.
        world.network.write(talker, writer, "afterwards");
        world.network.run_for(SECOND);
        assert_eq!(world.texts().last().map(String::as_str), Some("afterwards"), "{}", world.said());
        world.assert_matched(1);
    });
    println!("{most} bytes");
    assert!(most < MOST_MEMORY, "{most} bytes");
}
