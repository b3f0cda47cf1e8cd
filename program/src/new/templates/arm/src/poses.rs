//! Moves the arm to poses by name.
//!
//! | name | type | |
//! | --- | --- | --- |
//! | `poses/home`, `poses/reach` | service `std_srvs/srv/Trigger` | begins to move there |
//! | `arm/joint_trajectory` | `trajectory_msgs/msg/JointTrajectory` | for the controller `arm` |
//! | `joint_states` (in) | `sensor_msgs/msg/JointState` | whether the servos answer |

use std::time::Duration;

use downbeat::executor::log::{info, warn_every};
use downbeat::executor::{Context, Module, Publication, Setting, Setup, SetupError};
use downbeat::msgs::builtin_interfaces::msg::Duration as DurationMessage;
use downbeat::msgs::sensor_msgs::msg::JointState;
use downbeat::msgs::std_srvs::srv::{TriggerRequest, TriggerResponse};
use downbeat::msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};

struct Pose {
    name: &'static str,
    positions: [f64; 4], // rad, in the order of JOINTS
}

const JOINTS: [&str; 4] = ["shoulder_pan", "shoulder_lift", "elbow", "gripper"];
const HOME: Pose = Pose { name: "home", positions: [0.0, 0.0, 0.0, 0.0] };
const REACH: Pose = Pose { name: "reach", positions: [0.5, 0.6, 0.8, 1.0] };

/// Moves the arm to poses by name.
#[derive(Default)]
pub struct Poses {
    has_state: bool,
    moves: u32,
}

/// The publication and settings of the module.
pub struct Ports {
    trajectory: Publication<JointTrajectory>,
    seconds: Setting<f64>,
    is_demo: Setting<bool>,
}

impl Module for Poses {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe::<JointState, _>("joint_states", |poses, _, _| poses.has_state = true)?;
        setup.serve("poses/home", |poses, _: &TriggerRequest, ctx| poses.asked(&HOME, ctx))?;
        setup.serve("poses/reach", |poses, _: &TriggerRequest, ctx| poses.asked(&REACH, ctx))?;
        setup.every(Duration::from_secs(2), Self::demonstrate)?;
        Ok(Ports {
            trajectory: setup.publish("arm/joint_trajectory")?,
            seconds: setup.setting_in("seconds", 1.0, 0.2..=60.0, "how long a movement takes, s")?,
            is_demo: setup.setting("is_demo", false, "goes from pose to pose by itself")?,
        })
    }
}

impl Poses {
    fn asked(&mut self, pose: &Pose, ctx: &mut Context<'_, Ports>) -> Result<TriggerResponse, String> {
        let success = self.go(pose, ctx);
        let message = if success { "" } else { "no joint states" };
        Ok(TriggerResponse { success, message: message.into() })
    }

    fn demonstrate(&mut self, ctx: &mut Context<'_, Ports>) {
        if *ctx.get(ctx.ports.is_demo) {
            let pose = if self.moves % 2 == 0 { &REACH } else { &HOME };
            self.go(pose, ctx);
        }
    }

    /// Begins to move, if the servos answer.
    fn go(&mut self, pose: &Pose, ctx: &mut Context<'_, Ports>) -> bool {
        if !self.has_state {
            warn_every!(ctx, Duration::from_secs(5), "no joint states: do the servos answer?");
            return false;
        }
        info!("to the pose {}", pose.name);
        self.moves += 1;
        let seconds = Duration::from_secs_f64(*ctx.get(ctx.ports.seconds));
        let point = JointTrajectoryPoint {
            positions: pose.positions.to_vec(),
            time_from_start: DurationMessage {
                sec: i32::try_from(seconds.as_secs()).unwrap_or(i32::MAX),
                nanosec: seconds.subsec_nanos(),
            },
            ..JointTrajectoryPoint::default()
        };
        let joint_names = JOINTS.map(Into::into).to_vec();
        let trajectory = JointTrajectory { joint_names, points: vec![point], ..JointTrajectory::default() };
        ctx.publish(ctx.ports.trajectory, trajectory);
        true
    }
}

#[cfg(test)]
mod tests {
    use downbeat::TestResult;
    use downbeat::executor::Probe;

    use super::*;

    /// The probe advances the clock, so the result is always the same.
    #[test]
    fn it_moves_on_request_once_the_servos_answer() -> TestResult {
        let mut probe = Probe::new();
        probe.add("poses", Poses::default())?;
        let trajectories = probe.listen::<JointTrajectory>("arm/joint_trajectory")?;
        let refused: TriggerResponse = probe.call("poses/home", TriggerRequest::default())?;
        assert_eq!((refused.success, &*refused.message), (false, "no joint states"));
        probe.publish("joint_states", JointState::default())?;
        let reaches: TriggerResponse = probe.call("poses/reach", TriggerRequest::default())?;
        assert!(reaches.success);
        let [trajectory] = &*trajectories.take() else { panic!("one trajectory") };
        assert_eq!(trajectory.points[0].positions, REACH.positions);
        probe.set("poses", "is_demo", true)?;
        probe.advance(Duration::from_secs(4))?;
        let goals: Vec<f64> =
            trajectories.take().iter().map(|trajectory| trajectory.points[0].positions[0]).collect();
        assert_eq!(goals, [HOME.positions[0], REACH.positions[0]]);
        Ok(())
    }
}
