//! What the servos turn and the IMU feels of a robot in a world.

use crate::error::SimulationError;
use crate::model::Model;
use crate::world::{JointDrive, RobotBodies, Variation};
use downbeat_darwin_op::emulator::{ImuMotion, JointMotion, ServoCommand};
use downbeat_servos::servo_bus::models::STANDARD_GRAVITY;
use downbeat_transforms::Isometry;
use glam::{DQuat, DVec3};
use std::collections::VecDeque;
use std::time::Duration;

/// Servos and sensors of a robot, between the commands of its devices and the bodies in a world.
pub(crate) struct Machine {
    servos: Vec<ServoJoint>,
    imu_frame: (usize, Isometry),
    variation: Variation,
    drives: Vec<JointDrive>,
    /// The robot is held at its start until this time has passed; `None` before the first servo has torque.
    held_for: Option<Duration>,
    /// The last commands, oldest first: as many as fit into the latency.
    commands: VecDeque<Vec<ServoCommand>>,
    joints: Vec<JointMotion>,
    imu: ImuMotion,
    velocity: DVec3,
    /// Of the IMU in the world.
    attitude: DQuat,
}

/// The joint that a servo turns.
#[derive(Clone, Copy)]
struct ServoJoint {
    body: usize,
    /// In N m.
    stall: f64,
    /// Of the back-EMF, in N m s/rad.
    damping: f64,
}

/// How long a robot is still held after its first servo got torque.
const HELD: Duration = Duration::from_millis(500);
/// The lag of the accelerometer. Estimated.
const IMU_LAG_S: f64 = 0.005;
/// How fast a hand turns a robot that it puts down, in rad/s.
const IN_HAND: f64 = 6.0;

impl Machine {
    /// The joints are those that the servos turn, in the order of their commands.
    ///
    /// # Errors
    /// If the robot lacks the joint of a servo.
    pub(crate) fn new(
        model: &Model,
        joints: &[String],
        variation: Variation,
    ) -> Result<Self, SimulationError> {
        let mut servos = Vec::with_capacity(joints.len());
        for joint in joints {
            let missing = || SimulationError::Joint { robot: model.name.clone(), joint: joint.clone() };
            let body = model.body_of_joint(joint).ok_or_else(missing)?;
            let described = model.bodies[body].joint.as_ref().ok_or_else(missing)?;
            let stall = described.effort * variation.strength;
            servos.push(ServoJoint { body, stall, damping: stall / described.velocity });
        }
        Ok(Self {
            imu_frame: model.frames.get(&model.marks.imu).copied().unwrap_or_default(),
            variation,
            drives: vec![JointDrive::default(); model.bodies.len()],
            held_for: None,
            commands: VecDeque::new(),
            servos,
            joints: vec![JointMotion::default(); joints.len()],
            imu: ImuMotion::default(),
            velocity: DVec3::ZERO,
            attitude: DQuat::IDENTITY,
        })
    }

    /// Takes the commands of the devices for the next `dt` and returns those that have reached the motors.
    pub(crate) fn command(&mut self, dt: Duration, commands: &[ServoCommand]) -> Option<Vec<ServoCommand>> {
        self.commands.push_back(commands.to_vec());
        let delayed = self.variation.latency.as_nanos() / dt.as_nanos().max(1);
        while self.commands.len() as u128 > delayed + 1 {
            self.commands.pop_front();
        }
        self.commands.front().cloned()
    }

    /// Sets what the motors do in the next step.
    pub(crate) fn drive(&mut self, commands: &[ServoCommand]) {
        let half_play = self.variation.backlash / 2.0;
        for ((servo, command), joint) in self.servos.iter().zip(commands).zip(&mut self.joints) {
            let (drive, motor) = drive(servo, command, joint.position, half_play);
            self.drives[servo.body] = motor;
            joint.drive = drive;
        }
    }

    /// One for each body.
    pub(crate) fn drives(&self) -> &[JointDrive] {
        &self.drives
    }

    pub(crate) fn joint(&self, servo: usize) -> JointMotion {
        self.joints.get(servo).copied().unwrap_or_default()
    }

    pub(crate) fn imu(&self) -> ImuMotion {
        self.imu
    }

    /// Returns whether the robot is held during this step, as by somebody who puts it down once the servos
    /// have torque.
    pub(crate) fn is_held(&mut self, step: Duration, commands: &[ServoCommand]) -> bool {
        match &mut self.held_for {
            None => {
                if commands.iter().any(|command| command.max_drive > 0.0) {
                    self.held_for = Some(HELD);
                }
                true
            }
            Some(left) if *left > Duration::ZERO => {
                *left = left.saturating_sub(step);
                true
            }
            Some(_) => false,
        }
    }

    /// The robot is held again, as at its start.
    pub(crate) fn hold(&mut self) {
        self.held_for = None;
    }

    /// Measures after a step.
    pub(crate) fn measure(&mut self, bodies: &dyn RobotBodies, step: Duration) {
        for (servo, joint) in self.servos.iter().zip(&mut self.joints) {
            (joint.position, joint.velocity) = bodies.joint(servo.body);
        }
        let dt = step.as_secs_f64();
        let Some(motion) = bodies.motion_of(self.imu_frame.0, &self.imu_frame.1) else { return };
        self.attitude = motion.world_from_body.rotation;
        let imu_from_world = self.attitude.conjugate();
        let acceleration = (motion.linear - self.velocity) / dt + DVec3::Z * STANDARD_GRAVITY;
        self.velocity = motion.linear;
        let force = imu_from_world * acceleration;
        let share = dt / (dt + IMU_LAG_S);
        let felt = DVec3::from(self.imu.specific_force);
        self.imu = ImuMotion {
            angular_velocity: (imu_from_world * motion.angular).to_array(),
            specific_force: (felt + (force - felt) * share).to_array(),
        };
    }

    /// Measures while nothing moves.
    pub(crate) fn measure_at_rest(&mut self, bodies: &dyn RobotBodies) {
        self.measure_in_hand(bodies, Duration::MAX);
    }

    /// Measures while somebody holds the robot, who turned it from where it was last within some steps: an
    /// IMU that is suddenly upright would be a riddle to filters.
    pub(crate) fn measure_in_hand(&mut self, bodies: &dyn RobotBodies, step: Duration) {
        for (servo, joint) in self.servos.iter().zip(&mut self.joints) {
            let (position, velocity) = bodies.joint(servo.body);
            *joint = JointMotion { position, velocity, drive: 0.0 };
        }
        self.velocity = DVec3::ZERO;
        if let Some(motion) = bodies.motion_of(self.imu_frame.0, &self.imu_frame.1) {
            let turn = self.attitude.conjugate() * motion.world_from_body.rotation;
            let shortest = if turn.w < 0.0 { -turn } else { turn }.to_scaled_axis();
            let turned = shortest.clamp_length_max(IN_HAND * step.as_secs_f64());
            self.attitude = (self.attitude * DQuat::from_scaled_axis(turned)).normalize();
            let force = self.attitude.conjugate() * (DVec3::Z * STANDARD_GRAVITY);
            self.imu = ImuMotion {
                angular_velocity: (turned / step.as_secs_f64()).to_array(),
                specific_force: force.to_array(),
            };
        }
    }
}

/// The drive of a servo at this angle of its joint, as a share of the full one, and what it does to the
/// joint: equation (1) of `simulation`.
fn drive(servo: &ServoJoint, command: &ServoCommand, angle: f64, half_play: f64) -> (f64, JointDrive) {
    if command.max_drive <= 0.0 || command.gain <= 0.0 || command.supply <= 0.0 {
        return (0.0, JointDrive { goal: angle, ..JointDrive::default() });
    }
    let error = command.goal - angle;
    let felt = error - error.clamp(-half_play, half_play);
    let drive = (command.gain * felt).clamp(-command.max_drive, command.max_drive);
    let motor = JointDrive {
        goal: angle + drive / command.gain,
        stiffness: command.gain * servo.stall * command.supply / 12.0,
        damping: servo.damping,
        // Against its direction of rotation a motor brakes with more than its stall torque.
        max_torque: 2.0 * servo.stall,
    };
    (drive, motor)
}
