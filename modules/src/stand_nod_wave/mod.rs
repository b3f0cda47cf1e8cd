//! A small motion of the Darwin OP: it stands up from wherever it is, then nods and waves, again and again.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joint_states` (in) | `sensor_msgs/JointState` | where the motion begins: the first message counts |
//! | `motion/joint_commands` | `sensor_msgs/JointState` | positions of all 20 joints, rad, at 125 Hz |
//!
//! The setting `stand_s` is the time in s that standing up takes.
//!
//! Never tried on a real robot: nothing checks whether the arm keeps clear of the body, or the robot its balance.

mod module;
mod motion;

pub use module::StandNodWave;
