//! Closed forms for the Darwin OP: its legs, and where its head looks.
//!
//! Angles are those of the servos, as in `joint_states`: 0 at tick 2048, legs straight. Lengths and limits
//! agree with `robots/darwin_op.urdf`.

mod head;
mod leg;

pub use head::{Head, HeadSolution};
pub use leg::{leg, leg_joint_names};
