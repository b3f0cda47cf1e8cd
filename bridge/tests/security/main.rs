//! Participants with DDS Security, with secured participants of Cyclone DDS and Fast DDS, and with strangers.
#![allow(clippy::unwrap_used)]

#[path = "../common/mod.rs"]
mod common;
mod keystores;
mod ours;
mod parameters;
mod peer;
mod restarts;
mod services;
mod strangers;
mod topics;

use common::matrix::{self, Check, Way, With};
use ours::Ours;
use peer::{Peer, Vendor};
use std::path::Path;
use test_machine::free_domain;

/// The enclaves of a pair: ours, the peer's. The participant with the smaller GUID, whose order is that of
/// `/talker`, `/robot`, `/listener`, sends the request of the handshake, so that we send it in the first pair
/// and the reply in the second one.
const PAIRS: [(&str, &str); 2] = [("/talker", "/listener"), ("/listener", "/robot")];

/// The sources of the peers.
const PEERS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/security/peers");

/// Written by sros2.
fn keystore() -> &'static Path {
    Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/security/tests/data/keystores/all_domains"))
}

/// A check of a feature with peers of a vendor, in both directions. Nothing where the machine lacks what the
/// peers need.
fn check(vendor: Vendor, feature: &str) -> Option<Check> {
    let with = match vendor {
        Vendor::Cyclone => With::SecuredCyclone,
        Vendor::Fast => With::SecuredFast,
        Vendor::Rustdds => return None, // not part of the test run
    };
    vendor.program()?;
    Some(matrix::check("Security", feature, with, Way::Both))
}

/// A participant of ours and a peer that executes the commands, for both orders of their GUIDs. Nothing where
/// the machine lacks what the peer needs.
fn pairs(vendor: Vendor, commands: &[&str]) -> impl Iterator<Item = (Ours, Peer)> {
    PAIRS.into_iter().filter_map(move |(ours, theirs)| {
        let domain = free_domain();
        let peer = Peer::start(vendor, domain, keystore(), theirs, commands)?;
        Some((Ours::join(domain, keystore(), ours), peer))
    })
}
