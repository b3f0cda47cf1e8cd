//! Samples of 10 bytes to 8 MB, to and from every engine at hand: rclpy on Fast DDS, Cyclone DDS in two
//! versions, rustdds, ourselves. What is asserted is that they arrive, never how fast.
#![allow(clippy::unwrap_used)]

mod common;
mod ours;

use bytes::Bytes;
use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::texts::{Talker, assert_whole, hear, publish_texts, taken, text_of};
use common::{WATCHDOG, cdr, on_loopback, subscribe, wait_until};
use downbeat_bridge::middleware::rtps::RtpsParticipant;
use downbeat_bridge::middleware::{Endpoint, Middleware};
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_msgs::qos::{History, QosProfile, Reliability};
use rustdds::{
    DomainParticipantBuilder, QosPolicyBuilder, RepresentationIdentifier, StatusEvented, TopicKind,
};
use serde_json::json;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};
use test_machine::free_domain;

/// Sizes of samples, and how many of them are sent one right after another.
const SIZES: [(usize, usize); 5] = [(10, 200), (1_400, 200), (70_000, 30), (1_000_000, 5), (8_000_000, 2)];
/// Holds all samples of a size.
const DEPTH: u32 = 500;
const RELIABLE: QosProfile = QosProfile { history: History::KeepLast(DEPTH), ..QosProfile::DEFAULT };
const BEST_EFFORT: QosProfile = QosProfile { reliability: Reliability::BestEffort, ..QosProfile::DEFAULT };

fn all_arrive(domain_id: u16, peer: &mut Peer) {
    let talker = Talker::join(&on_loopback(domain_id), RELIABLE);
    talker.meet(peer, DEPTH);
    for (size, count) in SIZES {
        talker.exchange(peer, size, count);
    }
}

/// A sample of every size arrives whole, when it is sent often enough.
fn some_arrive(domain_id: u16, peer: &mut Peer) {
    let talker = Talker::join(&on_loopback(domain_id), BEST_EFFORT);
    talker.meet(peer, 10);
    for (size, _) in SIZES {
        let mut number = 0;
        wait_until(&format!("the peer hears {size} bytes"), || {
            talker.say(number, size);
            number += 1;
            let first = Instant::now();
            let mut is_heard = false;
            while !is_heard && first.elapsed() < Duration::from_secs(1) {
                let heard = peer.ask(json!({"do": "take", "topic": "/ours"}));
                is_heard = heard.as_array().unwrap().iter().any(|text| text[1] == size);
            }
            is_heard
        });
        wait_until(&format!("we hear {size} bytes"), || {
            peer.ask(publish_texts(size, 1));
            talker.heard_within(Duration::from_secs(1)).is_some_and(|(_, heard)| heard == size)
        });
    }
}

const ALL: &str = "10 B to 8 MB, reliable: all messages";
const SOME: &str = "10 B to 8 MB, best effort";

#[test]
fn reliable_samples_of_every_size_pass_between_us_and_rclpy() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Topics", ALL, With::Rclpy, Way::Both);
    all_arrive(domain, &mut peer);
}

#[test]
fn reliable_samples_of_every_size_pass_between_us_and_cyclone() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Topics", ALL, With::Cyclone, Way::Both);
    all_arrive(domain, &mut peer);
}

#[test]
fn reliable_samples_of_every_size_pass_between_two_of_us() {
    let domain = free_domain();
    all_arrive(domain, &mut ours::start(domain));
}

#[test]
fn best_effort_samples_of_every_size_pass_between_us_and_rclpy() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Topics", SOME, With::Rclpy, Way::Both);
    some_arrive(domain, &mut peer);
}

#[test]
fn best_effort_samples_of_every_size_pass_between_us_and_cyclone() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Topics", SOME, With::Cyclone, Way::Both);
    some_arrive(domain, &mut peer);
}

#[test]
fn best_effort_samples_of_every_size_pass_between_two_of_us() {
    let domain = free_domain();
    some_arrive(domain, &mut ours::start(domain));
}

/// Publishes with a period, as a camera does, with the buffers and the queue of a stock subscription at the
/// other end.
fn stream(domain_id: u16, size: usize, count: usize, period: Duration) {
    let Some(mut peer) = Peer::start(domain_id, "LOCALHOST") else { return };
    let talker = Talker::join(&on_loopback(domain_id), QosProfile::DEFAULT);
    talker.meet(&mut peer, 10);
    let mut next = Instant::now();
    for number in 0..count {
        talker.say(number, size);
        next += period;
        std::thread::sleep(next.saturating_duration_since(Instant::now()));
    }
    assert_whole(&taken(&mut peer, "/ours", count), size, count);
}

#[test]
fn images_of_640_by_480_at_30_hz_reach_rclpy_all_150() {
    let _check = check("Topics", "images of 921 600 bytes at 30 Hz, 150 of 150", With::Rclpy, Way::Out);
    stream(free_domain(), 921_600, 150, Duration::from_secs(1) / 30);
}

#[test]
fn clouds_of_8_mb_at_2_hz_reach_rclpy_all_10() {
    let _check = check("Topics", "8 MB at 2 Hz, 10 of 10", With::Rclpy, Way::Out);
    stream(free_domain(), 8_000_000, 10, Duration::from_millis(500));
}

/// The configuration of the peer of Cyclone DDS: loopback without multicast.
const CYCLONE_ON_LOOPBACK: &str = r#"<CycloneDDS><Domain id="any">
<General><Interfaces><NetworkInterface name="lo" multicast="false"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
<Discovery><ParticipantIndex>auto</ParticipantIndex><Peers><Peer address="127.0.0.1"/></Peers></Discovery>
</Domain></CycloneDDS>"#;

/// `ddsperf` publishes 100 samples a second and counts what it hears, for some seconds.
fn ddsperf(domain_id: u16, more: &[&str], topic: &str, qos: QosProfile) {
    let mut command = Command::new("ddsperf");
    command.args(["-i", &domain_id.to_string(), "-T", "OU", "-k", "all", "-D", "4", "-Q", "samples:200"]);
    command.args(more).args(["pub", "100Hz", "sub"]).env("CYCLONEDDS_URI", CYCLONE_ON_LOOPBACK);
    let spawned = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    let Ok(mut ddsperf) = spawned else {
        test_machine::missing("ddsperf", "Debian: the package cyclonedds-tools");
        return;
    };
    let participant = RtpsParticipant::new(&on_loopback(domain_id)).unwrap();
    let endpoint = Endpoint::new(topic, "OneULong", qos);
    let writer = participant.create_writer(&endpoint).unwrap();
    let (reader, samples) = subscribe(&participant, &endpoint);
    // Both are matched with each other, too.
    wait_until("ddsperf is matched", || writer.matched() == 2 && reader.matched() == 2);
    // All the time: ddsperf may find the writer later than the writer finds it, and until then best-effort
    // samples are lost.
    for number in 0_u32.. {
        writer.write(cdr(number.to_le_bytes())).unwrap();
        std::thread::sleep(Duration::from_millis(5));
        if ddsperf.try_wait().unwrap().is_some() {
            break;
        }
    }
    let number_of = |cdr: Bytes| u32::from_le_bytes(cdr[4..8].try_into().unwrap());
    let heard = std::iter::repeat_with(|| samples.recv_timeout(WATCHDOG).unwrap());
    let theirs = heard.filter(|sample| sample.writer != writer.gid());
    let numbers: Vec<u32> = theirs.take(100).map(|sample| number_of(sample.cdr)).collect();
    if qos.reliability == Reliability::Reliable {
        assert!(numbers.windows(2).all(|pair| pair[1] == pair[0] + 1), "{numbers:?}");
    }
    // It succeeds if it has received as many as expected, without a gap.
    let output = ddsperf.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
fn samples_pass_between_us_and_cyclone_of_debian() {
    let domain = free_domain();
    ddsperf(domain, &[], "DDSPerfRDataOU", RELIABLE);
    ddsperf(domain, &["-u"], "DDSPerfUDataOU", BEST_EFFORT.keep_last(DEPTH));
}

/// Payloads as they are, behind the encapsulation.
struct Body;

impl rustdds::no_key::SerializerAdapter<Vec<u8>> for Body {
    type Error = std::convert::Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Vec<u8>) -> Result<Bytes, Self::Error> {
        Ok(value.clone().into())
    }
}

impl rustdds::no_key::DeserializerAdapter<Vec<u8>> for Body {
    type Error = std::convert::Infallible;
    type Decoded = Vec<u8>;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Self::Decoded) -> Vec<u8> {
        decoded
    }
}

impl rustdds::no_key::DefaultDecoder<Vec<u8>> for Body {
    type Decoder = BodyDecoder;
    const DECODER: Self::Decoder = BodyDecoder;
}

#[derive(Clone)]
struct BodyDecoder;

impl rustdds::no_key::Decode<'_, Vec<u8>> for BodyDecoder {
    type Error = std::convert::Infallible;

    fn decode_bytes(self, bytes: &[u8], _: RepresentationIdentifier) -> Result<Vec<u8>, Self::Error> {
        Ok(bytes.to_vec())
    }
}

#[test]
fn samples_of_every_size_pass_between_us_and_rustdds() {
    let domain = free_domain();
    let peer = DomainParticipantBuilder::new(domain)
        .with_only_networks([std::net::Ipv4Addr::LOCALHOST])
        .build()
        .unwrap();
    let qos = QosPolicyBuilder::new()
        .reliable(rustdds::Duration::from_millis(100))
        .history(rustdds::policy::History::KeepLast { depth: DEPTH as i32 })
        .build();
    let topic = |name: &str| {
        let kind = "std_msgs::msg::dds_::String_".to_owned();
        peer.create_topic(name.to_owned(), kind, &qos, TopicKind::NoKey).unwrap()
    };
    let publisher = peer.create_publisher(&qos).unwrap();
    let writer = publisher.create_datawriter_no_key::<Vec<u8>, Body>(&topic("rt/theirs"), None).unwrap();
    let subscriber = peer.create_subscriber(&qos).unwrap();
    let mut reader = subscriber.create_datareader_no_key::<Vec<u8>, Body>(&topic("rt/ours"), None).unwrap();

    let talker = Talker::join(&on_loopback(domain), RELIABLE);
    let mut is_matched = [false; 2];
    wait_until("all are matched", || {
        // An event is reported once.
        is_matched[0] |= writer.try_recv_status().is_some();
        is_matched[1] |= reader.try_recv_status().is_some();
        is_matched == [true; 2]
            && talker.ours.matched_subscriptions() == 1
            && talker.theirs.matched_publishers() == 1
    });
    for (size, count) in SIZES {
        (0..count).for_each(|number| talker.say(number, size));
        let mut texts = Vec::new();
        wait_until(&format!("rustdds hears {count} texts of {size} bytes"), || {
            while let Some(sample) = reader.take_next_sample().unwrap() {
                texts.push(sample.into_value());
            }
            texts.len() == count
        });
        let body = |number| text_of(number, size).slice(4..);
        assert!(texts.iter().enumerate().all(|(number, text)| text[..body(number).len()] == body(number)));

        (0..count).for_each(|number| writer.write(body(number).to_vec(), None).unwrap());
        let heard: Vec<_> = (0..count).map(|_| talker.heard()).collect();
        assert_whole(&heard, size, count);
    }
}

#[test]
fn a_stream_to_two_subscriptions_of_which_one_is_of_our_own_participant() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let talker = Talker::join(&on_loopback(domain), RELIABLE);
    let (own, heard) = hear(&talker.node, "/ours", RELIABLE);
    let other = Participant::join(&on_loopback(domain)).unwrap();
    let other = other.create_node(NodeName::new("/", "other").unwrap()).unwrap();
    let (others, heard_by_other) = hear(&other, "/ours", RELIABLE);
    peer.ask(json!({"do": "subscribe_texts", "topic": "/ours", "qos": {"depth": DEPTH}}));
    wait_until("all are matched", || {
        talker.ours.matched_subscriptions() == 3
            && own.matched_publishers() == 1
            && others.matched_publishers() == 1
            && common::texts::is_matched(&mut peer, "/ours")
    });
    for number in 0..30 {
        talker.ours.publish(text_of(number, 200_000)).unwrap();
    }
    assert_whole(&taken(&mut peer, "/ours", 30), 200_000, 30);
    for heard in [heard, heard_by_other] {
        let texts: Vec<_> = (0..30).map(|_| heard.recv_timeout(WATCHDOG).unwrap().unwrap()).collect();
        assert_whole(&texts, 200_000, 30);
    }
}
