//! The versions of modules in other languages: what their files held when they were made.
//!
//! A bag holds those with which it begins in its custom data, and each later one in an event of the cycle in
//! which it joined. Files of text are in them; others, such as shared libraries, are copied into the bag's
//! folder where their module is reloaded, and found by their hash. The custom data also lists the later ones,
//! whose files are all copied: a recording may be paused while a module is reloaded, and a part of a bag may
//! begin after it.

mod in_bag;
mod joined;
mod joining;
mod live;
mod log;
mod of_module;
mod recorded;
mod sources;
mod state;
mod version;

pub use in_bag::LastVersion;
pub(crate) use in_bag::{VersionsInBag, reloads_of};
pub(crate) use joined::ReplayedTime;
pub(crate) use live::Live;
pub(crate) use log::VersionLog;
pub(crate) use of_module::VersionsOfModule;
pub(crate) use sources::{SourcedModules, Sources};
pub use version::FOLDER;
