//! Tests the guarantees of this crate on bags of the real recorder and its own.

#![allow(clippy::unwrap_used)]

mod beside;
mod control;
mod damage;
mod disk;
mod dynamic;
mod edit;
mod fixtures;
mod interrupted;
mod kept;
mod killed;
mod layout;
#[allow(dead_code)] // Tests of nodes use the rest.
#[path = "../../../bridge/tests/common/matrix.rs"]
mod matrix;
mod node;
mod order;
mod others;
mod python;
mod recorded;
mod salvage;
mod splits;
#[cfg(feature = "sqlite")]
mod sqlite;
mod stock_readers;
mod storage;
mod support;
mod types;
#[cfg(target_os = "linux")]
mod under_load;

use downbeat_bags::Reader;
