//! What hostile, broken and random datagrams can do to us: nothing.

#![allow(clippy::unwrap_used)]

#[path = "../golden/capture.rs"]
mod capture;
mod memory;
mod mutation;
mod random;
mod reading;
#[path = "../../fuzz/targets/mod.rs"]
mod targets;
