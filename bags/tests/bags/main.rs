//! What this crate promises, tried on bags of the real recorder and on bags of its own.

#![allow(clippy::unwrap_used)]

mod beside;
mod control;
mod damage;
mod disk;
mod dynamic;
mod edit;
mod fixtures;
mod fuzz;
mod interrupted;
mod killed;
mod layout;
mod order;
mod others;
mod python;
mod splits;
#[cfg(feature = "sqlite")]
mod sqlite;
mod storage;
mod support;
