//! From what the limbs should do to angles of all joints, and from measured angles to the soles.

use super::engine::{Foot, Targets};
use super::settings::Settings;
use crate::humanoid::{ANKLE_PITCH, ANKLE_ROLL, HIP_PITCH, HIP_ROLL, Humanoid, KNEE};
use downbeat_kinematics::leg::{Leg, Side};
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};

/// The angles of all joints; those that the gait does not move are those of the stand. A leg that cannot
/// reach its foot comes as near as it can.
pub(super) fn pose(humanoid: &Humanoid, targets: &Targets, settings: &Settings) -> Vec<f64> {
    let mut pose = humanoid.joints().stand();
    let swing = settings.arm_swing * targets.stride;
    if let Some([(right, right_sign), (left, left_sign)]) = humanoid.arms() {
        // The right arm goes forward with the left foot: about y by the negative angle.
        pose[right] -= right_sign * swing;
        pose[left] += left_sign * swing;
    }
    let [left_roll, right_roll] = targets.hip_roll;
    // Outwards is to the right for the right leg: about x by the negative angle.
    for (side, foot, roll) in
        [(Side::Right, &targets.right, -right_roll), (Side::Left, &targets.left, left_roll)]
    {
        let leg = humanoid.leg(side);
        let solution = leg.leg.inverse(&hip_from_sole(&leg.leg, foot));
        for (joint, angle) in leg.joints.into_iter().zip(solution.angles) {
            pose[joint] = angle;
        }
        leg.turn(&mut pose, HIP_ROLL, roll);
        leg.turn(&mut pose, HIP_PITCH, -settings.hip_pitch);
    }
    pose
}

/// Turns knees, ankles and hips against the rates of the trunk about x and y, in rad/s.
pub(super) fn balance(humanoid: &Humanoid, pose: &mut [f64], rate: DVec3, settings: &Settings) {
    for side in [Side::Right, Side::Left] {
        let leg = humanoid.leg(side);
        leg.turn(pose, HIP_ROLL, -settings.balance_hip_roll * rate.x);
        leg.turn(pose, KNEE, settings.balance_knee * rate.y);
        leg.turn(pose, ANKLE_PITCH, settings.balance_ankle_pitch * rate.y);
        leg.turn(pose, ANKLE_ROLL, settings.balance_ankle_roll * rate.x);
    }
}

/// Moves the goals of the legs away from where their joints are: they act as with a P gain that is higher by
/// the factor `stiffness`.
pub(super) fn stiffen(humanoid: &Humanoid, goals: &mut [f64], measured: &[f64], stiffness: f64) {
    for side in [Side::Right, Side::Left] {
        for joint in humanoid.leg(side).joints {
            let [min, max] = humanoid.joints()[joint].limits;
            let goal = goals[joint];
            goals[joint] = (measured[joint] + (goal - measured[joint]) * stiffness).clamp(min, max);
        }
    }
}

/// The left and the right sole in the base.
pub(super) fn soles(humanoid: &Humanoid, pose: &[f64]) -> [DVec3; 2] {
    [Side::Left, Side::Right].map(|side| {
        let leg = humanoid.leg(side);
        (leg.leg.base_from_hip() * leg.leg.forward(&leg.angles(pose))).translation
    })
}

fn hip_from_sole(leg: &Leg, foot: &Foot) -> Isometry {
    Isometry {
        translation: DVec3::new(foot.x, foot.y, foot.z - leg.straight()),
        rotation: DQuat::from_rotation_z(foot.yaw),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_soles_of_a_pose_are_those_that_were_wanted() {
        let humanoid = Humanoid::darwin_op();
        let foot = |x: f64, yaw: f64| Foot { x, y: 0.01, z: 0.03, yaw };
        let targets = Targets { left: foot(0.02, 0.1), right: foot(-0.02, -0.2), ..Targets::default() };
        let settings = Settings { hip_pitch: 0.0, ..Settings::default() };
        let [left, right] = soles(&humanoid, &pose(&humanoid, &targets, &settings));
        assert!((left - DVec3::new(0.02, 0.047, -0.1895)).length() < 1e-9, "{left}");
        assert!((right - DVec3::new(-0.02, -0.027, -0.1895)).length() < 1e-9, "{right}");
    }

    #[test]
    fn stiff_legs_have_goals_beyond_what_is_missing() {
        let humanoid = Humanoid::darwin_op();
        let measured = humanoid.joints().stand();
        let knee = humanoid.leg(Side::Left).joints[KNEE];
        let mut goals = measured.clone();
        goals[knee] -= 0.1;
        stiffen(&humanoid, &mut goals, &measured, 2.0);
        assert!((measured[knee] - goals[knee] - 0.2).abs() < 1e-12);
        assert_eq!(goals[0], measured[0]);
    }

    #[test]
    fn balance_turns_the_soles_against_the_fall() {
        let humanoid = Humanoid::darwin_op();
        let upright = pose(&humanoid, &Targets::default(), &Settings::default());
        let pitched = |rate: DVec3| {
            let mut pose = upright.clone();
            balance(&humanoid, &mut pose, rate, &Settings::default());
            let leg = humanoid.leg(Side::Right);
            leg.leg.forward(&leg.angles(&pose)).rotation * DVec3::Z
        };
        let still = pitched(DVec3::ZERO);
        assert!(pitched(DVec3::Y).x > still.x, "the toes press down when it falls forward");
        assert!(pitched(DVec3::X).y < still.y, "the right edge presses down when it falls to the right");
    }
}
