//! Participants that are wrong in one way each, and changed messages: none is let in, and each is reported in
//! words.

#![allow(clippy::unwrap_used)]

#[path = "../../../rtps/tests/common/mod.rs"]
mod common;
mod flood;
mod identity;
#[path = "../keystore/mod.rs"]
mod keystore;
mod liar;
#[path = "../mutation/mod.rs"]
mod mutation;
mod noise;
mod permissions;
mod protection;
mod replay;
mod strangers;
mod world;

use downbeat_rtps::protocol::{Config, Guard};
use downbeat_rtps::wire::GuidPrefix;

/// The guard that [`world::World`] gives to the participant that it makes.
fn guard(config: &Config) -> Option<(GuidPrefix, Box<dyn Guard>)> {
    world::guard(config)
}
