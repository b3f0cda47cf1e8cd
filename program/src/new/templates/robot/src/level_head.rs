//! Holds the head level.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `imu/data_raw` (in) | `sensor_msgs/msg/Imu` | angular velocity of the body |
//! | `joint_commands` | `sensor_msgs/msg/JointState` | goal of the joint `head_tilt`, at 50 Hz |
//! | `head_tilt` | `level_head_msgs/msg/HeadTilt` | the module's state, for each message of the IMU |

use std::time::Duration;

use downbeat::executor::log::warn_every;
use downbeat::executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat::msgs::Message;
use downbeat::msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat::msgs::std_msgs::msg::Header;

/// How far the head is tilted.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "level_head_msgs/msg/HeadTilt", crate = "downbeat::msgs")]
pub struct HeadTilt {
    /// The header of the IMU's message.
    pub header: Header,
    /// Positive is up [rad].
    pub angle: f64,
    /// True if the joint is at a limit.
    pub is_at_limit: bool,
}

downbeat::msgs::interfaces! {
    /// The messages of this module.
    pub INTERFACES: HeadTilt
}

/// Tilts the head against the rotation that the gyroscope measures.
#[derive(Default)]
pub struct LevelHead {
    angle: f64, // rad
    measured: Option<Time>,
}

/// The publications and settings of the module.
pub struct Ports {
    commands: Publication<JointState>,
    tilt: Publication<HeadTilt>,
    gain: Setting<f64>,
}

const LOWEST: f64 = -0.4; // rad
const HIGHEST: f64 = 0.9; // rad

impl Module for LevelHead {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe("imu/data_raw", Self::measure)?;
        setup.every(Duration::from_millis(20), Self::command)?;
        Ok(Ports {
            commands: setup.publish("joint_commands")?,
            tilt: setup.publish("head_tilt")?,
            gain: setup.setting_in("gain", 0.9, 0.0..=2.0, "how much of the rotation is compensated")?,
        })
    }
}

impl LevelHead {
    fn measure(&mut self, imu: Received<'_, Imu>, ctx: &mut Context<'_, Ports>) {
        let now = ctx.now();
        let elapsed =
            self.measured.replace(now).map_or(Duration::ZERO, |before| now.saturating_since(before));
        let gain = *ctx.get(ctx.ports.gain);
        let angle = self.angle + gain * imu.angular_velocity.y * elapsed.as_secs_f64();
        self.angle = angle.clamp(LOWEST, HIGHEST);
        let is_at_limit = self.angle != angle;
        if is_at_limit {
            warn_every!(ctx, Duration::from_secs(5), "the head is at its limit: {:.2} rad", self.angle);
        }
        let tilt = HeadTilt { header: imu.header.clone(), angle: self.angle, is_at_limit };
        ctx.publish(ctx.ports.tilt, tilt);
    }

    fn command(&mut self, ctx: &mut Context<'_, Ports>) {
        let (name, position) = (vec!["head_tilt".into()], vec![self.angle]);
        ctx.publish(ctx.ports.commands, JointState { name, position, ..JointState::default() });
    }
}

#[cfg(test)]
mod tests {
    use downbeat::TestResult;
    use downbeat::executor::Probe;

    use super::*;

    /// The probe advances the clock, so the result is always the same.
    #[test]
    fn the_head_turns_against_the_body_as_far_as_the_joint_allows() -> TestResult {
        let mut probe = Probe::new();
        probe.add("level_head", LevelHead::default())?;
        let tilts = probe.listen::<HeadTilt>("head_tilt")?;
        let mut turning = Imu::default();
        turning.angular_velocity.y = 0.5; // rad/s
        for _ in 0..4 {
            probe.publish("imu/data_raw", turning.clone())?;
            probe.advance(Duration::from_secs(1))?;
        }
        let tilts: Vec<_> = tilts.take().iter().map(|tilt| (tilt.angle, tilt.is_at_limit)).collect();
        assert_eq!(tilts, [(0.0, false), (0.45, false), (0.9, false), (0.9, true)]);
        Ok(())
    }
}
