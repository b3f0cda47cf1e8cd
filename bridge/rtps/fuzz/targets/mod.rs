//! What the fuzzer and the tests run.

pub mod participant;
pub mod wire;
