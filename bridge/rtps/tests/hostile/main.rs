//! Hostile, malformed and random datagrams do no harm.

#![allow(clippy::unwrap_used)]

mod amplification;
mod attacks;
#[path = "../golden/capture.rs"]
mod capture;
#[path = "../common/mod.rs"]
mod common;
#[allow(unused_imports)] // by `common`
use common::no_guard as guard;
mod conversations;
mod forged;
mod mutation;
mod names;
mod reading;
mod robot;
#[path = "../../fuzz/targets/mod.rs"]
mod targets;
