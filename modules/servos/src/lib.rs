//! Robots of serial servos, and what commands their joints.
//!
//! - [`servo_bus`]: the hardware of any robot of Dynamixel or Feetech servos, which a file describes;
//! - [`servo_emulator`]: emulated ones behind a pseudo terminal, or in memory;
//! - [`controllers`]: as users of ros2_control know them;
//! - [`teleoperation`]: an arm that follows another one, and episodes of it to learn from;
//! - [`joint_command_mux`]: decides which commands joints get;
//! - [`stamps`]: for use in modules: whether commands with stamps are current;
//! - [`step`]: for use in modules: steps of time that are no part of a motion.

pub mod controllers;
pub mod joint_command_mux;
mod kinds;
pub mod servo_bus;
pub mod servo_emulator;
pub mod stamps;
pub mod step;
pub mod teleoperation;

pub use kinds::kinds;

#[cfg(test)]
mod testing;
