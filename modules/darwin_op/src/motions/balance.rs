//! Keeps a robot on its feet while a motion plays.
//!
//! (1)  wanted: the trunk as it is if the lower sole is flat on the floor
//! (2)  ankle += tilt gain * (tilt - wanted tilt) + rate gain * rate, about x and y
//!
//! Without (2) an ankle is a spring: it holds a robot that stands on one leg only if its weight is exactly
//! above the sole.

use super::motion::Balance;
use crate::attitude::world_from_trunk;
use crate::humanoid::{ANKLE_PITCH, ANKLE_ROLL, Humanoid};
use downbeat_kinematics::leg::Side;
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
pub(super) fn balance(
    humanoid: &Humanoid,
    goals: &mut [f64],
    pose: &[f64],
    attitude: Attitude,
    gains: Balance,
) {
    let tilt = attitude.up.cross(wanted_up(humanoid, pose));
    let [roll, pitch] = [(tilt.x, attitude.rate.x), (tilt.y, attitude.rate.y)]
        .map(|(tilt, rate)| (gains.tilt * tilt + gains.rate * rate).clamp(-MOST, MOST));
    for side in [Side::Right, Side::Left] {
        let leg = humanoid.leg(side);
        leg.turn(goals, ANKLE_ROLL, roll);
        leg.turn(goals, ANKLE_PITCH, pitch);
    }
}

/// The direction in the trunk that points up if the lower sole is flat on the floor.
fn wanted_up(humanoid: &Humanoid, pose: &[f64]) -> DVec3 {
    let [right, left] = [Side::Right, Side::Left].map(|side| {
        let leg = humanoid.leg(side);
        leg.leg.base_from_hip() * leg.leg.forward(&leg.angles(pose))
    });
    let lower = if right.translation.z <= left.translation.z { right } else { left };
    lower.rotation * DVec3::Z
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::humanoid::HIP_ROLL;
    use glam::DQuat;

    const GAINS: Balance = Balance { tilt: 0.5, rate: 0.1 };

    fn sole_up(pose: &[f64]) -> DVec3 {
        let humanoid = Humanoid::darwin_op();
        let leg = humanoid.leg(Side::Right);
        leg.leg.forward(&leg.angles(pose)).rotation * DVec3::Z
    }

    #[test]
    fn a_robot_that_stands_as_wanted_is_left_alone() {
        let humanoid = Humanoid::darwin_op();
        let pose = humanoid.joints().stand();
        let mut goals = pose.clone();
        let attitude = Attitude { up: wanted_up(&humanoid, &pose), rate: DVec3::ZERO };
        balance(&humanoid, &mut goals, &pose, attitude, GAINS);
        assert!(goals.iter().zip(&pose).all(|(goal, angle)| (goal - angle).abs() < 1e-9));
    }

    #[test]
    fn soles_press_against_a_tilt_and_against_a_fall() {
        let humanoid = Humanoid::darwin_op();
        let pose = humanoid.joints().stand();
        let pressed = |tilted: DQuat, rate: DVec3| {
            let mut goals = pose.clone();
            let up = tilted.conjugate() * wanted_up(&humanoid, &pose);
            balance(&humanoid, &mut goals, &pose, Attitude { up, rate }, GAINS);
            sole_up(&goals) - sole_up(&pose)
        };
        assert!(pressed(DQuat::from_rotation_y(0.1), DVec3::ZERO).x > 0.01, "the toes press down");
        assert!(pressed(DQuat::IDENTITY, DVec3::Y).x > 0.01);
        assert!(pressed(DQuat::from_rotation_x(0.1), DVec3::ZERO).y < -0.01, "the right edge presses down");
        assert!(pressed(DQuat::IDENTITY, DVec3::X).y < -0.01);
    }

    #[test]
    fn the_lower_foot_tells_how_the_trunk_should_be() {
        let humanoid = Humanoid::darwin_op();
        let mut pose = humanoid.joints().stand();
        let level = wanted_up(&humanoid, &pose);
        // The right foot is lifted by the hip.
        pose[humanoid.leg(Side::Right).joints[HIP_ROLL]] -= 0.5;
        assert!((wanted_up(&humanoid, &pose) - level).length() < 0.02);
        pose[humanoid.leg(Side::Left).joints[ANKLE_ROLL]] += 0.2;
        assert!((wanted_up(&humanoid, &pose) - level).length() > 0.15);
    }
}
