//! What holds for the DDS engine beside the conformance suite.
#![allow(clippy::unwrap_used)]

mod common;

use common::{Dds, Domain, cdr, next, on_loopback, subscribe, wait_until};
use downbeat_bridge::middleware::{DiscoveryRange, Endpoint, ParticipantOptions, WriteError};
use downbeat_msgs::qos::QosProfile;
use rustdds::{DomainParticipantBuilder, QosPolicyBuilder, StatusEvented, TopicKind};
use test_machine::free_domain;

fn chatter(qos: QosProfile) -> Endpoint {
    Endpoint::new("rt/chatter", "std_msgs::msg::dds_::UInt32_", qos)
}

#[test]
fn a_big_endian_payload_keeps_its_header_and_its_bytes() {
    let domain = Dds(free_domain());
    let bob = domain.join();
    let (reader, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));

    let peer = DomainParticipantBuilder::new(domain.0)
        .with_only_networks([std::net::Ipv4Addr::LOCALHOST])
        .build()
        .unwrap();
    let qos = QosPolicyBuilder::new().reliable(rustdds::Duration::from_millis(100)).build();
    let topic = peer
        .create_topic("rt/chatter".into(), "std_msgs::msg::dds_::UInt32_".into(), &qos, TopicKind::NoKey)
        .unwrap();
    let publisher = peer.create_publisher(&qos).unwrap();
    let writer = publisher.create_datawriter_no_key::<u32, BigEndianCdr>(&topic, None).unwrap();
    let mut writer_is_matched = false;
    wait_until("both are matched", || {
        // An event is reported once.
        writer_is_matched |= writer.try_recv_status().is_some();
        writer_is_matched && reader.matched() == 1
    });
    writer.write(0x0102_0304, None).unwrap();
    assert_eq!(next(&samples).cdr[..], [0, 0, 0, 0, 1, 2, 3, 4]);
}

struct BigEndianCdr;

impl rustdds::no_key::SerializerAdapter<u32> for BigEndianCdr {
    type Error = std::convert::Infallible;

    fn output_encoding() -> rustdds::RepresentationIdentifier {
        rustdds::RepresentationIdentifier::CDR_BE
    }

    fn to_bytes(value: &u32) -> Result<bytes::Bytes, Self::Error> {
        Ok(value.to_be_bytes().to_vec().into())
    }
}

#[test]
fn a_volatile_reader_does_not_get_what_an_earlier_reader_of_the_topic_got() {
    let domain = Dds(free_domain());
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let (first, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    wait_until("the first reader is matched", || writer.matched() == 1 && first.matched() == 1);
    writer.write(cdr([1; 4])).unwrap();
    next(&samples);
    drop(first);

    let (second, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    wait_until("the second reader is matched", || writer.matched() == 1 && second.matched() == 1);
    writer.write(cdr([2; 4])).unwrap();
    assert_eq!(next(&samples).cdr, cdr([2; 4]));
}

#[test]
fn a_write_to_a_reader_that_stopped_acknowledging_is_refused_and_does_not_wait() {
    let domain = Dds(free_domain());
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice
        .create_writer(&Endpoint { send_window: 4, ..chatter(QosProfile::DEFAULT.keep_last(1)) })
        .unwrap();
    let (reader, _samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    wait_until("both are matched", || writer.matched() == 1 && reader.matched() == 1);
    // Far more than a window, faster than acknowledgements travel.
    let refused = (0..1000).map(|_| writer.write(cdr([0; 4]))).find_map(Result::err);
    assert_eq!(refused, Some(WriteError::WindowFull));
    wait_until("acknowledgements open the window again", || writer.write(cdr([0; 4])).is_ok());
}

#[test]
fn a_handler_that_panics_ends_its_own_reader_only() {
    let domain = Dds(free_domain());
    let (alice, bob) = (domain.join(), domain.join());
    let writer = alice.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let fails = Box::new(|_| panic!("this handler fails on purpose"));
    let failing = bob.create_reader(&chatter(QosProfile::DEFAULT), fails).unwrap();
    let (works, samples) = subscribe(&*bob, &chatter(QosProfile::DEFAULT));
    wait_until("both readers are matched", || {
        writer.matched() == 2 && failing.matched() == 1 && works.matched() == 1
    });
    for number in 1..=3_u8 {
        writer.write(cdr([number; 4])).unwrap();
        assert_eq!(next(&samples).cdr, cdr([number; 4]));
    }
}

#[test]
fn with_discovery_off_a_participant_hears_only_itself() {
    let domain = free_domain();
    let off = ParticipantOptions { discovery_range: DiscoveryRange::Off, ..on_loopback(domain) };
    let [one, other] = [(); 2].map(|()| downbeat_bridge::middleware::join(&off).unwrap());
    let on_loopback = Dds(domain).join();
    let writer = one.create_writer(&chatter(QosProfile::DEFAULT)).unwrap();
    let (own, samples) = subscribe(&*one, &chatter(QosProfile::DEFAULT));
    let (others, _) = subscribe(&*other, &chatter(QosProfile::DEFAULT));
    let (strangers, _) = subscribe(&*on_loopback, &chatter(QosProfile::DEFAULT));
    wait_until("its own reader is matched", || writer.matched() == 1 && own.matched() == 1);
    writer.write(cdr([1; 4])).unwrap();
    assert_eq!(next(&samples).cdr, cdr([1; 4]));
    assert_eq!((others.matched(), strangers.matched()), (0, 0));
}
