//! The engine in memory against the suite.

#[macro_use]
mod common;

each_case!(downbeat_conformance::engines::in_process());
