//! rustdds against the suite.

#[macro_use]
mod common;

each_case!(downbeat_conformance::engines::rustdds(Some(env!("CARGO_BIN_EXE_rustdds_peer").into())));
