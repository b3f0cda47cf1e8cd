//! The fuzz targets, which the fuzzer and the tests run. Each parses bytes as a peer or a file could have
//! them, and returns whether they are well-formed. Parsing may fail but must not panic, and nothing that was
//! changed passes for proven.

#![allow(dead_code)] // a program of the fuzzer runs one of them

pub mod documents;
pub mod handshake;
pub mod messages;
pub mod pki;
pub mod protection;

/// A parser, and the inputs from which changes begin.
pub struct Target {
    pub name: &'static str,
    pub run: fn(&[u8]) -> bool,
    pub seeds: fn() -> Vec<Vec<u8>>,
}

/// All targets.
pub const ALL: [Target; 16] = [
    Target { name: "certificate", run: pki::certificate, seeds: pki::certificates },
    Target { name: "key", run: pki::key, seeds: pki::keys },
    Target { name: "revocations", run: pki::revocations, seeds: pki::crls },
    Target { name: "pem", run: pki::pem, seeds: pki::pems },
    Target { name: "smime", run: documents::smime, seeds: documents::signed },
    Target { name: "signature", run: documents::signature, seeds: documents::signatures },
    Target { name: "governance", run: documents::governance, seeds: documents::governances },
    Target { name: "permissions", run: documents::permissions, seeds: documents::all_permissions },
    Target { name: "policy", run: documents::policy, seeds: documents::policies },
    Target { name: "token", run: messages::token, seeds: messages::tokens },
    Target { name: "message", run: messages::message, seeds: messages::recorded },
    Target { name: "key_material", run: messages::key_material, seeds: messages::key_materials },
    Target { name: "payload", run: protection::payload, seeds: protection::payloads },
    Target { name: "submessage", run: protection::submessage, seeds: protection::submessages },
    Target { name: "datagram", run: protection::datagram, seeds: protection::datagrams },
    Target { name: "handshake", run: handshake::run, seeds: handshake::messages },
];
