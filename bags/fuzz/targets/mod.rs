//! The code that the fuzzer and the tests run.

pub mod reader;
