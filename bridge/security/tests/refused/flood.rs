//! Many participants at once that prove nothing.

use downbeat_rtps::wire::{
    Data, EntityId, Guid, GuidPrefix, Header, InlineQos, MessageBuilder, ParticipantData, Payload,
    SequenceNumber, VendorId,
};
use downbeat_security::enclave::Enclave;
use downbeat_security::tokens::{ByteOrder, GenericMessage, Token, class};
use fuzzing::most_in;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Instant;

use crate::keystore::valid;
use crate::liar::Lies;
use crate::world::{Ca, ROBOT, SECOND, World};

const MOST_MEMORY: usize = 24 << 20;

/// A message of a participant that is not there.
fn message(prefix: GuidPrefix, writer: EntityId, number: i64, payload: &[u8]) -> Vec<u8> {
    let mut datagram = Vec::new();
    let header = Header { version: [2, 3], vendor: VendorId::FAST_DDS, prefix };
    let (reader, inline_qos) = (EntityId::UNKNOWN, InlineQos::default());
    let (number, payload) = (SequenceNumber(number), Payload::Data(payload));
    assert!(MessageBuilder::new(&mut datagram, 65_000, header).data(&Data {
        reader,
        writer,
        number,
        inline_qos,
        payload
    }));
    datagram
}

/// The announcement of a participant that does not exist, made from that of another one.
fn announcement(of: &ParticipantData, prefix: GuidPrefix, address: SocketAddrV4) -> Vec<u8> {
    let mut data = of.clone();
    data.prefix = prefix;
    data.metatraffic_unicast = vec![address];
    data.default_unicast = vec![address];
    data.vendor = VendorId::FAST_DDS;
    let mut payload = Vec::new();
    data.emit(&mut payload);
    message(prefix, EntityId::SPDP_WRITER, 1, &payload)
}

/// CVE-2026-45092: a flood of handshakes.
#[test]
fn a_flood_of_handshakes_needs_little_memory_and_time_and_keeps_nobody_else_out() {
    let ca = Ca::new(1, valid());
    let (robot, talker, listener) = (ca.enclave("/robot"), ca.enclave("/talker"), ca.enclave("/listener"));
    let start = Instant::now();
    let (most, ()) = most_in(|| {
        let mut world = World::new(&robot);
        let first = world.join(&talker);
        world.equip(first);
        world.network.run_for(SECOND);
        world.assert_matched(1);
        let honest = world.network.nodes[ROBOT].participant.remote_participants().next().unwrap().clone();
        let to = world.network.nodes[ROBOT].participant.prefix();
        // A request with the genuine certificate, which costs the robot most.
        let request = request(&robot, &talker);
        let flood = |world: &mut World, round: u32| {
            for number in 0..200_u32 {
                let mut prefix = [0x11; 12];
                // Half of them has to begin.
                prefix[0] = if number % 2 == 0 { 0x11 } else { 0xee };
                prefix[8..].copy_from_slice(&(round * 200 + number).to_be_bytes());
                let prefix = GuidPrefix(prefix);
                let address = SocketAddrV4::new(Ipv4Addr::new(10, 0, 9, (number % 7) as u8), 7410);
                world.network.inject(ROBOT, address, &announcement(&honest, prefix, address));
                for sequence in 1..4 {
                    let mut said = request.clone();
                    said.source = (Guid::new(prefix, EntityId::STATELESS_WRITER), sequence);
                    said.destination_participant = Guid::new(to, EntityId::PARTICIPANT);
                    let mut payload = Vec::new();
                    said.emit(&mut payload, ByteOrder::Little);
                    let datagram = message(prefix, EntityId::STATELESS_WRITER, sequence, &payload);
                    world.network.inject(ROBOT, address, &datagram);
                }
            }
            world.network.run_for(SECOND / 10);
        };
        for round in 0..10 {
            flood(&mut world, round);
        }
        // Another one arrives while it goes on.
        let late = world.join(&listener);
        world.equip(late);
        let mut rounds = 10;
        while world.statuses[ROBOT].authenticated() < 2 {
            flood(&mut world, rounds);
            rounds += 1;
            assert!(rounds < 200, "20 s: {}", world.said());
        }
        world.network.run_for(SECOND);
        world.assert_matched(2);
        let (writer, robot_sent) = (world.writer, world.network.nodes[ROBOT].sent.1);
        world.network.write(ROBOT, writer, "still here");
        println!("{rounds} rounds, {robot_sent} bytes sent");
        // Each announcement and message has some hundred bytes.
        assert!(robot_sent < u64::from(rounds) * 800 * 1000, "{robot_sent} bytes");
    });
    println!("{most} bytes, {:?}", start.elapsed());
    assert!(most < MOST_MEMORY, "{most} bytes");
    assert!(start.elapsed() < 60 * SECOND);
}

/// The request of a participant, as everybody can record it.
fn request(robot: &Enclave, of: &Enclave) -> GenericMessage {
    let mut world = World::new(robot);
    let (_, lies) = world.join_liar(of, Lies::default());
    world.network.run_for(SECOND);
    let log = std::mem::take(&mut lies.lock().unwrap().log);
    let recorded = log.into_iter().find(|message| message.class == class::AUTHENTICATION);
    let token: Token = recorded.unwrap().tokens.remove(0);
    let own = world.network.nodes[ROBOT].participant.prefix();
    GenericMessage {
        source: (Guid::UNKNOWN, 1),
        related: (Guid::UNKNOWN, 0),
        destination_participant: Guid::new(own, EntityId::PARTICIPANT),
        destination_endpoint: Guid::UNKNOWN,
        source_endpoint: Guid::UNKNOWN,
        class: class::AUTHENTICATION.to_owned(),
        tokens: vec![token],
    }
}
