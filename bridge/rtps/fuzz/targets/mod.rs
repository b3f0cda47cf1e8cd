//! What the fuzzer and the tests run.

pub mod wire;
