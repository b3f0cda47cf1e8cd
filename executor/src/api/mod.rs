//! The user's interface of the core and its handle.

mod core;
mod handle;
mod look;
