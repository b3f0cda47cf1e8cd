//! Properties that must hold for arbitrary bytes: no panic, bounded memory, and agreement between the ways to
//! read them. Run by libFuzzer (`README.md`), and over the corpus and random mutations of it in every test
//! run (`../tests/fuzzing.rs`).

#![allow(dead_code)] // Each fuzzer is a separate program and uses one of them.

pub mod cdr;
pub mod dynamic;
pub mod idl_files;
pub mod interface_files;
