//! Peers that crash, leave and come back.

use crate::common::wait_until;
use crate::ours::{Ours, publish};
use crate::peer::{Peer, Vendor};
use crate::{PAIRS, check, keystore, pairs};
use downbeat_msgs::qos::QosProfile;

const COMMANDS: [&str; 2] = ["publish /theirs hello", "subscribe /ours"];

fn peers_come_back(vendor: Vendor) {
    let Some(_check) = check(vendor, "a peer that is killed or leaves comes back") else { return };
    for ((ours, mut peer), (_, theirs)) in pairs(vendor, &COMMANDS).zip(PAIRS) {
        let domain = ours.domain_id;
        let texts = ours.texts("/theirs", QosProfile::DEFAULT);
        let publisher = ours.publisher("/ours", QosProfile::DEFAULT);
        publish(&publisher, ["one"]);
        peer.wait_for("heard /ours one");
        texts.next();
        peer.kill();
        texts.received();
        // A new process, whose old identity we may still believe to be there.
        let mut peer = Peer::start(vendor, domain, keystore(), theirs, &COMMANDS).unwrap();
        assert!(texts.next().starts_with("hello "));
        wait_until("the new process has heard us", || {
            publish(&publisher, ["two"]);
            std::thread::sleep(std::time::Duration::from_millis(50));
            peer.printed().iter().any(|line| line == "heard /ours two")
        });
        peer.leave();
        texts.received();
        let mut peer = Peer::start(vendor, domain, keystore(), theirs, &COMMANDS).unwrap();
        wait_until("the third process has heard us", || {
            publish(&publisher, ["three"]);
            std::thread::sleep(std::time::Duration::from_millis(50));
            peer.printed().iter().any(|line| line == "heard /ours three")
        });
        assert!(texts.next().starts_with("hello "));
    }
}

#[test]
fn cyclone_dds_comes_back() {
    peers_come_back(Vendor::Cyclone);
}

#[test]
fn fast_dds_comes_back() {
    peers_come_back(Vendor::Fast);
}

fn we_come_back(vendor: Vendor) {
    let Some(_check) = check(vendor, "downbeat leaves and comes back") else { return };
    for ((ours, mut peer), (enclave, _)) in pairs(vendor, &COMMANDS).zip(PAIRS) {
        let domain = ours.domain_id;
        let publisher = ours.publisher("/ours", QosProfile::DEFAULT);
        publish(&publisher, ["one"]);
        peer.wait_for("heard /ours one");
        drop((publisher, ours));
        let ours = Ours::join(domain, keystore(), enclave);
        let publisher = ours.publisher("/ours", QosProfile::DEFAULT);
        publish(&publisher, ["two"]);
        peer.wait_for("heard /ours two");
        assert!(ours.texts("/theirs", QosProfile::DEFAULT).next().starts_with("hello "));
    }
}

#[test]
fn we_come_back_to_cyclone_dds() {
    we_come_back(Vendor::Cyclone);
}

#[test]
fn we_come_back_to_fast_dds() {
    we_come_back(Vendor::Fast);
}
