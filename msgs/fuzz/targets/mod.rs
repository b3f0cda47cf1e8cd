//! What has to hold for any bytes whatever: no panic, no memory without bound, and agreement between the ways to read them.
//! Run by libFuzzer (`README.md`), and over the corpus and random changes of it in every test run (`../tests/fuzzing.rs`).

#![allow(dead_code)] // Each fuzzer is a program of its own and uses one of them.

pub mod cdr;
pub mod dynamic;
pub mod idl_files;
pub mod interface_files;
