//! The fuzz targets, which the fuzzer and the tests run.

#![allow(dead_code)] // a program of the fuzzer runs one of them

pub mod participant;
pub mod wire;
