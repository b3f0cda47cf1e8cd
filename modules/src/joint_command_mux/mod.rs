//! Merges what is commanded to the joints from outside with what the robot's own motion commands.
//!
//! Outside wins for the joints it names, until some time after its last word about them, as `twist_mux` does it.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joint_commands` (in) | `sensor_msgs/JointState` | from outside |
//! | `motion/joint_commands` (in) | `sensor_msgs/JointState` | from the robot's own motion |
//! | `joint_goals` | `sensor_msgs/JointState` | what holds, in the order in which it came |
//!
//! The setting `hold_s` is the time in s, 2 at first.

mod merge;
mod module;

pub use module::JointCommandMux;
