//! Limits on what others can make a participant store and send.

mod common;

#[allow(unused_imports)] // by `common`
use common::no_guard as guard;

use std::{
    cell::Cell,
    net::{Ipv4Addr, SocketAddrV4},
    rc::Rc,
    time::Duration,
};

use common::{Network, best_effort, reliable};
use downbeat_rtps::{
    protocol::{Departure, Event, Fault},
    wire::{
        AckNack, BuiltinEndpoints, Data, EndpointData, EntityId, Guid, GuidPrefix, Header, InlineQos,
        MessageBuilder, ParticipantData, Payload, SequenceNumber, SequenceNumberSet, VendorId,
    },
};

const SECOND: Duration = Duration::from_secs(1);

fn prefix(number: u32) -> GuidPrefix {
    let mut prefix = [0x99; 12];
    prefix[8..].copy_from_slice(&number.to_be_bytes());
    GuidPrefix(prefix)
}

/// An announcement of a participant at `address` with an infinite lease.
fn announcement(prefix: GuidPrefix, address: SocketAddrV4) -> Vec<u8> {
    let mut payload = Vec::new();
    ParticipantData {
        prefix,
        version: [2, 3],
        vendor: VendorId::FAST_DDS,
        metatraffic_unicast: vec![address],
        metatraffic_multicast: Vec::new(),
        default_unicast: vec![address],
        default_multicast: Vec::new(),
        lease: None,
        builtin_endpoints: BuiltinEndpoints::OURS,
        user_data: Vec::new(),
        name: String::new(),
        domain_id: None,
        domain_tag: String::new(),
        expects_inline_qos: false,
        security: None,
        receive_buffer: None,
    }
    .emit(&mut payload);
    data(prefix, EntityId::SPDP_WRITER, InlineQos::default(), Payload::Data(&payload))
}

fn data(prefix: GuidPrefix, writer: EntityId, inline_qos: InlineQos, payload: Payload<'_>) -> Vec<u8> {
    let mut datagram = Vec::new();
    let mut builder = MessageBuilder::new(&mut datagram, 1400, Header::ours(prefix));
    let number = SequenceNumber::FIRST;
    assert!(builder.data(&Data { reader: EntityId::UNKNOWN, writer, number, inline_qos, payload }));
    datagram
}

fn at(last: u8) -> SocketAddrV4 {
    SocketAddrV4::new(Ipv4Addr::new(10, 0, 0, last), 9999)
}

#[test]
fn a_forged_announcement_sends_its_victim_at_most_three_times_its_bytes() {
    let mut network = Network::new(2);
    for index in 0..50 {
        network.writer(0, &format!("rt/{index}"), reliable());
    }
    network.run_for(SECOND);
    let sent = Rc::new(Cell::new(0));
    let to_victim = sent.clone();
    network.watch = Box::new(move |flight| {
        if flight.to == at(77) {
            to_victim.set(to_victim.get() + flight.bytes.len());
        }
    });
    let mut forged = 0;
    for number in 0..20 {
        let datagram = announcement(prefix(number % 5), at(77));
        forged += datagram.len();
        network.inject(0, at(66), &datagram);
        network.run_for(SECOND);
    }
    network.run_for(60 * SECOND);
    assert!(sent.get() > 0 && sent.get() <= 3 * forged, "{} bytes for {forged}", sent.get());
    assert!(network.nodes[0].participant.counters().withheld > 0);
    // The other participant answers and is not limited.
    assert_eq!(network.nodes[1].participant.remote_endpoints().count(), 50);
}

#[test]
fn a_known_participant_cannot_be_moved_to_a_victim_by_a_forged_announcement() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", best_effort());
    network.reader(1, "rt/a", best_effort());
    network.run_for(SECOND);
    let sent = Rc::new(Cell::new(0));
    let to_victim = sent.clone();
    network.watch = Box::new(move |flight| {
        if flight.to == at(77) {
            to_victim.set(to_victim.get() + flight.bytes.len());
        }
    });
    let forged = announcement(network.nodes[1].participant.prefix(), at(77));
    network.inject(0, at(66), &forged);
    for _ in 0..1000 {
        network.write(0, writer, &"x".repeat(1000));
        network.run_for(Duration::from_millis(1));
    }
    assert!(sent.get() <= 3 * forged.len(), "{}", sent.get());
    // The real participant still answers, so nothing has changed.
    assert_eq!(sent.get(), 0);
    let reader = network.reader(1, "rt/a", best_effort());
    network.run_for(SECOND);
    network.write(0, writer, "back");
    network.run_for(SECOND);
    assert!(network.nodes[1].texts(reader).iter().any(|text| text == "back"));
}

#[test]
fn participants_are_bounded_and_those_that_answer_are_not_crowded_out() {
    let mut network = Network::new(2);
    network.run_for(SECOND);
    for number in 0..600 {
        network.inject(0, at(66), &announcement(prefix(number), at(77)));
    }
    let known = |network: &Network| network.nodes[0].participant.remote_participants().count();
    assert_eq!(known(&network), 512);
    let node = &network.nodes[0];
    let crowded = |event: &Event| matches!(event, Event::ParticipantLeft { reason: Departure::Crowded, .. });
    assert_eq!(node.count(crowded), 600 + 1 - 512);
    assert_eq!(node.participant.counters().faults(Fault::TooManyParticipants), 600 + 1 - 512);
    let warnings = |event: &Event| matches!(event, Event::Warning { .. });
    assert_eq!(node.count(warnings), 1);
    let late = network.join(|_| {});
    network.run_for(SECOND);
    let now_known: Vec<_> =
        network.nodes[0].participant.remote_participants().map(|data| data.prefix).collect();
    assert!(now_known.contains(&network.nodes[1].participant.prefix()));
    assert!(now_known.contains(&network.nodes[late].participant.prefix()));
    // Their infinite lease is replaced by a finite one.
    network.run_for(300 * SECOND);
    assert_eq!(known(&network), 2);
}

/// Announces a participant and answers the heartbeat that it is sent, which validates its address.
fn meet(network: &mut Network, stranger: GuidPrefix, address: SocketAddrV4) {
    network.inject(0, address, &announcement(stranger, address));
    let writer = EntityId::SEDP_PUBLICATIONS_WRITER;
    let Some((first, _)) = network.heartbeats.get(&(stranger, writer)).copied() else { return };
    let mut answer = Vec::new();
    let mut builder = MessageBuilder::new(&mut answer, 1400, Header::ours(stranger));
    builder.info_destination(network.nodes[0].participant.prefix());
    let (reader, missing) = (EntityId::SEDP_PUBLICATIONS_READER, SequenceNumberSet::new(first));
    assert!(builder.ack_nack(&AckNack { reader, writer, missing, count: 1, is_final: true }));
    network.inject(0, address, &answer);
}

/// Announces an endpoint of a participant that was met.
fn announce_endpoint(
    network: &mut Network,
    stranger: GuidPrefix,
    entity: EntityId,
    number: i64,
    topic: &str,
) {
    let mut payload = Vec::new();
    EndpointData {
        guid: Guid::new(stranger, entity),
        topic: topic.to_owned(),
        type_name: "std_msgs::msg::dds_::String_".to_owned(),
        qos: reliable(),
        unicast: Vec::new(),
        multicast: Vec::new(),
        user_data: Vec::new(),
        expects_inline_qos: false,
        security: None,
    }
    .emit(&mut payload);
    let (reader, writer) = (EntityId::UNKNOWN, EntityId::SEDP_SUBSCRIPTIONS_WRITER);
    let (inline_qos, payload) = (InlineQos::default(), Payload::Data(&payload));
    let mut datagram = Vec::new();
    let mut builder = MessageBuilder::new(&mut datagram, 1400, Header::ours(stranger));
    assert!(builder.data(&Data { reader, writer, number: SequenceNumber(number), inline_qos, payload }));
    network.inject(0, at(66), &datagram);
}

#[test]
fn participants_of_one_address_that_answer_keep_no_other_out() {
    let mut network = Network::new(2);
    let writer = network.writer(0, "rt/a", reliable());
    let reader = network.reader(1, "rt/a", reliable());
    network.run_for(SECOND);
    let mut number = 0;
    let mut crowd = |network: &mut Network, count: u32, with_reader: bool| {
        for _ in 0..count {
            number += 1;
            meet(network, prefix(number), at(66));
            if with_reader {
                announce_endpoint(network, prefix(number), EntityId::user_reader(1), 1, "rt/a");
            }
        }
    };
    crowd(&mut network, 600, false);
    let late = network.join(|_| {});
    let late_reader = network.reader(late, "rt/a", reliable());
    network.run_for(SECOND);
    let matched = |network: &Network, node: usize, reader| {
        network.nodes[0].participant.matched(writer).contains(&network.guid(node, reader))
    };
    assert!(matched(&network, 1, reader) && matched(&network, late, late_reader));
    // Also if all of them are matched.
    crowd(&mut network, 600, true);
    let later = network.join(|_| {});
    let later_reader = network.reader(later, "rt/a", reliable());
    network.run_for(SECOND);
    for (node, reader) in [(1, reader), (late, late_reader), (later, later_reader)] {
        assert!(matched(&network, node, reader), "the participant of node {node} is not matched");
    }
    assert_eq!(network.nodes[0].participant.remote_participants().count(), 512);
}

#[test]
fn endpoints_of_one_address_keep_no_other_out() {
    for topic in ["rt/a", "rt/elsewhere"] {
        let mut network = Network::new(0);
        network.join(|config| {
            (config.limits.endpoints, config.limits.endpoints_per_participant) = (400, 100);
        });
        let writer = network.writer(0, "rt/a", reliable());
        let node = network.join(|_| {});
        let reader = network.reader(node, "rt/a", reliable());
        network.run_for(SECOND);
        for stranger in 1..=5 {
            meet(&mut network, prefix(stranger), at(66));
            for number in 1..=105_u32 {
                let entity = EntityId::user_reader(number);
                announce_endpoint(&mut network, prefix(stranger), entity, number.into(), topic);
            }
        }
        assert_eq!(network.nodes[0].participant.remote_endpoints().count(), 400);
        let late = network.join(|_| {});
        let late_reader = network.reader(late, "rt/a", reliable());
        network.run_for(SECOND);
        let matched = network.nodes[0].participant.matched(writer);
        assert!(matched.contains(&network.guid(node, reader)));
        assert!(matched.contains(&network.guid(late, late_reader)));
        assert_eq!(network.nodes[0].participant.remote_endpoints().count(), 400);
    }
}

#[test]
fn endpoints_are_bounded_by_participant_and_in_all() {
    let mut network = Network::new(0);
    network.join(|config| {
        config.limits.endpoints_per_participant = 20;
        config.limits.endpoints = 30;
    });
    for _ in 0..2 {
        let node = network.join(|_| {});
        for index in 0..100 {
            network.writer(node, &format!("rt/{index}"), reliable());
        }
    }
    network.run_for(SECOND);
    let bounded = &network.nodes[0].participant;
    assert_eq!(bounded.remote_endpoints().count(), 30);
    assert_eq!(bounded.counters().faults(Fault::TooManyEndpoints), 170);
}

#[test]
fn endpoints_that_peers_would_refuse_are_not_created() {
    let mut network = Network::new(1);
    let config = common::endpoint(&"x".repeat(1000), reliable());
    assert!(network.call(0, |participant, now| participant.create_writer(now, config)).is_err());
}

#[test]
fn no_participant_can_impersonate_another() {
    let mut network = Network::new(2);
    network.run_for(SECOND);
    let victim = network.nodes[1].participant.prefix();
    let forged = InlineQos::removal(Guid::new(victim, EntityId::PARTICIPANT));
    network.inject(0, at(66), &announcement(prefix(1), at(66)));
    network.inject(0, at(66), &data(prefix(1), EntityId::SPDP_WRITER, forged, Payload::None));
    assert_eq!(network.nodes[0].participant.remote_participants().count(), 2);
    assert_eq!(network.nodes[0].participant.counters().faults(Fault::ForeignEndpoint), 1);
}

#[test]
fn noise_is_counted_and_reported_once_a_minute() {
    let mut network = Network::new(1);
    for _ in 0..90 {
        network.inject(0, at(66), b"GET / HTTP/1.1");
        network.inject(0, at(66), b"RTPS\x02\x03\x01\x0f999999999999\x15\x01\xff\xff");
        network.run_for(SECOND);
    }
    let node = &network.nodes[0];
    assert_eq!(node.participant.counters().faults(Fault::Foreign), 90);
    assert_eq!(node.participant.counters().faults(Fault::Malformed), 90);
    let of = |fault: Fault| move |event: &Event| matches!(event, Event::Warning { fault: reported, from, .. } if *reported == fault && *from == at(66));
    assert_eq!((node.count(of(Fault::Foreign)), node.count(of(Fault::Malformed))), (2, 2));
}

#[test]
fn a_participant_without_a_usable_address_is_ignored() {
    let mut network = Network::new(1);
    network.inject(0, at(66), &announcement(prefix(1), SocketAddrV4::new(Ipv4Addr::LOCALHOST, 7410)));
    assert_eq!(network.nodes[0].participant.remote_participants().count(), 0);
    assert_eq!(network.nodes[0].participant.counters().faults(Fault::NoAddress), 1);
}

#[test]
fn fifty_participants_discover_each_other() {
    let mut network = Network::new(50);
    let reader = network.reader(0, "rt/a", reliable());
    let writers: Vec<_> = (1..50).map(|node| (node, network.writer(node, "rt/a", reliable()))).collect();
    let limit = Duration::from_millis(200);
    assert!(network.run_until(limit, |network| network.nodes[0].participant.matched(reader).len() == 49));
    network.run_for(SECOND);
    for (node, writer) in writers {
        network.write(node, writer, "here");
    }
    network.run_for(SECOND);
    assert_eq!(network.nodes[0].texts(reader).len(), 49);
}
