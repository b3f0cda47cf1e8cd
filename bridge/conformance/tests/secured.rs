//! The engine of this project with DDS Security against the suite.

#[macro_use]
mod common;

/// Written by sros2.
const KEYSTORE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../security/tests/data/keystores/all_domains");

each_case!(downbeat_conformance::engines::secured(
    KEYSTORE.into(),
    "/talker",
    Some(env!("CARGO_BIN_EXE_secured_peer").into())
));
