//! Where the joints of the legs are in the order of the ids.

use downbeat_kinematics::darwin_op::Side;

/// Joints of a leg, from the hip down; the first is that about the vertical.
pub(crate) const HIP_ROLL: usize = 1;
pub(crate) const HIP_PITCH: usize = 2;
pub(crate) const KNEE: usize = 3;
pub(crate) const ANKLE_PITCH: usize = 4;
pub(crate) const ANKLE_ROLL: usize = 5;

/// The place of a joint of a leg in the order of the ids: six joints of the arms, then pairs, first the right
/// one.
pub(crate) const fn place(side: Side, joint: usize) -> usize {
    6 + 2 * joint + matches!(side, Side::Left) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hardware::tables::joints::JOINTS;
    use downbeat_kinematics::darwin_op::Leg;

    #[test]
    fn joints_of_legs_are_where_they_belong() {
        for side in [Side::Right, Side::Left] {
            for (joint, name) in Leg::joint_names(side).into_iter().enumerate() {
                assert_eq!(JOINTS[place(side, joint)].name, name);
            }
        }
    }
}
