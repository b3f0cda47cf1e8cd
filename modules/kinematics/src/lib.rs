//! Robot descriptions, and what follows from them: forward and inverse kinematics, centre of mass, Jacobians.
//!
//! Lengths are in m, angles in rad, masses in kg; frames follow REP-103 (x forward, y left, z up) and REP-120 (names).
//! Transforms are named `target_from_source`, so that a chain reads `base_from_foot * foot_from_sole`.

pub mod darwin_op;
pub mod description;
mod inverse;
mod look_at;
mod mjcf;
mod pose;

pub use description::{DescriptionError, Problem, Robot};
pub use inverse::{Found, InverseKinematics, Search};
pub use look_at::{Look, LookAt};
pub use mjcf::{Root, to_mjcf};
pub use nalgebra;
pub use pose::{Masses, Pose, wrapped};
