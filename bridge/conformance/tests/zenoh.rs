//! Zenoh against the suite.

#[macro_use]
mod common;

each_case!(downbeat_conformance::engines::zenoh(Some(env!("CARGO_BIN_EXE_zenoh_peer").into())));
