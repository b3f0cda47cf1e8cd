//! A participant hears recorded conversations that are changed at random, and works afterwards.
//!
//! Each round is made from its number alone, as in `reading.rs`.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use downbeat_rtps::wire::{GuidPrefix, parse};

use crate::mutation::mutate;
use crate::random::{Random, rounds};
use crate::targets::participant::{Listener, run, say};
use crate::{capture, memory, robot};

/// What one participant may hold. It keeps samples of its own of half a megabyte.
const MOST_MEMORY: usize = 16 << 20;

/// The datagrams of each speaker as if they had been for us: every other participant has our prefix, and endpoints whose
/// topics we have are ours.
fn conversations() -> Vec<Vec<Vec<u8>>> {
    let mut conversations = Vec::new();
    for recording in [capture::fast_dds(), capture::cyclone_dds()] {
        let prefix = |datagram: &[u8]| parse(datagram).unwrap().0.prefix;
        let mut speakers: Vec<GuidPrefix> = recording.iter().map(|datagram| prefix(datagram)).collect();
        speakers.sort();
        speakers.dedup();
        for speaker in &speakers {
            let mut said: Vec<Vec<u8>> = Vec::new();
            for datagram in recording.iter().filter(|datagram| prefix(datagram) == *speaker) {
                let mut datagram = datagram.to_vec();
                for other in speakers.iter().filter(|other| *other != speaker) {
                    replace(&mut datagram, &other.0, &Listener::PREFIX.0);
                }
                said.push(datagram);
            }
            conversations.push(said);
        }
    }
    conversations
}

fn replace(bytes: &mut [u8], old: &[u8], new: &[u8]) {
    for at in 0..bytes.len().saturating_sub(old.len() - 1) {
        if bytes[at..].starts_with(old) {
            bytes[at..at + new.len()].copy_from_slice(new);
        }
    }
}

#[test]
fn recorded_conversations_are_followed() {
    let mut most = 0;
    for conversation in conversations() {
        let (mut listener, _) = Listener::new();
        for datagram in conversation {
            let mut said = Vec::new();
            say(&mut said, 1, &datagram);
            listener.hear(&said);
            most = most.max(listener.participant().remote_endpoints().count());
        }
        assert_eq!(listener.participant().remote_participants().count(), 0, "all said goodbye");
        assert_eq!(listener.participant().counters().faults(downbeat_rtps::protocol::Fault::Malformed), 0);
    }
    assert!(most >= 13, "{most} endpoints were known");
}

#[test]
fn whatever_is_changed_in_a_conversation_a_participant_goes_on_in_bounded_memory() {
    let conversations = conversations();
    let mut most = (0, 0);
    for round in rounds(300) {
        let mut random = Random::new(round);
        let mut conversation = Vec::new();
        for datagram in random.choose(&conversations) {
            let mut datagram = datagram.clone();
            for _ in 0..=random.below(2) {
                if random.one_in(3) {
                    mutate(&mut datagram, &mut random);
                }
                say(&mut conversation, random.below(3) as u8, &datagram);
            }
        }
        let (memory, result) = memory::most_in(|| catch_unwind(AssertUnwindSafe(|| run(&conversation))));
        assert!(result.is_ok(), "round {round}: {conversation:02x?}");
        assert!(memory < MOST_MEMORY, "round {round} takes {memory} bytes of memory");
        most = most.max((memory, round));
    }
    println!("most memory and its round {most:?}");
}

#[test]
fn a_participant_that_heard_noise_for_long_works_with_its_peer() {
    let conversations = conversations();
    robot::survives(|robot| {
        for round in rounds(20_000) {
            let mut random = Random::new(round);
            let said = random.choose(&conversations);
            let mut datagram = random.choose(said).clone();
            replace(&mut datagram, &Listener::PREFIX.0, &robot.prefix().0);
            mutate(&mut datagram, &mut random);
            robot.hear(&datagram);
            if random.one_in(20) {
                robot.run_for(Duration::from_millis(10));
            }
        }
    });
}
