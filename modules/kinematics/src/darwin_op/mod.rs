//! Closed forms for the Darwin OP: inverse kinematics of the legs, and where the head looks.
//!
//! Angles are those of the servos, as in `joint_states`: 0 at tick 2048, legs straight. Lengths and limits
//! agree with `robots/darwin_op.urdf`.

mod head;
mod leg;
mod nearest;

pub use head::{Head, HeadSolution};
pub use leg::{Leg, LegSolution, Reach, Side};
pub use nearest::NearestLeg;
