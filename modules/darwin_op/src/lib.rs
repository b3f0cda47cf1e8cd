//! The humanoid Darwin OP.
//!
//! - [`hardware`]: its bus, its board and its servos, on those of [`downbeat_servos`];
//! - [`emulator`]: an emulated one behind a pseudo terminal, or in memory;
//! - [`gait`]: walks with the velocity on `cmd_vel`;
//! - [`motions`]: plays key-frame motions;
//! - [`falls`]: detects falls and gets up;
//! - [`stand_nod_wave`]: a small motion.

pub mod emulator;
pub mod falls;
pub mod gait;
pub mod hardware;
pub mod motions;
pub mod stand_nod_wave;

mod attitude;
mod leg_joints;
mod present_pose;

#[cfg(test)]
#[path = "../../servos/src/testing.rs"]
mod testing;
