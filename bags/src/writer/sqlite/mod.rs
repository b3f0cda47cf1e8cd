//! Bag files of rosbag2's storage `sqlite3`.
//!
//! # References
//! `rosbag2_storage_sqlite3/src/rosbag2_storage_sqlite3/sqlite_storage.cpp`, `sqlite_wrapper.cpp` and
//! `include/rosbag2_storage_sqlite3/sqlite_pragmas.hpp`, branch jazzy.

mod file;
mod options;

pub(super) use file::SqliteFile;
pub use options::{SqliteOptions, SqlitePreset};
