//! A small motion of the Darwin OP: it stands up from any position, then nods and waves repeatedly.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joint_states` (in) | `sensor_msgs/JointState` | the start of the motion: only the first message is used |
//! | `motion/joint_commands` | `sensor_msgs/JointState` | positions of all 20 joints, rad, at 125 Hz |
//!
//! The setting `stand_s` is the duration of standing up in s.
//!
//! Never tested on a real robot: nothing checks for collisions of the arm with the body, or for balance.

mod module;
mod motion;

pub use module::StandNodWave;
