//! Receivers that speak NMEA 0183.
//!
//! - [`sentence`]: sentences in a stream of bytes, and what they say;
//! - [`solution`]: positions, velocities and times from sentences, as nmea_navsat_driver gives them;
//! - [`Gps`] is the module, [`GpsEmulator`] emulates a receiver.

mod emulator;
mod module;
pub mod sentence;
pub mod solution;

pub use emulator::{GpsEmulator, emulated};
pub use module::{Gps, GpsPort};
