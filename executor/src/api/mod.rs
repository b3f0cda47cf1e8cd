//! The core and its handle as users meet them.

mod core;
mod handle;
mod look;
