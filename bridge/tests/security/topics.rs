//! Samples of all sizes in both directions.

use crate::common::wait_until;
use crate::ours::{Ours, publish};
use crate::peer::{Peer, Vendor};
use crate::{PAIRS, check, keystore, pairs};
use downbeat_msgs::qos::QosProfile;
use test_machine::free_domain;

const COMMANDS: [&str; 2] = ["publish /theirs hello", "subscribe /ours"];

/// Texts whose lengths have all remainders by four.
fn talk(ours: &Ours, peer: &mut Peer) {
    let texts = ours.texts("/theirs", QosProfile::DEFAULT);
    let publisher = ours.publisher("/ours", QosProfile::DEFAULT);
    let sent: Vec<String> = (1..=8).map(|number| "hello".repeat(number)).collect();
    publish(&publisher, sent.iter().map(|text| &**text));
    for text in &sent {
        peer.wait_for(&format!("heard /ours {text}"));
    }
    let heard = peer.printed().iter().filter(|line| line.starts_with("heard")).count();
    assert_eq!(heard, sent.len(), "each text once");
    let first = texts.next();
    let first: u64 = first.strip_prefix("hello ").unwrap().trim_end().parse().unwrap();
    for number in first + 1..first + 12 {
        // rustdds pads its texts.
        assert_eq!(texts.next().trim_end(), format!("hello {number}"));
    }
    assert_eq!(ours.security().refusals, Vec::<String>::new());
    assert_eq!(ours.security().authenticated, 1);
}

const TEXTS: &str = "messages, whoever begins the handshake";

fn texts_flow(vendor: Vendor) {
    for (ours, mut peer) in pairs(vendor, &COMMANDS) {
        talk(&ours, &mut peer);
    }
    for (ours, theirs) in PAIRS {
        let domain = free_domain();
        let ours = Ours::join(domain, keystore(), ours);
        let Some(mut peer) = Peer::start(vendor, domain, keystore(), theirs, &COMMANDS) else { return };
        talk(&ours, &mut peer);
    }
}

#[test]
fn texts_flow_to_and_from_cyclone_dds() {
    let Some(_check) = check(Vendor::Cyclone, TEXTS) else { return };
    texts_flow(Vendor::Cyclone);
}

#[test]
fn texts_flow_to_and_from_fast_dds() {
    let Some(_check) = check(Vendor::Fast, TEXTS) else { return };
    texts_flow(Vendor::Fast);
}

/// `cargo xtask wire` runs it.
#[test]
#[ignore = "compiles rustdds with OpenSSL for a minute and a half of processor time"]
fn texts_flow_to_and_from_rustdds() {
    texts_flow(Vendor::Rustdds);
}

fn fragments_flow(vendor: Vendor) {
    let Some(_check) = check(vendor, "messages of 100 kB and 1 MB") else { return };
    for size in [100_000, 1_000_000] {
        let commands = [&*format!("fill /theirs {size}"), "subscribe /ours"];
        for (ours, mut peer) in pairs(vendor, &commands) {
            let texts = ours.texts("/theirs", QosProfile::DEFAULT);
            let publisher = ours.publisher("/ours", QosProfile::DEFAULT);
            let sent: Vec<_> = (0..3).map(|number| format!("{}{number}", "y".repeat(size))).collect();
            publish(&publisher, sent.iter().map(|text| &**text));
            for text in &sent {
                peer.wait_for(&format!("heard /ours {text}"));
            }
            for _ in 0..2 {
                let text = texts.next();
                let (fill, number) = text.split_once(' ').unwrap();
                assert!(fill.bytes().all(|byte| byte == b'x') && fill.len() == size);
                assert!(number.parse::<u32>().is_ok());
            }
            assert_eq!(ours.security().refusals, Vec::<String>::new());
        }
    }
}

#[test]
fn samples_in_fragments_flow_to_and_from_cyclone_dds() {
    fragments_flow(Vendor::Cyclone);
}

#[test]
fn samples_in_fragments_flow_to_and_from_fast_dds() {
    fragments_flow(Vendor::Fast);
}

fn late_joiners_hear(vendor: Vendor) {
    let Some(_check) = check(vendor, "latched messages to late joiners") else { return };
    for (ours, theirs) in PAIRS {
        let domain = free_domain();
        let ours = Ours::join(domain, keystore(), ours);
        let publisher = ours.publisher("/ours", QosProfile::LATCHED);
        let mut first = match Peer::start(vendor, domain, keystore(), theirs, &["recall /ours"]) {
            Some(peer) => peer,
            None => return,
        };
        publish(&publisher, ["kept"]);
        first.wait_for("heard /ours kept");
        first.leave();
        wait_until("the peer has left", || ours.security().authenticated == 0);
        let commands = ["recall /ours", "keep /theirs latched"];
        let mut second = Peer::start(vendor, domain, keystore(), theirs, &commands).unwrap();
        second.wait_for("heard /ours kept");
        let texts = ours.texts("/theirs", QosProfile::LATCHED);
        assert_eq!(texts.next(), "latched");
    }
}

#[test]
fn late_joiners_of_cyclone_dds_hear_what_was_said_before() {
    late_joiners_hear(Vendor::Cyclone);
}

#[test]
fn late_joiners_of_fast_dds_hear_what_was_said_before() {
    late_joiners_hear(Vendor::Fast);
}

#[test]
fn two_nodes_of_ours_talk() {
    for (first, second) in PAIRS {
        let domain = free_domain();
        let (first, second) = (Ours::join(domain, keystore(), first), Ours::join(domain, keystore(), second));
        let texts = second.texts("/chatter", QosProfile::DEFAULT);
        let publisher = first.publisher("/chatter", QosProfile::DEFAULT);
        let large = "x".repeat(1_000_000);
        publish(&publisher, ["hello", &large, "again"]);
        assert_eq!([texts.next(), texts.next(), texts.next()], ["hello", &large, "again"]);
        first.wait_for_authenticated(1);
        wait_until("the node is seen", || !first.participant.remote_nodes().is_empty());
    }
}
