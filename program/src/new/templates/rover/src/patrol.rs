//! Drives along a square, unless somebody drives by hand.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `odom` (in) | `nav_msgs/msg/Odometry` | where the rover is |
//! | `cmd_vel` (in) | `geometry_msgs/msg/Twist` | how somebody drives it by hand: passed on, and no patrol for a second |
//! | `base/cmd_vel` | `geometry_msgs/msg/Twist` | how it is to drive, at 20 Hz while `is_on` |

use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

use downbeat::executor::log::{info, warn_every};
use downbeat::executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat::libm;
use downbeat::msgs::geometry_msgs::msg::Twist;
use downbeat::msgs::nav_msgs::msg::Odometry;

/// Drives along a square, by odometry.
#[derive(Default)]
pub struct Patrol {
    pose: Option<Pose>,
    /// Where the present side began.
    corner: Option<Pose>,
    corners: u32,
    driven_by_hand: Option<Time>,
}

#[derive(Clone, Copy)]
struct Pose {
    x: f64,       // m
    y: f64,       // m
    heading: f64, // rad, positive to the left
}

/// The publication and settings of the module.
pub struct Ports {
    command: Publication<Twist>,
    is_on: Setting<bool>,
    side: Setting<f64>,
    speed: Setting<f64>,
}

const TURN: f64 = 1.0; // rad/s

impl Module for Patrol {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe("odom", Self::measure)?;
        setup.subscribe("cmd_vel", Self::pass_on)?;
        setup.every(Duration::from_millis(50), Self::drive)?;
        Ok(Ports {
            command: setup.publish("base/cmd_vel")?,
            is_on: setup.setting("is_on", false, "whether it drives")?,
            side: setup.setting_in("side", 0.3, 0.05..=10.0, "length of a side, m")?,
            speed: setup.setting_in("speed", 0.15, 0.0..=1.0, "m/s")?,
        })
    }
}

impl Patrol {
    fn measure(&mut self, odometry: Received<'_, Odometry>, _: &mut Context<'_, Ports>) {
        let (position, q) = (&odometry.pose.pose.position, &odometry.pose.pose.orientation);
        self.pose = Some(Pose { x: position.x, y: position.y, heading: 2.0 * libm::atan2(q.z, q.w) });
    }

    fn pass_on(&mut self, command: Received<'_, Twist>, ctx: &mut Context<'_, Ports>) {
        self.driven_by_hand = Some(ctx.now());
        ctx.publish(ctx.ports.command, command.clone());
    }

    fn drive(&mut self, ctx: &mut Context<'_, Ports>) {
        let is_by_hand =
            self.driven_by_hand.is_some_and(|time| ctx.now().saturating_since(time) < Duration::from_secs(1));
        if is_by_hand || !*ctx.get(ctx.ports.is_on) {
            self.corner = None;
            return;
        }
        let Some(pose) = self.pose else {
            return warn_every!(ctx, Duration::from_secs(5), "no odometry: do the wheels answer?");
        };
        let corner = *self.corner.get_or_insert(pose);
        let driven = libm::hypot(pose.x - corner.x, pose.y - corner.y);
        let turned = pose.heading - corner.heading;
        // The heading jumps from pi to -pi.
        let turned = libm::atan2(libm::sin(turned), libm::cos(turned));
        let mut command = Twist::default();
        if turned >= FRAC_PI_2 - 0.05 {
            self.corners += 1;
            self.corner = Some(pose);
            info!("corner {}", self.corners);
        } else if driven < *ctx.get(ctx.ports.side) {
            command.linear.x = *ctx.get(ctx.ports.speed);
        } else {
            command.angular.z = TURN;
        }
        ctx.publish(ctx.ports.command, command);
    }
}

#[cfg(test)]
mod tests {
    use downbeat::TestResult;
    use downbeat::executor::Probe;

    use super::*;

    fn at(x: f64, heading: f64) -> Odometry {
        let mut odometry = Odometry::default();
        odometry.pose.pose.position.x = x;
        (odometry.pose.pose.orientation.z, odometry.pose.pose.orientation.w) = libm::sincos(heading / 2.0);
        odometry
    }

    /// The probe advances the clock, so the result is always the same.
    #[test]
    fn it_drives_a_side_and_turns_at_the_corner() -> TestResult {
        let mut probe = Probe::new();
        probe.add("patrol", Patrol::default())?;
        let commands = probe.listen::<Twist>("base/cmd_vel")?;
        probe.set("patrol", "is_on", true)?;
        for (odometry, forward, turn) in [
            (at(0.0, 0.0), 0.15, 0.0),
            (at(0.2, 0.0), 0.15, 0.0),
            (at(0.31, 0.0), 0.0, TURN),
            (at(0.31, 1.0), 0.0, TURN),
            (at(0.31, 1.55), 0.0, 0.0),
            (at(0.31, 1.55), 0.15, 0.0),
        ] {
            probe.publish("odom", odometry)?;
            probe.advance(Duration::from_millis(50))?;
            let commands: Vec<_> =
                commands.take().iter().map(|twist| (twist.linear.x, twist.angular.z)).collect();
            assert_eq!(commands, [(forward, turn)]);
        }
        Ok(())
    }

    #[test]
    fn who_drives_by_hand_interrupts_it_for_a_second() -> TestResult {
        let mut probe = Probe::new();
        probe.add("patrol", Patrol::default())?;
        probe.set("patrol", "is_on", true)?;
        probe.publish("odom", at(0.0, 0.0))?;
        let commands = probe.listen::<Twist>("base/cmd_vel")?;
        let mut by_hand = Twist::default();
        by_hand.linear.x = -0.1;
        probe.publish("cmd_vel", by_hand.clone())?;
        probe.advance(Duration::from_millis(900))?;
        assert_eq!(commands.take(), [by_hand]);
        probe.advance(Duration::from_millis(200))?;
        assert!(!commands.take().is_empty());
        Ok(())
    }
}
