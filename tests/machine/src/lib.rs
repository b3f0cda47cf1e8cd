//! What tests take from the machine they run on: tools that may be missing, ROS domains that no other test
//! uses, and small disks.
#![allow(clippy::missing_panics_doc)]

mod disk;
mod domains;
mod skips;
mod tools;

pub use disk::SmallDisk;
pub use domains::{Domains, free_domain, free_domains};
pub use skips::{LIST, Skips, is_strict, list_file, missing, skipped};
pub use tools::{has_compilers, has_program, interpreter, node_modules};
