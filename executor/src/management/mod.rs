//! Modules joining, leaving and changing while the core runs.

mod admission;
mod command;
mod member;
mod modules;

pub(crate) use admission::{Candidate, Source, admit};
pub(crate) use command::{Command, Look};
pub use command::{SettingRefused, UnknownModule};
pub use member::ModuleId;
pub(crate) use member::{Member, Members, Place};
pub(crate) use modules::{Modules, find, finish_leaving};
