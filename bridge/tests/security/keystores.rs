//! Keystores that our own code writes.

use crate::check;
use crate::ours::{Ours, publish};
use crate::peer::{Peer, Vendor};
use downbeat_msgs::qos::QosProfile;
use downbeat_security::keystore::Keystore;
use std::time::SystemTime;
use test_machine::free_domain;

fn random(bytes: &mut [u8]) {
    getrandom::fill(bytes).unwrap();
}

fn peers_use_it(vendor: Vendor) {
    let Some(_check) = check(vendor, "a keystore of `downbeat security`") else { return };
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let now = SystemTime::now();
    let keystore = Keystore::create(folder.path(), domain.into(), now, &mut random).unwrap();
    for enclave in ["/arm", "/camera", "/head/left"] {
        keystore.create_enclave(enclave, domain.into(), now, &mut random).unwrap();
    }
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
