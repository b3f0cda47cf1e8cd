//! The module.

use super::motion::{Pose, pose, stand};
use crate::darwin_op::CYCLE;
use crate::darwin_op::tables::joints::{JOINTS, index_of};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::Header;
use std::time::Duration;

/// Stands up, then nods and waves; see the [module page](super).
#[derive(Default)]
pub struct StandNodWave {
    /// The start time and pose of the motion.
    begun: Option<(Time, Pose)>,
}

/// The keys of [`StandNodWave`].
pub struct Ports {
    commands: Publication<JointState>,
    stand_s: Setting<f64>,
}

impl StandNodWave {
    fn on_joint_states(&mut self, state: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        if self.begun.is_none() {
            self.begun = Some((ctx.now(), start_of(&state)));
        }
    }

    fn tick(&mut self, ctx: &mut Context<'_, Ports>) {
        let Some((begun, start)) = &self.begun else { return };
        let now = ctx.now();
        let standing_up = Duration::from_secs_f64(*ctx.get(ctx.ports.stand_s));
        let position = pose(start, standing_up, now.saturating_since(*begun)).to_vec();
        let stamp = builtin_interfaces::msg::Time::from_nanos(now.as_nanos());
        let header = Header { stamp, frame_id: String::new() };
        let name = JOINTS.iter().map(|joint| joint.name.to_owned()).collect();
        ctx.publish(ctx.ports.commands, JointState { header, name, position, ..JointState::default() });
    }
}

impl Module for StandNodWave {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let ports = Ports {
            commands: setup.publish("motion/joint_commands")?,
            stand_s: setup.setting_in("stand_s", 3.0, 1.0..=60.0, "s; how long standing up takes")?,
        };
        setup.subscribe("joint_states", Self::on_joint_states)?;
        setup.every(CYCLE, Self::tick)?;
        Ok(ports)
    }
}

/// The start pose; joints that are missing or NaN start at their goal.
fn start_of(state: &JointState) -> Pose {
    let mut start = stand();
    for (name, position) in state.name.iter().zip(&state.position) {
        if let Some(index) = index_of(name).filter(|_| position.is_finite()) {
            start[index] = *position;
        }
    }
    start
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::{Collector, core_at_zero};

    #[test]
    fn it_commands_all_joints_every_eight_milliseconds_once_it_knows_where_they_are() {
        let (mut core, clock) = core_at_zero();
        core.add("motion", StandNodWave::default()).unwrap();
        let commands = Collector::<JointState>::add(&mut core, "motion/joint_commands");
        let states = core.inlet("joint_states").unwrap();
        let mut run = |cycles: u32| {
            for _ in 0..cycles {
                clock.advance(CYCLE);
                core.cycle().unwrap();
            }
            commands.take()
        };
        assert_eq!(run(10), []);
        let state =
            JointState { name: vec!["head_tilt".into()], position: vec![0.5], ..JointState::default() };
        states.publish(state).unwrap();
        run(3);
        let sent = run(1000);
        assert_eq!(sent.len(), 1000);
        assert!(sent.iter().all(|command| command.name.len() == 20 && command.position.len() == 20));
        let tilt: Vec<f64> = sent.iter().map(|command| command.position[19]).collect();
        assert!((tilt[0] - 0.5).abs() < 0.01, "it starts where the head is, not at {}", tilt[0]);
        assert!(tilt.iter().any(|angle| *angle < -0.2), "it nods");
    }

    #[test]
    fn an_unknown_joint_does_not_move() {
        let state =
            JointState { name: vec!["r_el".into()], position: vec![f64::NAN], ..JointState::default() };
        assert_eq!(start_of(&state), stand());
    }
}
