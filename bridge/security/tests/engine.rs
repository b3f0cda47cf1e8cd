//! The tests of the engine, with a guard for each participant: what holds in clear holds protected.
//!
//! The exceptions are in `bridge/rtps/tests/unguarded.rs`, and the tests of hostile datagrams, which are in
//! clear: a guard drops them all, see `hostile.rs`.

#![allow(clippy::duplicate_mod)] // each of the included programs has the module for its network

mod keystore;
#[path = "../../rtps/tests/participants.rs"]
mod participants;
#[path = "../../rtps/tests/simulation.rs"]
mod simulation;

use downbeat_rtps::protocol::{Config, Guard};
use downbeat_rtps::wire::GuidPrefix;

/// Of the simulation: a handshake of each pair takes long without optimisation.
const SEEDS: u64 = 12;

/// Neighbours have different enclaves, others may have the same.
fn guard(config: &Config) -> Option<(GuidPrefix, Box<dyn Guard>)> {
    let enclaves = ["/robot", "/talker", "/listener"];
    Some(keystore::guard_of(enclaves[config.secret as usize % enclaves.len()], config))
}
