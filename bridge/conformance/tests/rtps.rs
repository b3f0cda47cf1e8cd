//! The engine of this project against the suite.

#[macro_use]
mod common;

each_case!(downbeat_conformance::engines::rtps(Some(env!("CARGO_BIN_EXE_rtps_peer").into())));
