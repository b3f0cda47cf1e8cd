//! Bag files of rosbag2's storage `sqlite3`.
//!
//! # References
//! `rosbag2_storage_sqlite3/src/rosbag2_storage_sqlite3/sqlite_storage.cpp`, `sqlite_wrapper.cpp` and
//! `include/rosbag2_storage_sqlite3/sqlite_pragmas.hpp`, branch jazzy.

mod config;
mod file;
mod options;
mod tables;
mod transaction;

pub(super) use file::SqliteFile;
pub use options::{SqliteOptions, SqlitePreset};
