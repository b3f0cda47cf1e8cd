//! The humanoid Darwin OP, and the modules that make it and other humanoids move.
//!
//! - [`hardware`]: its bus, its board and its servos, on those of [`downbeat_servos`];
//! - [`emulator`]: an emulated one behind a pseudo terminal, or in memory;
//! - [`mod@humanoid`]: what distinguishes another humanoid from the Darwin OP;
//! - [`gait`]: walks with the velocity on `cmd_vel`;
//! - [`motions`]: plays key-frame motions;
//! - [`falls`]: detects falls and gets up;
//! - [`stand_nod_wave`]: a small motion.

pub mod emulator;
pub mod falls;
pub mod gait;
pub mod hardware;
pub mod humanoid;
pub mod joints;
pub mod motions;
pub mod stand_nod_wave;

mod attitude;
mod kinds;
mod present_pose;

pub use kinds::kinds;

#[cfg(test)]
#[path = "../../servos/src/testing.rs"]
mod testing;
