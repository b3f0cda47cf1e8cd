//! Datagrams of Fast DDS and Cyclone DDS are parsed correctly and written again byte for byte.

#![allow(clippy::unwrap_used)]

#[path = "golden/capture.rs"]
mod capture;

use std::collections::HashSet;
use std::net::{Ipv4Addr, SocketAddrV4};
use std::time::Duration;

use downbeat_rtps::qos::{Durability, Qos, Reliability, Representation};
use downbeat_rtps::wire::{
    BuiltinEndpoints, Data, EndpointData, EntityId, Guid, GuidPrefix, Header, MessageBuilder,
    ParticipantData, ParticipantMessage, Payload, SampleIdentity, SequenceNumber, Submessage, VendorId,
    parse,
};

/// The participants of the recordings.
const TALKER: GuidPrefix = GuidPrefix([0x01, 0x0f, 0x7f, 0x01, 0xac, 0x21, 0xf7, 0x45, 0, 0, 0, 0]);
const LISTENER: GuidPrefix = GuidPrefix([0x01, 0x0f, 0x7f, 0x01, 0xc2, 0x21, 0xe8, 0x06, 0, 0, 0, 0]);
const PERFORMER: GuidPrefix =
    GuidPrefix([0x01, 0x10, 0x49, 0xca, 0x2e, 0x27, 0x19, 0x65, 0x8f, 0xeb, 0x71, 0xf4]);
const PONG: GuidPrefix = GuidPrefix([0x01, 0x10, 0xa0, 0x93, 0xb7, 0xb1, 0x57, 0x37, 0xbe, 0x42, 0xc3, 0x53]);

fn read(datagram: &[u8]) -> (Header, Vec<Submessage<'_>>) {
    let (header, submessages) = parse(datagram).unwrap();
    (header, submessages.map(Result::unwrap).collect())
}

/// All DATA of the writer in the recording, with the participant that sent them.
fn data_of<'a>(recording: &[&'a [u8]], writer: EntityId) -> Vec<(GuidPrefix, Data<'a>)> {
    let all = recording.iter().flat_map(|datagram| {
        let (header, submessages) = read(datagram);
        submessages.into_iter().filter_map(move |submessage| match submessage {
            Submessage::Data(data) => Some((header.prefix, data)),
            _ => None,
        })
    });
    all.filter(|(_, data)| data.writer == writer).collect()
}

fn payload<'a>(data: &Data<'a>) -> Option<&'a [u8]> {
    match data.payload {
        Payload::Data(payload) => Some(payload),
        _ => None,
    }
}

fn participant(recording: &[&[u8]], prefix: GuidPrefix) -> ParticipantData {
    let announcements = data_of(recording, EntityId::SPDP_WRITER);
    let (_, first) = announcements.iter().find(|(sender, _)| *sender == prefix).unwrap();
    ParticipantData::parse(payload(first).unwrap()).unwrap()
}

fn endpoint(recording: &[&[u8]], announced_by: EntityId, guid: Guid) -> EndpointData {
    let announcements = data_of(recording, announced_by);
    let mut endpoints = announcements.iter().filter_map(|(_, data)| payload(data)).map(EndpointData::parse);
    endpoints.find_map(|endpoint| endpoint.ok().filter(|endpoint| endpoint.guid == guid)).unwrap()
}

fn loopback(port: u16) -> Vec<SocketAddrV4> {
    vec![SocketAddrV4::new(Ipv4Addr::LOCALHOST, port)]
}

#[test]
fn a_participant_of_fast_dds_is_parsed() {
    let expected = ParticipantData {
        prefix: TALKER,
        version: [2, 2],
        vendor: VendorId::FAST_DDS,
        metatraffic_unicast: loopback(7410),
        metatraffic_multicast: Vec::new(),
        default_unicast: loopback(7411),
        default_multicast: Vec::new(),
        lease: Some(Duration::from_secs(20)),
        builtin_endpoints: BuiltinEndpoints::OURS,
        user_data: b"enclave=/;\0".to_vec(),
        name: "/".to_owned(),
        domain_id: None,
        domain_tag: String::new(),
        expects_inline_qos: false,
        security: None,
        receive_buffer: None,
    };
    assert_eq!(participant(&capture::fast_dds(), TALKER), expected);
}

#[test]
fn a_participant_of_cyclone_dds_is_parsed() {
    let group = |port| vec![SocketAddrV4::new(Ipv4Addr::new(239, 255, 0, 1), port)];
    let expected = ParticipantData {
        prefix: PERFORMER,
        version: [2, 1],
        vendor: VendorId::CYCLONE,
        metatraffic_unicast: loopback(45_749),
        metatraffic_multicast: group(7400),
        default_unicast: loopback(45_749),
        default_multicast: group(7401),
        lease: Some(Duration::from_secs(10)),
        builtin_endpoints: BuiltinEndpoints(0xfc3f),
        user_data: b"DDSPerf:0:8076:vm".to_vec(),
        name: String::new(),
        domain_id: Some(0),
        domain_tag: String::new(),
        expects_inline_qos: false,
        security: None,
        receive_buffer: None,
    };
    assert_eq!(participant(&capture::cyclone_dds(), PERFORMER), expected);
}

#[test]
fn a_writer_of_fast_dds_is_parsed() {
    let guid = Guid::new(TALKER, EntityId([0, 0, 0x13, 0x03]));
    let expected = EndpointData {
        guid,
        topic: "rt/chatter".to_owned(),
        type_name: "std_msgs::msg::dds_::String_".to_owned(),
        qos: Qos { durability: Durability::TransientLocal, ..Qos::writer_default() },
        unicast: loopback(7411),
        multicast: Vec::new(),
        user_data: b"typehash=RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18;"
            .to_vec(),
        expects_inline_qos: false,
        security: None,
    };
    assert_eq!(endpoint(&capture::fast_dds(), EntityId::SEDP_PUBLICATIONS_WRITER, guid), expected);
}

#[test]
fn a_reader_of_fast_dds_is_parsed() {
    let guid = Guid::new(TALKER, EntityId([0, 0, 0x15, 0x04]));
    let reader = endpoint(&capture::fast_dds(), EntityId::SEDP_SUBSCRIPTIONS_WRITER, guid);
    assert_eq!(reader.topic, "rq/triggerRequest");
    assert_eq!(reader.type_name, "std_srvs::srv::dds_::Trigger_Request_");
    assert_eq!(reader.qos, Qos { reliability: Reliability::Reliable, ..Qos::reader_default() });
}

#[test]
fn a_writer_of_cyclone_dds_is_parsed() {
    let guid = Guid::new(PONG, EntityId([0, 0, 0x0d, 0x03]));
    let expected = EndpointData {
        guid,
        topic: "DDSPerfRPongOU".to_owned(),
        type_name: "OneULong".to_owned(),
        qos: Qos {
            partition: vec!["011049ca_2e271965_8feb71f4_000001c1".to_owned()],
            representation: vec![Representation::XCDR1, Representation::XCDR2],
            ..Qos::writer_default()
        },
        unicast: Vec::new(),
        multicast: Vec::new(),
        user_data: Vec::new(),
        expects_inline_qos: false,
        security: None,
    };
    assert_eq!(endpoint(&capture::cyclone_dds(), EntityId::SEDP_PUBLICATIONS_WRITER, guid), expected);
}

#[test]
fn announcements_are_the_same_when_written_again() {
    let mut count = 0;
    for recording in [capture::fast_dds(), capture::cyclone_dds()] {
        for (_, data) in data_of(&recording, EntityId::SPDP_WRITER) {
            let Some(payload) = payload(&data) else { continue };
            let participant = ParticipantData::parse(payload).unwrap();
            let mut again = Vec::new();
            participant.emit(&mut again);
            assert_eq!(ParticipantData::parse(&again), Ok(participant));
            count += 1;
        }
        for writer in [EntityId::SEDP_PUBLICATIONS_WRITER, EntityId::SEDP_SUBSCRIPTIONS_WRITER] {
            for (sender, data) in data_of(&recording, writer) {
                let Some(payload) = payload(&data) else { continue };
                let endpoint = EndpointData::parse(payload).unwrap();
                assert_eq!(endpoint.guid.prefix, sender);
                assert_eq!(endpoint.guid.entity.is_writer(), writer == EntityId::SEDP_PUBLICATIONS_WRITER);
                let mut again = Vec::new();
                endpoint.emit(&mut again);
                assert_eq!(EndpointData::parse(&again), Ok(endpoint));
                count += 1;
            }
        }
    }
    assert!(count > 60, "{count}");
}

#[test]
fn both_announce_removals() {
    let removed = |recording: &[&[u8]], writer| -> HashSet<Guid> {
        let all = data_of(recording, writer);
        all.iter().filter_map(|(_, data)| data.inline_qos.removed(data.payload)).collect()
    };
    let fast_dds = capture::fast_dds();
    let chatter = Guid::new(TALKER, EntityId([0, 0, 0x13, 0x03]));
    assert!(removed(&fast_dds, EntityId::SEDP_PUBLICATIONS_WRITER).contains(&chatter));
    let participants = [TALKER, LISTENER].map(|prefix| Guid::new(prefix, EntityId::PARTICIPANT));
    assert_eq!(removed(&fast_dds, EntityId::SPDP_WRITER), participants.into());
    let cyclone_dds = capture::cyclone_dds();
    let pong = Guid::new(PONG, EntityId([0, 0, 0x0d, 0x03]));
    assert!(removed(&cyclone_dds, EntityId::SEDP_PUBLICATIONS_WRITER).contains(&pong));
    let performer = Guid::new(PERFORMER, EntityId::PARTICIPANT);
    assert!(removed(&cyclone_dds, EntityId::SPDP_WRITER).contains(&performer));
}

#[test]
fn a_reply_contains_the_identity_of_its_request() {
    let recording = capture::fast_dds();
    let replies_to = Guid::new(LISTENER, EntityId([0, 0, 0x15, 0x04]));
    let mut identities = data_of(&recording, EntityId([0, 0, 0x16, 0x03]))
        .into_iter()
        .map(|(sender, data)| (sender, data.number, data.inline_qos.related_sample_identity.unwrap()));
    let (sender, number, identity) = identities.next().unwrap();
    assert_eq!(sender, LISTENER);
    assert_eq!(identity, SampleIdentity { writer: replies_to, number: SequenceNumber::UNKNOWN });
    let reply = identities.next().unwrap();
    assert_eq!(reply, (TALKER, SequenceNumber::FIRST, SampleIdentity { writer: replies_to, number }));
}

#[test]
fn cyclone_dds_asserts_that_its_writers_are_alive() {
    for (sender, data) in data_of(&capture::cyclone_dds(), EntityId::WLP_WRITER) {
        let message = ParticipantMessage::parse(payload(&data).unwrap());
        assert_eq!(message, Ok(ParticipantMessage { prefix: sender, kind: ParticipantMessage::AUTOMATIC }));
    }
}

/// The message written again from its parsed form; `None` if it contains inline QoS parameters that this
/// engine does not send.
fn written_again(datagram: &[u8]) -> Option<Vec<u8>> {
    let (header, submessages) = read(datagram);
    let mut bytes = Vec::new();
    let mut message = MessageBuilder::new(&mut bytes, 65_507, header);
    for submessage in submessages {
        assert!(match submessage {
            Submessage::InfoDestination(prefix) => {
                message.info_destination(prefix);
                true
            }
            Submessage::InfoTimestamp(timestamp) => {
                message.info_timestamp(timestamp);
                true
            }
            // Fast DDS sends the identity with two ids, this engine with one.
            Submessage::Data(data) if data.inline_qos.related_sample_identity.is_some() => return None,
            Submessage::Data(data) => message.data(&data),
            Submessage::DataFragment(fragment) => message.data_fragment(&fragment),
            Submessage::AckNack(ack_nack) => message.ack_nack(&ack_nack),
            Submessage::Heartbeat(heartbeat) => message.heartbeat(&heartbeat),
            Submessage::Gap(gap) => message.gap(&gap),
            Submessage::NackFragment(nack) => message.nack_fragment(&nack),
            Submessage::HeartbeatFragment(heartbeat) => message.heartbeat_fragment(&heartbeat),
            Submessage::Unknown { .. } => true,
            other => panic!("{other:?} is new in the recordings"),
        });
    }
    Some(bytes)
}

/// The datagram without the statistics that Fast DDS appends.
fn without_statistics(datagram: &[u8]) -> &[u8] {
    const LENGTH: usize = 4 + 0x38;
    match datagram.split_last_chunk::<LENGTH>() {
        Some((before, [0x80, 0x01, 0x38, 0x00, ..])) => before,
        _ => datagram,
    }
}

#[test]
fn every_datagram_is_written_again_byte_for_byte() {
    let mut kinds = HashSet::new();
    for (recording, in_another_form) in [(capture::fast_dds(), 2), (capture::cyclone_dds(), 0)] {
        let mut skipped = 0;
        for (number, datagram) in recording.iter().enumerate() {
            let Some(again) = written_again(datagram) else {
                skipped += 1;
                continue;
            };
            assert_eq!(again, without_statistics(datagram), "datagram {number}");
            kinds.extend(read(datagram).1.iter().map(std::mem::discriminant));
        }
        assert_eq!(skipped, in_another_form);
    }
    assert!(kinds.len() >= 8, "all kinds but GAP and HEARTBEAT_FRAG");
}
