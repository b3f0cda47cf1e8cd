//! Keeps a robot on its feet while a motion plays.
//!
//! (1)  wanted: the trunk as it is if the lower sole is flat on the floor
//! (2)  ankle += tilt gain * (tilt - wanted tilt) + rate gain * rate, about x and y
//!
//! Without (2) an ankle is a spring: it holds a robot that stands on one leg only if its weight is exactly
//! above the sole.

use super::file::Balance;
use crate::attitude::world_from_trunk;
use crate::hardware::tables::joints::COUNT;
use crate::leg_joints::{ANKLE_PITCH, ANKLE_ROLL, place};
use downbeat_kinematics::darwin_op::{Leg, Side};
use downbeat_msgs::sensor_msgs::msg::Imu;
use glam::DVec3;

/// What the IMU says of the trunk.
#[derive(Clone, Copy, Debug)]
pub(super) struct Attitude {
    /// The direction that points up.
    up: DVec3,
    /// In rad/s.
    rate: DVec3,
}

/// The largest correction of an ankle, in rad: a robot that tilts more than that falls.
const MOST: f64 = 0.25;

impl Attitude {
    /// `None` without a valid orientation.
    pub(super) fn of(imu: &Imu) -> Option<Self> {
        let w = &imu.angular_velocity;
        let (up, rate) = (world_from_trunk(imu)?.conjugate() * DVec3::Z, DVec3::new(w.x, w.y, w.z));
        rate.is_finite().then_some(Self { up, rate })
    }
}

/// Turns the ankles of `goals` against a trunk that tilts other than it would with a flat sole in this pose.
pub(super) fn balance(goals: &mut [f64; COUNT], pose: &[f64; COUNT], attitude: Attitude, gains: Balance) {
    let tilt = attitude.up.cross(wanted_up(pose));
    let [roll, pitch] = [(tilt.x, attitude.rate.x), (tilt.y, attitude.rate.y)]
        .map(|(tilt, rate)| (gains.tilt * tilt + gains.rate * rate).clamp(-MOST, MOST));
    for (side, sign) in [(Side::Right, 1.0), (Side::Left, -1.0)] {
        goals[place(side, ANKLE_ROLL)] += roll;
        goals[place(side, ANKLE_PITCH)] -= sign * pitch;
    }
}

/// The direction in the trunk that points up if the lower sole is flat on the floor.
fn wanted_up(pose: &[f64; COUNT]) -> DVec3 {
    let [right, left] = [Side::Right, Side::Left].map(|side| {
        let leg = Leg::new(side);
        leg.base_from_hip() * leg.forward(&std::array::from_fn(|joint| pose[place(side, joint)]))
    });
    let lower = if right.translation.z <= left.translation.z { right } else { left };
    lower.rotation * DVec3::Z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::leg_joints::HIP_ROLL;
    use crate::present_pose::stand;
    use glam::DQuat;

    const GAINS: Balance = Balance { tilt: 0.5, rate: 0.1 };

    fn sole_up(pose: &[f64; COUNT]) -> DVec3 {
        let angles = std::array::from_fn(|joint| pose[place(Side::Right, joint)]);
        Leg::new(Side::Right).forward(&angles).rotation * DVec3::Z
    }

    #[test]
    fn a_robot_that_stands_as_wanted_is_left_alone() {
        let pose = stand();
        let mut goals = pose;
        balance(&mut goals, &pose, Attitude { up: wanted_up(&pose), rate: DVec3::ZERO }, GAINS);
        assert!(goals.iter().zip(&pose).all(|(goal, angle)| (goal - angle).abs() < 1e-9));
    }

    #[test]
    fn soles_press_against_a_tilt_and_against_a_fall() {
        let pose = stand();
        let pressed = |tilted: DQuat, rate: DVec3| {
            let mut goals = pose;
            let up = tilted.conjugate() * wanted_up(&pose);
            balance(&mut goals, &pose, Attitude { up, rate }, GAINS);
            sole_up(&goals) - sole_up(&pose)
        };
        assert!(pressed(DQuat::from_rotation_y(0.1), DVec3::ZERO).x > 0.01, "the toes press down");
        assert!(pressed(DQuat::IDENTITY, DVec3::Y).x > 0.01);
        assert!(pressed(DQuat::from_rotation_x(0.1), DVec3::ZERO).y < -0.01, "the right edge presses down");
        assert!(pressed(DQuat::IDENTITY, DVec3::X).y < -0.01);
    }

    #[test]
    fn the_lower_foot_tells_how_the_trunk_should_be() {
        let mut pose = stand();
        let level = wanted_up(&pose);
        // The right foot is lifted by the hip.
        pose[place(Side::Right, HIP_ROLL)] -= 0.5;
        assert!((wanted_up(&pose) - level).length() < 0.02);
        pose[place(Side::Left, ANKLE_ROLL)] += 0.2;
        assert!((wanted_up(&pose) - level).length() > 0.15);
    }
}
