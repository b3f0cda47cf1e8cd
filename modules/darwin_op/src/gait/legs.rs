//! From what the limbs should do to angles of all joints, and from measured angles to the soles.

use super::engine::{Foot, Targets};
use super::settings::Settings;
use crate::hardware::tables::joints::COUNT;
use crate::leg_joints::{ANKLE_PITCH, ANKLE_ROLL, HIP_PITCH, HIP_ROLL, KNEE, place};
use crate::present_pose::stand;
use downbeat_kinematics::darwin_op::{Leg, Side};
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};

/// The distance from the hip to the sole of a straight leg, in m.
const LEG_LENGTH: f64 = 0.2195;

/// Returns true for the joints that the gait commands: all but those of the head.
pub(super) fn is_moved(joint: usize) -> bool {
    joint < 18
}

/// The angles of all joints; those of the head are those of the stand. A leg that cannot reach its foot comes
/// as near as it can.
pub(super) fn pose(targets: &Targets, settings: &Settings) -> [f64; COUNT] {
    let mut pose = stand();
    let swing = settings.arm_swing * targets.stride;
    pose[0] += swing;
    pose[1] += swing;
    let [left_roll, right_roll] = targets.hip_roll;
    for (side, foot, roll) in
        [(Side::Right, &targets.right, right_roll), (Side::Left, &targets.left, left_roll)]
    {
        for (joint, angle) in Leg::new(side).inverse(&hip_from_sole(foot)).angles.into_iter().enumerate() {
            pose[place(side, joint)] = angle;
        }
        // The angles of the left leg have the opposite sign.
        let sign = if side == Side::Right { 1.0 } else { -1.0 };
        pose[place(side, HIP_ROLL)] += sign * roll;
        pose[place(side, HIP_PITCH)] -= sign * settings.hip_pitch;
    }
    pose
}

/// Turns knees, ankles and hips against the rates of the trunk about x and y, in rad/s.
pub(super) fn balance(pose: &mut [f64; COUNT], rate: DVec3, settings: &Settings) {
    for (side, sign) in [(Side::Right, 1.0), (Side::Left, -1.0)] {
        pose[place(side, HIP_ROLL)] += settings.balance_hip_roll * rate.x;
        pose[place(side, KNEE)] += sign * settings.balance_knee * rate.y;
        pose[place(side, ANKLE_PITCH)] -= sign * settings.balance_ankle_pitch * rate.y;
        pose[place(side, ANKLE_ROLL)] += settings.balance_ankle_roll * rate.x;
    }
}

/// The left and the right sole in base_link.
pub(super) fn soles(pose: &[f64; COUNT]) -> [DVec3; 2] {
    [Side::Left, Side::Right].map(|side| {
        let leg = Leg::new(side);
        let angles = std::array::from_fn(|joint| pose[place(side, joint)]);
        (leg.base_from_hip() * leg.forward(&angles)).translation
    })
}

fn hip_from_sole(foot: &Foot) -> Isometry {
    Isometry {
        translation: DVec3::new(foot.x, foot.y, foot.z - LEG_LENGTH),
        rotation: DQuat::from_rotation_z(foot.yaw),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_soles_of_a_pose_are_those_that_were_wanted() {
        let foot = |x: f64, yaw: f64| Foot { x, y: 0.01, z: 0.03, yaw };
        let targets = Targets { left: foot(0.02, 0.1), right: foot(-0.02, -0.2), ..Targets::default() };
        let settings = Settings { hip_pitch: 0.0, ..Settings::default() };
        let [left, right] = soles(&pose(&targets, &settings));
        assert!((left - DVec3::new(0.02, 0.047, -0.1895)).length() < 1e-9, "{left}");
        assert!((right - DVec3::new(-0.02, -0.027, -0.1895)).length() < 1e-9, "{right}");
    }

    #[test]
    fn balance_turns_the_soles_against_the_fall() {
        let upright = pose(&Targets::default(), &Settings::default());
        let pitched = |rate: DVec3| {
            let mut pose = upright;
            balance(&mut pose, rate, &Settings::default());
            let angles = std::array::from_fn(|joint| pose[place(Side::Right, joint)]);
            Leg::new(Side::Right).forward(&angles).rotation * DVec3::Z
        };
        let still = pitched(DVec3::ZERO);
        assert!(pitched(DVec3::Y).x > still.x, "the toes press down when it falls forward");
        assert!(pitched(DVec3::X).y < still.y, "the right edge presses down when it falls to the right");
    }
}
