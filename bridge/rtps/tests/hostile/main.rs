//! Hostile, malformed and random datagrams do no harm.

#![allow(clippy::unwrap_used)]

mod amplification;
mod attacks;
#[path = "../golden/capture.rs"]
mod capture;
#[path = "../common/mod.rs"]
mod common;
mod conversations;
mod forged;
mod mutation;
mod names;
mod reading;
mod robot;
#[path = "../../fuzz/targets/mod.rs"]
mod targets;
