//! The module `px4`, with the emulated autopilot of this package and with scripted messages.

#![allow(clippy::unwrap_used)]

mod emulated;
mod scripted;
