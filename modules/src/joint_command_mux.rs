//! Merges joint commands from outside with those of the robot's own motion.
//!
//! Outside commands take precedence for the joints they name, until some time after the last one, as in
//! `twist_mux`.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joint_commands` (in) | `sensor_msgs/JointState` | from outside |
//! | `motion/joint_commands` (in) | `sensor_msgs/JointState` | from the robot's own motion |
//! | `joint_goals` | `sensor_msgs/JointState` | the merged commands, in order of arrival |
//!
//! The setting `hold_s` is this time in s, by default 2.

use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::sensor_msgs::msg::JointState;
use std::collections::BTreeMap;
use std::time::Duration;

/// Merges joint commands from outside with those of the robot's own motion; see the [module page](self).
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

/// Tracks which joints are commanded from outside.
#[derive(Clone, Debug, Default, PartialEq)]
struct Merge {
    /// When each joint was last commanded from outside.
    outside: BTreeMap<String, Time>,
}

impl Merge {
    /// Notes a command from outside for the joints it names.
    fn note_outside(&mut self, command: &JointState, now: Time) {
        for (name, position) in command.name.iter().zip(&command.position) {
            // NaN is not a command.
            if !position.is_nan() {
                self.outside.insert(name.clone(), now);
            }
        }
        // Bounds memory if names are invented.
        if self.outside.len() > MANY {
            self.outside.retain(|_, at| *at == now);
        }
    }

    /// The part of a command of the robot's own motion that applies; `None` if there is none.
    fn filter_motion(&mut self, command: &JointState, now: Time, hold: Duration) -> Option<JointState> {
        self.outside.retain(|_, at| now < *at + hold);
        if self.outside.is_empty() {
            return (!command.name.is_empty()).then(|| command.clone());
        }
        let mut filtered = JointState { header: command.header.clone(), ..JointState::default() };
        for (index, name) in command.name.iter().enumerate() {
            if self.outside.contains_key(name) {
                continue;
            }
            filtered.name.push(name.clone());
            filtered.position.extend(command.position.get(index));
            filtered.velocity.extend(command.velocity.get(index));
            filtered.effort.extend(command.effort.get(index));
        }
        (!filtered.name.is_empty()).then_some(filtered)
    }
}

/// More names than any robot has joints.
const MANY: usize = 1024;

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::testing::{Collector, core_at_zero};

    fn command(names: &[&str], positions: &[f64]) -> JointState {
        JointState {
            name: names.iter().map(ToString::to_string).collect(),
            position: positions.into(),
            ..JointState::default()
        }
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
        motion.publish(command(&["head_pan"], &[0.1])).unwrap();
        assert_eq!(step(1), [0.1]);
        outside.publish(command(&["head_pan"], &[0.9])).unwrap();
        assert_eq!(step(1), [0.9]);
        motion.publish(command(&["head_pan"], &[0.2])).unwrap();
        motion.publish(command(&["head_tilt"], &[0.3])).unwrap();
        assert_eq!(step(1990), [0.3]);
        motion.publish(command(&["head_pan"], &[0.4])).unwrap();
        assert_eq!(step(11), [0.4]);
    }

    const HOLD: Duration = Duration::from_secs(2);

    fn at(ms: i64) -> Time {
        Time::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn motion_commands_joints_that_outside_does_not_name() {
        let mut merge = Merge::default();
        let motion = command(&["pan", "tilt"], &[1.0, 2.0]);
        assert_eq!(merge.filter_motion(&motion, at(0), HOLD), Some(motion.clone()));
        merge.note_outside(&command(&["pan"], &[0.5]), at(100));
        assert_eq!(merge.filter_motion(&motion, at(101), HOLD), Some(command(&["tilt"], &[2.0])));
    }

    #[test]
    fn outside_takes_precedence_until_some_time_after_its_last_command() {
        let mut merge = Merge::default();
        let motion = command(&["pan"], &[1.0]);
        merge.note_outside(&command(&["pan"], &[0.5]), at(0));
        merge.note_outside(&command(&["pan"], &[0.5]), at(1500));
        assert_eq!(merge.filter_motion(&motion, at(3499), HOLD), None);
        assert_eq!(merge.filter_motion(&motion, at(3500), HOLD), Some(motion));
    }

    #[test]
    fn a_nan_position_claims_no_joint() {
        let mut merge = Merge::default();
        merge.note_outside(&command(&["pan", "tilt"], &[f64::NAN]), at(0));
        assert_eq!(merge, Merge::default());
    }

    #[test]
    fn velocities_and_efforts_stay_with_their_joints() {
        let mut merge = Merge::default();
        merge.note_outside(&command(&["a"], &[0.0]), at(0));
        let motion = JointState { velocity: vec![1.0, 2.0], ..command(&["a", "b"], &[3.0, 4.0]) };
        let filtered = merge.filter_motion(&motion, at(1), HOLD);
        assert_eq!(filtered, Some(JointState { velocity: vec![2.0], ..command(&["b"], &[4.0]) }));
    }

    #[test]
    fn invented_names_do_not_fill_the_memory() {
        let mut merge = Merge::default();
        for number in 0..10_000 {
            merge.note_outside(&command(&[&format!("joint{number}")], &[0.0]), at(number));
        }
        assert!(merge.outside.len() <= MANY);
    }
}
