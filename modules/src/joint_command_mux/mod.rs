//! Merges joint commands from outside with those of the robot's own motion.
//!
//! Outside commands take precedence for the joints they name, until some time after the last one, as in
//! `twist_mux`.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joint_commands` (in) | `sensor_msgs/JointState` | from outside |
//! | `motion/joint_commands` (in) | `sensor_msgs/JointState` | from the robot's own motion |
//! | `joint_goals` | `sensor_msgs/JointState` | the merged commands, in order of arrival |
//!
//! The setting `hold_s` is this time in s, by default 2.

mod merge;
mod module;

pub use module::JointCommandMux;
