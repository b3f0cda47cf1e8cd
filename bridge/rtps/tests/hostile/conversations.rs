//! A participant receives recorded conversations that are changed at random, and still works afterwards.
//!
//! Each round depends only on its number, as in `reading.rs`.

use std::net::Ipv4Addr;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use downbeat_rtps::protocol::Fault;
use downbeat_rtps::wire::{EntityId, GuidPrefix, parse};
use fuzzing::{Random, most_in, rounds};

use crate::mutation::{mutate, submessages};
use crate::targets::participant::{Listener, run, say};
use crate::{capture, robot};

/// The most memory of a participant, which stores samples of half a megabyte itself.
const MOST_MEMORY: usize = 16 << 20;

/// The recorded conversations, addressed to the participant `listener` and acknowledging its `writers`.
fn conversations(listener: GuidPrefix, writers: &[EntityId]) -> Vec<Vec<Vec<u8>>> {
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
                    replace(&mut datagram, &other.0, &listener.0);
                }
                address(&mut datagram, writers[said.len() % writers.len()]);
                said.push(datagram);
            }
            conversations.push(said);
        }
    }
    conversations
}

/// Changes messages to one user reader into messages to all, and acknowledgements into acknowledgements of
/// `writer`.
fn address(datagram: &mut [u8], writer: EntityId) {
    for (start, _) in submessages(datagram) {
        let (reader_at, is_from_reader) = match datagram[start] {
            0x15 | 0x16 => (start + 8, false),
            0x07 | 0x08 | 0x13 => (start + 4, false),
            0x06 | 0x12 => (start + 4, true),
            _ => continue,
        };
        let Some([reader @ .., a, b, c, kind]) = datagram.get_mut(reader_at..reader_at + 8) else { continue };
        if EntityId([*a, *b, *c, *kind]).is_builtin() {
            continue;
        }
        match is_from_reader {
            true => [*a, *b, *c, *kind] = writer.0,
            false => reader.fill(0),
        }
    }
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
    let (mut endpoints, mut samples) = (0, 0);
    let (_, writers) = Listener::new();
    for conversation in conversations(Listener::PREFIX, &writers) {
        let (mut listener, _) = Listener::new();
        for datagram in conversation {
            let mut said = Vec::new();
            say(&mut said, 1, &datagram);
            listener.hear(&said);
            endpoints = endpoints.max(listener.participant().remote_endpoints().count());
        }
        samples += listener.samples;
        assert_eq!(listener.participant().remote_participants().count(), 0, "all said goodbye");
        assert_eq!(listener.participant().counters().faults(Fault::Malformed), 0);
    }
    assert!(endpoints >= 13 && samples >= 10, "{endpoints} endpoints, {samples} samples");
}

#[test]
fn a_participant_survives_changed_conversations_in_bounded_memory() {
    let (_, writers) = Listener::new();
    let conversations = conversations(Listener::PREFIX, &writers);
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
        let (memory, result) = most_in(|| catch_unwind(AssertUnwindSafe(|| run(&conversation))));
        assert!(result.is_ok(), "round {round}: {conversation:02x?}");
        assert!(memory < MOST_MEMORY, "round {round} takes {memory} bytes of memory");
        most = most.max((memory, round));
    }
    println!("most memory and its round {most:?}");
}

#[test]
fn a_participant_works_with_its_peer_after_much_noise() {
    robot::survives_for_long(|robot| {
        let mut events = 0;
        let writers = ["rt/chatter", "rt/big"].map(|topic| robot.add_endpoints(topic));
        let mut conversations = conversations(robot.prefix(), &writers);
        for datagram in conversations.iter_mut().flatten() {
            replace(datagram, &Ipv4Addr::LOCALHOST.octets(), &robot::STRANGER.ip().octets());
        }
        for round in rounds(1_000) {
            let mut random = Random::new(round);
            for datagram in random.choose(&conversations) {
                let mut datagram = datagram.clone();
                if random.one_in(3) {
                    mutate(&mut datagram, &mut random);
                }
                robot.hear(&datagram);
            }
            robot.run_for(Duration::from_millis(10));
            events += robot.forget_events();
        }
        let counters = robot.participant().counters();
        assert!(counters.faults(Fault::Malformed) > 1000 && events > 1000, "{counters:?}");
    });
}
