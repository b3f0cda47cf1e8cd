//! Decides which of several commands a joint gets: by the order of their sources, joint by joint.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | the topics in the setting `sources` (in) | `sensor_msgs/JointState` | commands, those with precedence first |
//! | `joint_goals` | `sensor_msgs/JointState` | the commands that apply, in order of arrival |
//!
//! A source holds a joint from each command for it until it has been silent for some time: `hold_s` for
//! `joint_commands`, the topic for commands from outside, and 0.1 s for modules of the robot, which command
//! their joints in every cycle of the hardware. Commands of sources with less precedence are dropped for this
//! joint meanwhile.
//!
//! A command whose stamp is older or newer than this time is dropped, counted, and reported once; a stamp of
//! 0 is now.
//!
//! When another module of the robot takes over a joint, its goal moves from the last one to the commanded one
//! at `handover_speed` and then follows the commands immediately. Commands from outside are passed on as they
//! are, since they may come only once. Joint limits are those of the hardware module.
//!
//! | setting | |
//! | --- | --- |
//! | `sources` | topics of commands, those with precedence first |
//! | `hold_s` | how long a command from outside holds its joints, s |
//! | `handover_speed` | how fast a joint goes to the command of the module that takes it over, rad/s |

use crate::stamps::{Stale, given_at};
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::sensor_msgs::msg::JointState;
use std::collections::BTreeMap;
use std::time::Duration;

/// Decides which commands joints get; see the [module page](self).
#[derive(Debug, Default)]
pub struct JointCommandMux {
    joints: Joints,
    stale: Stale,
}

/// The keys of [`JointCommandMux`].
pub struct Ports {
    goals: Publication<JointState>,
    hold_s: Setting<f64>,
    handover_speed: Setting<f64>,
}

/// The topic of commands from outside.
const OUTSIDE: &str = "joint_commands";

/// All topics of the modules in this package, those with precedence first: a robot that falls or plays a
/// motion to get up takes no other commands.
const SOURCES: [&str; 5] = [
    "falls/joint_commands",
    "motions/joint_commands",
    OUTSIDE,
    "gait/joint_commands",
    "motion/joint_commands",
];

/// How long a command of a module of the robot holds: a dozen cycles of the hardware.
const OWN_HOLD: Duration = Duration::from_millis(100);

impl JointCommandMux {
    fn on_command(&mut self, command: &JointState, source: Source, ctx: &mut Context<'_, Ports>) {
        let hold = match source.is_outside {
            true => Duration::from_secs_f64(*ctx.get(ctx.ports.hold_s)),
            false => OWN_HOLD,
        };
        if let Err(reason) = given_at(&command.header.stamp, ctx.now(), hold) {
            let topic = if source.is_outside { OUTSIDE } else { "a source of the joint multiplexer" };
            return self.stale.drop_for(topic, &reason);
        }
        let speed = *ctx.get(ctx.ports.handover_speed);
        if let Some(goals) = self.joints.goals(command, source, ctx.now(), hold, speed) {
            ctx.publish(ctx.ports.goals, goals);
        }
    }
}

impl Module for JointCommandMux {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        let ports = Ports {
            goals: setup.publish("joint_goals")?,
            hold_s: setup.setting_in(
                "hold_s",
                2.0,
                0.0..=3600.0,
                "s; how long a command from outside holds after the last one",
            )?,
            handover_speed: setup.setting_in(
                "handover_speed",
                3.0,
                0.1..=100.0,
                "rad/s; how fast a joint goes to the command of the module that takes it over",
            )?,
        };
        let sources = setup.read_only_setting(
            "sources",
            SOURCES.map(str::to_owned).to_vec(),
            "topics of joint commands, those with precedence first",
        )?;
        for (rank, topic) in setup.value(sources).cloned().unwrap_or_default().iter().enumerate() {
            let source = Source { rank, is_outside: topic == OUTSIDE };
            setup.subscribe(topic, move |mux: &mut Self, command: Received<'_, JointState>, ctx| {
                mux.on_command(&command, source, ctx);
            })?;
        }
        Ok(ports)
    }

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Source {
    /// 0 has precedence over all others.
    rank: usize,
    is_outside: bool,
}

/// Who commands each joint.
#[derive(Clone, Debug, Default, PartialEq)]
struct Joints {
    held: BTreeMap<String, Held>,
}

/// Who commands a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Held {
    rank: usize,
    until: Time,
    /// When the last command came, and the goal that followed from it, in rad.
    last: (Time, f64),
    /// True until the goal has reached the commands of the source that took over.
    is_handover: bool,
}

impl Joints {
    /// The part of a command that applies; `None` if there is none.
    fn goals(
        &mut self,
        command: &JointState,
        source: Source,
        now: Time,
        hold: Duration,
        speed: f64,
    ) -> Option<JointState> {
        // Bounds memory if names are invented.
        if self.held.len() > MANY {
            self.held.retain(|_, held| held.until > now);
        }
        let mut goals = JointState { header: command.header.clone(), ..JointState::default() };
        for (index, (name, position)) in command.name.iter().zip(&command.position).enumerate() {
            // NaN is not a command.
            if position.is_nan() {
                continue;
            }
            let until = now + hold;
            let mut taken = Held { rank: source.rank, until, last: (now, *position), is_handover: false };
            if let Some(held) = self.held.get_mut(name) {
                if held.rank < source.rank && now < held.until {
                    continue;
                }
                let (last_at, last) = held.last;
                if (held.is_handover || held.rank != source.rank) && !source.is_outside {
                    let reach = speed * now.saturating_since(last_at).as_secs_f64().min(LONGEST_STEP);
                    taken.is_handover = (position - last).abs() > reach;
                    taken.last.1 = position.clamp(last - reach, last + reach);
                }
                *held = taken;
            } else if self.held.len() <= MANY {
                self.held.insert(name.clone(), taken);
            }
            goals.name.push(name.clone());
            goals.position.push(taken.last.1);
            goals.velocity.extend(command.velocity.get(index));
            goals.effort.extend(command.effort.get(index));
        }
        (!goals.name.is_empty()).then_some(goals)
    }
}

/// More names than any robot has joints.
const MANY: usize = 1024;

/// The longest time for which a handover moves a joint at once, in s: a cycle of the hardware, and some
/// delay.
const LONGEST_STEP: f64 = 0.02;

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;
    use crate::testing::{Collector, core_at_zero};
    use downbeat_executor::Clock;

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
        outside.publish(command(&["head_pan"], &[0.15])).unwrap();
        assert_eq!(step(1), [0.15]);
        motion.publish(command(&["head_pan"], &[0.2])).unwrap();
        motion.publish(command(&["head_tilt"], &[0.3])).unwrap();
        assert_eq!(step(1990), [0.3]);
        motion.publish(command(&["head_pan"], &[0.2])).unwrap();
        assert_eq!(step(11), [0.2]);
    }

    #[test]
    fn a_command_with_a_stale_stamp_holds_no_joint() {
        let (mut core, clock) = core_at_zero();
        core.add("mux", JointCommandMux::default()).unwrap();
        let goals = Collector::<JointState>::add(&mut core, "joint_goals");
        let (outside, motion) =
            (core.inlet("joint_commands").unwrap(), core.inlet("motion/joint_commands").unwrap());
        for (offset, expected) in [(-10, 0.2), (10, 0.2), (0, 0.1)] {
            let mut stale = command(&["head_pan"], &[0.1]);
            stale.header.stamp.sec = (clock.now().as_nanos() / 1_000_000_000) as i32 + offset;
            outside.publish(stale).unwrap();
            clock.advance(Duration::from_millis(8));
            (0..3).for_each(|_| core.cycle().unwrap());
            motion.publish(command(&["head_pan"], &[0.2])).unwrap();
            clock.advance(Duration::from_millis(8));
            (0..3).for_each(|_| core.cycle().unwrap());
            assert_eq!(goals.take()[0].position, [expected], "{offset}");
        }
    }

    #[test]
    fn the_setting_sources_names_the_topics_in_their_order() {
        let (mut core, clock) = core_at_zero();
        let sources = vec!["walk".to_owned(), "play".to_owned()];
        let options = downbeat_executor::ModuleOptions {
            settings: [("sources".to_owned(), sources.into())].into(),
            ..Default::default()
        };
        core.add_with("mux", JointCommandMux::default(), options).unwrap();
        let goals = Collector::<JointState>::add(&mut core, "joint_goals");
        let (play, walk) = (core.inlet("play").unwrap(), core.inlet("walk").unwrap());
        clock.advance(Duration::from_millis(8));
        walk.publish(command(&["l_knee"], &[1.0])).unwrap();
        (0..2).for_each(|_| core.cycle().unwrap());
        play.publish(command(&["l_knee", "head_pan"], &[2.0, 3.0])).unwrap();
        (0..3).for_each(|_| core.cycle().unwrap());
        assert_eq!(goals.take(), [command(&["l_knee"], &[1.0]), command(&["head_pan"], &[3.0])]);
    }

    const HOLD: Duration = Duration::from_secs(2);
    const SPEED: f64 = 2.0;
    const FIRST: Source = Source { rank: 0, is_outside: false };
    const OUTER: Source = Source { rank: 1, is_outside: true };
    const LAST: Source = Source { rank: 2, is_outside: false };

    fn at(ms: i64) -> Time {
        Time::from_nanos(ms * 1_000_000)
    }

    #[test]
    fn a_source_with_less_precedence_commands_the_joints_that_are_free() {
        let mut joints = Joints::default();
        let all = command(&["pan", "tilt"], &[1.0, 2.0]);
        assert_eq!(joints.goals(&all, LAST, at(0), OWN_HOLD, SPEED), Some(all.clone()));
        joints.goals(&command(&["pan"], &[0.5]), OUTER, at(100), HOLD, SPEED);
        assert_eq!(joints.goals(&all, LAST, at(101), OWN_HOLD, SPEED), Some(command(&["tilt"], &[2.0])));
    }

    #[test]
    fn a_source_holds_its_joints_until_some_time_after_its_last_command() {
        let mut joints = Joints::default();
        let pan = command(&["pan"], &[0.5]);
        joints.goals(&pan, OUTER, at(0), HOLD, SPEED);
        joints.goals(&pan, OUTER, at(1500), HOLD, SPEED);
        assert_eq!(joints.goals(&pan, LAST, at(3499), OWN_HOLD, SPEED), None);
        assert_eq!(joints.goals(&pan, LAST, at(3500), OWN_HOLD, SPEED), Some(pan.clone()));
        assert_eq!(joints.goals(&pan, FIRST, at(3501), OWN_HOLD, SPEED), Some(pan.clone()));
        assert_eq!(joints.goals(&pan, OUTER, at(3502), HOLD, SPEED), None);
    }

    #[test]
    fn a_joint_does_not_jump_when_another_module_takes_it_over() {
        let mut joints = Joints::default();
        joints.goals(&command(&["pan"], &[0.0]), FIRST, at(0), OWN_HOLD, SPEED);
        let mut goals = Vec::new();
        for cycle in 0..5 {
            let goal = joints.goals(&command(&["pan"], &[0.05]), LAST, at(100 + 8 * cycle), OWN_HOLD, SPEED);
            goals.push((goal.unwrap().position[0] * 1e3).round());
        }
        assert_eq!(goals, [40.0, 50.0, 50.0, 50.0, 50.0]);
        let far = joints.goals(&command(&["pan"], &[1.0]), LAST, at(200), OWN_HOLD, SPEED);
        assert_eq!(far, Some(command(&["pan"], &[1.0])), "it has taken over");
    }

    #[test]
    fn a_nan_position_claims_no_joint() {
        let mut joints = Joints::default();
        assert_eq!(joints.goals(&command(&["pan", "tilt"], &[f64::NAN]), OUTER, at(0), HOLD, SPEED), None);
        assert_eq!(joints, Joints::default());
    }

    #[test]
    fn velocities_and_efforts_stay_with_their_joints() {
        let mut joints = Joints::default();
        joints.goals(&command(&["a"], &[0.0]), FIRST, at(0), HOLD, SPEED);
        let motion = JointState { velocity: vec![1.0, 2.0], ..command(&["a", "b"], &[3.0, 4.0]) };
        let goals = joints.goals(&motion, LAST, at(1), OWN_HOLD, SPEED);
        assert_eq!(goals, Some(JointState { velocity: vec![2.0], ..command(&["b"], &[4.0]) }));
    }

    #[test]
    fn invented_names_do_not_fill_the_memory() {
        let mut joints = Joints::default();
        for number in 0..10_000 {
            joints.goals(&command(&[&format!("joint{number}")], &[0.0]), OUTER, at(number), HOLD, SPEED);
        }
        assert!(joints.held.len() <= MANY + 1);
    }
}
