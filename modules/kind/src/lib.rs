//! Kinds of modules: how a package offers its modules to robot files.
//!
//! A package of modules exports a function `kinds`, and a robot file can name each of them.

mod kind;
mod source;

pub use kind::{Kind, Panel, ReplayedDevice};
pub use source::{LoadForeign, ModuleSource};
