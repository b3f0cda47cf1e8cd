//! The module.

use super::merge::Merge;
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError};
use downbeat_msgs::sensor_msgs::msg::JointState;
use std::time::Duration;

/// Merges joint commands from outside with those of the robot's own motion; see the [module page](super).
#[derive(Default)]
pub struct JointCommandMux {
    merge: Merge,
}

/// The keys of [`JointCommandMux`].
pub struct Ports {
    goals: Publication<JointState>,
    hold_s: Setting<f64>,
}

impl JointCommandMux {
    fn on_outside(&mut self, command: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        self.merge.note_outside(&command, ctx.now());
        ctx.publish(ctx.ports.goals, command.clone());
    }

    fn on_motion(&mut self, command: Received<'_, JointState>, ctx: &mut Context<'_, Ports>) {
        let hold = Duration::from_secs_f64(*ctx.get(ctx.ports.hold_s));
        if let Some(filtered) = self.merge.filter_motion(&command, ctx.now(), hold) {
            ctx.publish(ctx.ports.goals, filtered);
        }
    }
}

impl Module for JointCommandMux {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let what = "s; how long a command from outside holds after the last one";
        let ports = Ports {
            goals: setup.publish("joint_goals")?,
            hold_s: setup.setting_in("hold_s", 2.0, 0.0..=3600.0, what)?,
        };
        setup.subscribe("joint_commands", Self::on_outside)?;
        setup.subscribe("motion/joint_commands", Self::on_motion)?;
        Ok(ports)
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::testing::{Collector, core_at_zero};

    fn command(name: &str, position: f64) -> JointState {
        JointState { name: vec![name.to_owned()], position: vec![position], ..JointState::default() }
    }

    #[test]
    fn outside_takes_precedence_in_the_executor_until_silent_for_two_seconds() {
        let (mut core, clock) = core_at_zero();
        core.add("mux", JointCommandMux::default()).unwrap();
        let goals = Collector::<JointState>::add(&mut core, "joint_goals");
        let outside = core.inlet("joint_commands").unwrap();
        let motion = core.inlet("motion/joint_commands").unwrap();
        let mut step = |ms: u64| {
            clock.advance(Duration::from_millis(ms));
            (0..3).for_each(|_| core.cycle().unwrap());
            goals.take().iter().map(|goal| goal.position[0]).collect::<Vec<f64>>()
        };
        motion.publish(command("head_pan", 0.1)).unwrap();
        assert_eq!(step(1), [0.1]);
        outside.publish(command("head_pan", 0.9)).unwrap();
        assert_eq!(step(1), [0.9]);
        motion.publish(command("head_pan", 0.2)).unwrap();
        motion.publish(command("head_tilt", 0.3)).unwrap();
        assert_eq!(step(1990), [0.3]);
        motion.publish(command("head_pan", 0.4)).unwrap();
        assert_eq!(step(11), [0.4]);
    }
}
