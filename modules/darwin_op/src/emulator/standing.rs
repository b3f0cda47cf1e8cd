//! A body whose feet always stand flat on the floor, as a formula.
//!
//! # Attitude of the trunk
//! Turning a leg's joints turns the trunk instead of the foot. With the axes of the joints (forward, left,
//! up), the right foot is turned against the trunk by
//!
//! - pitch: hip pitch + knee - ankle pitch (the left leg mirrored),
//! - roll: ankle roll - hip roll, yaw: - hip yaw (both legs alike),
//!
//! the trunk against the floor by the opposite, averaged over both legs, with a lag.

use crate::hardware::tables::joints::{COUNT, JOINTS};
use crate::hardware::tables::units::{CENTRE_TICKS, PRESENT_SPEED_UNIT, RADIANS_PER_TICK, STANDARD_GRAVITY};
use downbeat_servos::servo_emulator::{Body, FootForces, ImuMotion, JointMotion, ServoCommand};
use std::time::Duration;

/// At 12 V, in ticks/s.
const NO_LOAD_SPEED: f64 = 5.76 / RADIANS_PER_TICK;
/// One step of the present speed, in ticks/s.
const SPEED_STEP: f64 = PRESENT_SPEED_UNIT / RADIANS_PER_TICK;
/// The share of the full drive below which a servo at rest does not move.
const STATIC_FRICTION: f64 = 0.006;
const MOTOR_LAG_S: f64 = 0.02;
/// 2.925 kg.
const WEIGHT_N: f64 = 2.925 * STANDARD_GRAVITY;
/// Of the trunk, behind the legs.
const LAG_S: f64 = 0.08;

/// A Darwin OP that cannot fall: joints with speed, friction and a little gravity, on feet that always stand
/// flat.
pub struct Standing {
    joints: Vec<Joint>,
    attitude: Attitude,
}

impl Standing {
    /// A robot at rest with these joint angles, in ticks.
    pub(super) fn new(ticks: [f64; COUNT]) -> Self {
        let joints: Vec<Joint> =
            (0..COUNT).map(|index| Joint::new(JOINTS[index].name, ticks[index])).collect();
        let attitude = Attitude::at_rest(&angles(&joints));
        Self { joints, attitude }
    }
}

impl Body for Standing {
    fn advance(&mut self, dt: Duration, commands: &[ServoCommand]) {
        let dt = dt.as_secs_f64();
        for (joint, command) in self.joints.iter_mut().zip(commands) {
            joint.advance(dt, command);
        }
        self.attitude.advance(dt, &angles(&self.joints));
    }

    fn joint(&self, index: usize) -> JointMotion {
        self.joints.get(index).map(Joint::motion).unwrap_or_default()
    }

    fn foot_forces(&self) -> Option<FootForces> {
        let corner = WEIGHT_N / 8.0;
        Some(FootForces { right: [corner; 4], left: [corner; 4] })
    }

    fn imu(&self) -> ImuMotion {
        ImuMotion {
            angular_velocity: self.attitude.angular_velocity(),
            specific_force: self.attitude.specific_force(),
        }
    }
}

fn angles(joints: &[Joint]) -> [f64; COUNT] {
    std::array::from_fn(|index| joints[index].angle())
}

/// A joint and the gear of its servo, in ticks.
struct Joint {
    gravity: f64,
    position: f64,
    velocity: f64,
    drive: f64,
}

impl Joint {
    fn new(name: &str, position: f64) -> Self {
        let gravity = match name {
            "r_knee" | "l_knee" => 0.08,
            "r_hip_pitch" | "l_hip_pitch" | "r_ank_pitch" | "l_ank_pitch" => 0.03,
            "r_sho_pitch" | "l_sho_pitch" | "r_sho_roll" | "l_sho_roll" => -0.02,
            _ => 0.0,
        };
        Self { gravity, position, velocity: 0.0, drive: 0.0 }
    }

    /// In rad.
    fn angle(&self) -> f64 {
        (self.position - f64::from(CENTRE_TICKS)) * RADIANS_PER_TICK
    }

    fn motion(&self) -> JointMotion {
        JointMotion { position: self.angle(), velocity: self.velocity * RADIANS_PER_TICK, drive: self.drive }
    }

    fn advance(&mut self, dt: f64, command: &ServoCommand) {
        self.drive = command.drive_at(self.angle());
        if command.supply == 0.0 {
            self.velocity = 0.0;
            return;
        }
        // Without torque the gear holds the joint: 193:1 is hard to turn from outside.
        let holds_itself = self.drive == 0.0;
        let net = if holds_itself { 0.0 } else { self.drive + self.gravity * libm::sin(self.angle()) };
        let sticks = net.abs() < STATIC_FRICTION && self.velocity.abs() < SPEED_STEP;
        let speed = if sticks { 0.0 } else { net * NO_LOAD_SPEED * command.supply / 12.0 };
        self.velocity += (speed - self.velocity) * (dt / MOTOR_LAG_S).min(1.0);
        if sticks {
            self.velocity = 0.0;
        }
        let moved = self.position + self.velocity * dt;
        self.position = moved.clamp(0.0, 4095.0);
        if self.position != moved {
            self.velocity = 0.0;
        }
    }
}

/// Roll, pitch and yaw of the trunk relative to the floor, in rad, and their rates, in rad/s.
#[derive(Clone, Copy, Debug, Default)]
struct Attitude {
    angles: [f64; 3],
    rates: [f64; 3],
}

impl Attitude {
    /// The attitude at rest with these joint angles, in rad, in the order of the joints.
    fn at_rest(joints: &[f64; COUNT]) -> Self {
        Self { angles: lean(joints), rates: [0.0; 3] }
    }

    /// Advances by `dt` seconds.
    fn advance(&mut self, dt: f64, joints: &[f64; COUNT]) {
        let target = lean(joints);
        self.rates = std::array::from_fn(|axis| (target[axis] - self.angles[axis]) / LAG_S);
        self.angles = std::array::from_fn(|axis| self.angles[axis] + self.rates[axis] * dt);
    }

    /// The angular rate of the trunk about forward, left, up, in rad/s. Small angles: rates of the angles.
    fn angular_velocity(&self) -> [f64; 3] {
        self.rates
    }

    /// The specific force on the trunk forward, left, up, in m/s^2: gravity only.
    fn specific_force(&self) -> [f64; 3] {
        let [roll, pitch, _] = self.angles;
        [
            -libm::sin(pitch) * STANDARD_GRAVITY,
            libm::cos(pitch) * libm::sin(roll) * STANDARD_GRAVITY,
            libm::cos(pitch) * libm::cos(roll) * STANDARD_GRAVITY,
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
    use crate::hardware::tables::joints::JOINTS;
    use crate::hardware::tables::units::radians_from_ticks;

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
