//! Ready-made robot modules.
//!
//! - [`servo_bus`]: the hardware of any robot of serial servos, which a file describes;
//! - [`servo_emulator`]: emulated ones behind a pseudo terminal, or in memory;
//! - [`controllers`]: as users of ros2_control know them;
//! - [`darwin_op`]: the hardware of the humanoid Darwin OP;
//! - [`darwin_op_emulator`]: an emulated one behind a pseudo terminal;
//! - [`device`]: for use in modules: devices whose answers are recorded and replayed;
//! - [`counted`]: for use in modules: faults that are logged less and less often;
//! - [`serial_port`]: for use in modules: why a serial port cannot be opened;
//! - [`imu_filter`]: orientation from gyroscope and accelerometer;
//! - [`gait`]: walks with the velocity on `cmd_vel`;
//! - [`motions`]: plays key-frame motions;
//! - [`falls`]: detects falls and gets up;
//! - [`joint_command_mux`]: decides which commands joints get;
//! - [`joint_state_merger`]: joint states of several buses as one;
//! - [`kinematics`]: answers where links are and how joints bring them elsewhere; re-exports the library for it;
//! - [`robot_state_publisher`]: transforms of all links;
//! - [`stand_nod_wave`]: a small motion;
//! - [`transform_server`]: an action that answers transform lookups.
//!
//! Building blocks for modules are separate packages without the serial port: [`actions`], [`kinematics`] and
//! [`transforms`].
//!
//! The page of each module lists its topics and settings; `README.md` has an overview.

pub mod controllers;
pub mod counted;
pub mod darwin_op;
pub mod darwin_op_emulator;
pub mod device;
pub mod falls;
pub mod gait;
pub mod imu_filter;
pub mod joint_command_mux;
pub mod joint_state_merger;
pub mod kinematics;
pub mod motions;
mod robot_description;
pub mod robot_state_publisher;
pub mod serial_port;
pub mod servo_bus;
pub mod servo_emulator;
pub mod stamps;
pub mod stand_nod_wave;
pub mod transform_server;

pub use downbeat_actions as actions;
pub use downbeat_transforms as transforms;

mod attitude;
mod leg_joints;
mod present_pose;
mod step;

#[cfg(test)]
mod testing;
