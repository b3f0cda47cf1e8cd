//! The mechanics behind the emulated devices: what the servos turn and the IMU feels.

use std::time::Duration;

/// The mechanics of a robot, driven by its servos and measured by its sensors.
///
/// `Standing` of `downbeat-darwin-op` is a formula; the package `downbeat-physics` has rigid bodies with
/// contacts. SI units and the frames of REP-103 (x forward, y left, z up); joints are in the order of
/// `JOINTS` of `downbeat-darwin-op`.
///
/// The state after a number of calls depends only on their arguments, so that the same instructions on the
/// bus get the same answers.
pub trait Body: Send {
    /// Advances by `dt`. There is one command for each joint.
    fn advance(&mut self, dt: Duration, commands: &[ServoCommand]);

    /// The motion of a joint. The index is that of its command.
    fn joint(&self, index: usize) -> JointMotion;

    /// What an IMU in the trunk feels.
    fn imu(&self) -> ImuMotion;

    /// The force on each corner of the soles, in N; `None` for a body without feet.
    fn foot_forces(&self) -> Option<FootForces> {
        None
    }

    /// Turns a joint to this angle by hand, unless its servo holds it. Bodies that nobody touches ignore it.
    fn turn_by_hand(&mut self, index: usize, angle: f64) {
        let _ = (index, angle);
    }

    /// Whether a joint is being turned by hand.
    fn is_in_hand(&self, index: usize) -> bool {
        let _ = index;
        false
    }

    /// A step of the owner of the bus begins: see [`MemoryBus`](super::MemoryBus). What others ask of the
    /// body takes effect here, so that its order does not depend on threads.
    fn begin_step(&mut self) {}
}

/// What a servo does to its joint until the next command.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ServoCommand {
    /// The angle to drive to, in rad: that of the goal position, approached at the moving speed.
    pub goal: f64,
    /// The drive for each rad between the joint and the goal, as a fraction of the full drive.
    pub gain: f64,
    /// The largest drive, as a fraction of the full drive; 0 while torque is disabled.
    pub max_drive: f64,
    /// The supply voltage, in V; 0 without power.
    pub supply: f64,
}

impl ServoCommand {
    /// The command of a servo without power.
    pub const OFF: Self = Self { goal: 0.0, gain: 0.0, max_drive: 0.0, supply: 0.0 };

    /// The drive at this angle, as a fraction of the full drive.
    #[must_use]
    pub fn drive_at(&self, angle: f64) -> f64 {
        (self.gain * (self.goal - angle)).clamp(-self.max_drive, self.max_drive)
    }
}

/// The motion of a joint.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct JointMotion {
    /// In rad.
    pub position: f64,
    /// In rad/s.
    pub velocity: f64,
    /// The drive of its servo, as a fraction of the full drive.
    pub drive: f64,
}

/// What an IMU feels, forward, left and up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ImuMotion {
    /// In rad/s.
    pub angular_velocity: [f64; 3],
    /// Acceleration minus gravity, in m/s^2: 9.81 upwards at rest.
    pub specific_force: [f64; 3],
}

/// The forces on the soles, in N: front left, front right, rear left, rear right.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FootForces {
    /// Of the right foot.
    pub right: [f64; 4],
    /// Of the left foot.
    pub left: [f64; 4],
}
