//! The attitude of the body, and its effect on the IMU.
//!
//! Both feet are assumed to stand flat, so turning a leg's joints turns the body instead of the foot. With
//! the axes of the joints (forward, left, up), the right foot is rotated relative to the body by
//!
//! - pitch: hip pitch + knee - ankle pitch (the left leg mirrored),
//! - roll: ankle roll - hip roll, yaw: - hip yaw (both legs alike),
//!
//! and the body relative to the floor by the opposite, averaged over both legs. The body follows with a lag.

use crate::darwin_op::tables::joints::COUNT;
use crate::darwin_op::tables::units::STANDARD_GRAVITY;

const LAG_S: f64 = 0.08;

/// Roll, pitch and yaw of the body relative to the floor, in rad, and their rates, in rad/s.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Attitude {
    angles: [f64; 3],
    rates: [f64; 3],
}

impl Attitude {
    /// The attitude at rest with these joint angles, in rad, in the order of the joints.
    pub(super) fn at_rest(joints: &[f64; COUNT]) -> Self {
        Self { angles: lean(joints), rates: [0.0; 3] }
    }

    /// Advances by `dt` seconds.
    pub(super) fn advance(&mut self, dt: f64, joints: &[f64; COUNT]) {
        let target = lean(joints);
        self.rates = std::array::from_fn(|axis| (target[axis] - self.angles[axis]) / LAG_S);
        self.angles = std::array::from_fn(|axis| self.angles[axis] + self.rates[axis] * dt);
    }

    /// The angular rate of the body about forward, left, up, in rad/s. Small angles: rates of the angles.
    pub(super) fn angular_velocity(&self) -> [f64; 3] {
        self.rates
    }

    /// The specific force on the body forward, left, up, in m/s^2: gravity only.
    pub(super) fn specific_force(&self) -> [f64; 3] {
        let [roll, pitch, _] = self.angles;
        [
            -pitch.sin() * STANDARD_GRAVITY,
            pitch.cos() * roll.sin() * STANDARD_GRAVITY,
            pitch.cos() * roll.cos() * STANDARD_GRAVITY,
        ]
    }
}

fn lean(joints: &[f64; COUNT]) -> [f64; 3] {
    // By servo id, counted from 1.
    let joint = |id: usize| joints[id - 1];
    let right_pitch = -(joint(11) + joint(13) - joint(15));
    let left_pitch = joint(12) + joint(14) - joint(16);
    let right_roll = joint(9) - joint(17);
    let left_roll = joint(10) - joint(18);
    [(right_roll + left_roll) / 2.0, (right_pitch + left_pitch) / 2.0, (joint(7) + joint(8)) / 2.0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::darwin_op::tables::joints::JOINTS;
    use crate::darwin_op::tables::units::radians_from_ticks;

    #[test]
    fn standing_ready_to_walk_leans_thirteen_degrees_forward() {
        // The framework's hip pitch offset is 13 degrees.
        let ready = JOINTS.map(|joint| radians_from_ticks(joint.walking_ready_ticks, 0));
        let attitude = Attitude::at_rest(&ready);
        let [roll, pitch, yaw] = attitude.angles.map(f64::to_degrees);
        assert!((pitch - 12.9).abs() < 0.1 && roll.abs() < 0.1 && yaw == 0.0, "{roll} {pitch} {yaw}");
        let [forward, left, up] = attitude.specific_force();
        assert!(forward < -2.0 && left.abs() < 0.1 && up > 9.0);
    }

    #[test]
    fn leaning_forward_turns_about_the_left_axis() {
        let mut attitude = Attitude::default();
        let mut joints = [0.0; COUNT];
        // Both ankles let the shins forward.
        joints[14] = 0.2;
        joints[15] = -0.2;
        attitude.advance(0.001, &joints);
        assert!(attitude.angular_velocity()[1] > 0.0);
    }
}
