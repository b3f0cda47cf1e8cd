//! Robot descriptions, and what follows from them: forward and inverse kinematics, centre of mass, Jacobians.
//!
//! Lengths are in m, angles in rad, masses in kg; frames follow REP-103 (x forward, y left, z up) and REP-120
//! (names). The modules are [`Kinematics`],
//! [`RobotStatePublisher`](robot_state_publisher::RobotStatePublisher) and
//! [`JointStateMerger`](joint_state_merger::JointStateMerger).
//!
//! Transforms are named `target_from_source`, so that a chain reads `base_from_foot * foot_from_sole`.

pub mod darwin_op;
pub mod description;
pub mod joint_state_merger;
pub mod leg;
pub mod module;
pub mod robot_state_publisher;

mod inverse;
mod kinds;
mod look_at;
mod mjcf;
mod pose;
mod robot_description;

pub use description::{DescriptionError, Problem, Robot};
pub use downbeat_transforms::wrapped;
pub use inverse::{Found, InverseKinematics, Search};
pub use kinds::kinds;
pub use look_at::{Look, LookAt};
pub use mjcf::{Root, to_mjcf};
pub use module::Kinematics;
pub use nalgebra;
pub use pose::{Masses, Pose};

#[cfg(test)]
#[path = "../../servos/src/testing.rs"]
mod testing;
