//! Keystores that our own code writes.

use crate::check;
use crate::ours::{Ours, publish};
use crate::peer::{Peer, Vendor};
use downbeat_msgs::qos::QosProfile;
use downbeat_security::keystore::Keystore;
use std::time::SystemTime;
use tempfile::TempDir;
use test_machine::free_domain;

fn random(bytes: &mut [u8]) {
    getrandom::fill(bytes).unwrap();
}

/// A new keystore with enclaves `/arm`, `/camera` and `/head/left`.
fn keystore(domain_id: u16) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let (domain_id, now) = (domain_id.into(), SystemTime::now());
    let keystore = Keystore::create(folder.path(), domain_id, now, &mut random).unwrap();
    for enclave in ["/arm", "/camera", "/head/left"] {
        keystore.create_enclave(enclave, domain_id, now, &mut random).unwrap();
    }
    folder
}

fn peers_use_it(vendor: Vendor) {
    let Some(_check) = check(vendor, "a keystore of `downbeat security`") else { return };
    let domain = free_domain();
    let folder = keystore(domain);
    // The order of the GUIDs is that of the names' hashes: each is ours once.
    for (ours, theirs) in [("/arm", "/camera"), ("/camera", "/arm"), ("/head/left", "/arm")] {
        let commands = ["publish /theirs hello", "subscribe /ours"];
        let Some(mut peer) = Peer::start(vendor, domain, folder.path(), theirs, &commands) else { return };
        let ours = Ours::join(domain, folder.path(), ours);
        let publisher = ours.publisher("/ours", QosProfile::DEFAULT);
        publish(&publisher, ["of our keystore"]);
        peer.wait_for("heard /ours of our keystore");
        assert!(ours.texts("/theirs", QosProfile::DEFAULT).next().starts_with("hello "));
        peer.leave();
    }
}

#[test]
fn cyclone_dds_uses_our_keystore() {
    peers_use_it(Vendor::Cyclone);
}

#[test]
fn fast_dds_uses_our_keystore() {
    peers_use_it(Vendor::Fast);
}

fn other_keystores_are_refused(vendor: Vendor) {
    let Some(_check) = check(vendor, "participants with another keystore are refused") else { return };
    let mut refusals = Vec::new();
    for (ours, theirs) in [("/arm", "/camera"), ("/camera", "/arm")] {
        let domain = free_domain();
        let [folder, other] = [keystore(domain), keystore(domain)];
        let commands = ["publish /theirs forged", "subscribe /ours"];
        let mut stranger = Peer::start(vendor, domain, other.path(), theirs, &commands).unwrap();
        let commands = ["publish /theirs hello", "subscribe /ours"];
        let mut peer = Peer::start(vendor, domain, folder.path(), theirs, &commands).unwrap();
        let ours = Ours::join(domain, folder.path(), ours);
        let texts = ours.texts("/theirs", QosProfile::DEFAULT);
        let publisher = ours.publisher("/ours", QosProfile::DEFAULT);
        publish(&publisher, ["secret"]);
        peer.wait_for("heard /ours secret");
        for _ in 0..20 {
            assert!(texts.next().starts_with("hello "));
        }
        assert_eq!(ours.security().authenticated, 1);
        assert_eq!(stranger.printed(), ["ready"]);
        refusals.extend(ours.security().refusals);
    }
    // The participant that sends the reply sees the certificate of the other one first, and does not answer.
    assert!(refusals.iter().any(|text| text.contains("authority")), "{refusals:?}");
}

#[test]
fn other_keystores_of_cyclone_dds_are_refused() {
    other_keystores_are_refused(Vendor::Cyclone);
}

#[test]
fn other_keystores_of_fast_dds_are_refused() {
    other_keystores_are_refused(Vendor::Fast);
}
