//! What all readers of files that users write share, at the bottom of all packages.
//!
//! [`user_file`] reads a regular file up to a size, [`lines`] says on which line a byte stands, [`toml`]
//! reads TOML with errors that name file and line, [`duration`] reads times with units, [`FileKind`] says
//! what stands behind a path, and [`suggestion`] finds the name that was meant.

pub mod duration;
mod kind;
pub mod lines;
mod suggestion;
#[cfg(feature = "toml")]
pub mod toml;
pub mod user_file;

pub use kind::FileKind;
pub use suggestion::{nearest, suggestion};
