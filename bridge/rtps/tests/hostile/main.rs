//! What hostile, broken and random datagrams can do to us: nothing.

#![allow(clippy::unwrap_used)]

mod attacks;
#[path = "../golden/capture.rs"]
mod capture;
#[path = "../common/mod.rs"]
mod common;
mod conversations;
mod mutation;
mod reading;
mod robot;
#[path = "../../fuzz/targets/mod.rs"]
mod targets;
