//! A small motion of the Darwin OP: it stands up from any position, then nods and waves repeatedly.
//!
//! | topic | type | |
//! | --- | --- | --- |
//! | `joint_states` (in) | `sensor_msgs/JointState` | the start of the motion: only the first message is used |
//! | `motion/joint_commands` | `sensor_msgs/JointState` | positions of all 20 joints, rad, at 125 Hz |
//!
//! The setting `stand_s` is the duration of standing up in s.
//!
//! Never tested on a real robot: nothing checks for collisions of the arm with the body, or for balance.
//!
//! # Motion
//! The trajectory from one pose to the next has minimum jerk: with s from 0 to 1 over the duration of a step,
//! the fraction of the trajectory is
//!
//! (1)  10 s^3 - 15 s^4 + 6 s^5
//!
//! It starts and ends at rest. It uses only additions and multiplications, so it is the same on every
//! machine.
//!
//! # References
//! T. Flash, N. Hogan, "The coordination of arm movements", Journal of Neuroscience 5 (1985), for (1).

use crate::hardware::CYCLE;
use crate::hardware::tables::joints::{COUNT, JOINTS, index_of};
use crate::hardware::tables::units::radians_from_ticks;
use downbeat_executor::{Context, Module, Publication, Received, Setting, Setup, SetupError, Time};
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_servos::step::standstill;
use std::f64::consts::PI;
use std::time::Duration;

/// Stands up, then nods and waves; see the [module page](self).
#[derive(Debug, Default)]
pub struct StandNodWave {
    /// The start time and pose of the motion.
    begun: Option<(Time, Pose)>,
    last_tick: Option<Time>,
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
        let Some((begun, start)) = &mut self.begun else { return };
        let now = ctx.now();
        *begun = *begun + standstill(self.last_tick.replace(now).unwrap_or(now), now);
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

    fn debug(&self) -> Option<&dyn std::fmt::Debug> {
        Some(self)
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

/// Angles of all joints in the order of their ids, in rad.
type Pose = [f64; COUNT];

/// Servo ids of the moving joints.
const R_SHO_PITCH: usize = 1;
const R_SHO_ROLL: usize = 3;
const R_ELBOW: usize = 5;
const HEAD_TILT: usize = 20;

/// The repeated steps after standing up: duration, and the joints that differ from the stand, in degrees.
const STEPS: [(Duration, &[(usize, f64)]); 12] = [
    // Nod.
    (Duration::from_millis(500), &[(HEAD_TILT, -15.0)]),
    (Duration::from_millis(500), &[(HEAD_TILT, 25.0)]),
    (Duration::from_millis(500), &[(HEAD_TILT, -15.0)]),
    (Duration::from_millis(500), &[]),
    // Raise the right arm, wave, lower it.
    (Duration::from_millis(2000), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0), (R_SHO_ROLL, 20.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0), (R_SHO_ROLL, -20.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0), (R_SHO_ROLL, 20.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0), (R_SHO_ROLL, -20.0)]),
    (Duration::from_millis(400), &[(R_SHO_PITCH, 130.0), (R_ELBOW, -40.0)]),
    (Duration::from_millis(2000), &[]),
    (Duration::from_millis(1000), &[]),
];

/// The walking-ready stand.
fn stand() -> Pose {
    JOINTS.map(|joint| radians_from_ticks(joint.walking_ready_ticks, 0))
}

/// The pose at `elapsed` after the motion started at `start`.
fn pose(start: &Pose, standing_up: Duration, elapsed: Duration) -> Pose {
    if elapsed < standing_up {
        return between(start, &stand(), elapsed, standing_up);
    }
    let round: Duration = STEPS.iter().map(|(time, _)| *time).sum();
    let since = (elapsed - standing_up).as_nanos() % round.as_nanos();
    // Less than a round, so it fits.
    let mut left = Duration::from_nanos(since as u64);
    let mut from = stand();
    for (time, changes) in STEPS {
        let to = changed(changes);
        if left < time {
            return between(&from, &to, left, time);
        }
        left -= time;
        from = to;
    }
    from
}

fn changed(changes: &[(usize, f64)]) -> Pose {
    let mut pose = stand();
    for &(id, degrees) in changes {
        pose[id - 1] = degrees * (PI / 180.0);
    }
    pose
}

fn between(from: &Pose, to: &Pose, elapsed: Duration, time: Duration) -> Pose {
    let s = elapsed.as_secs_f64() / time.as_secs_f64();
    let share = s * s * s * (10.0 + s * (-15.0 + s * 6.0));
    std::array::from_fn(|joint| from[joint] + (to[joint] - from[joint]) * share)
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
    fn a_clock_that_is_set_ahead_moves_nothing_at_once() {
        let (mut core, clock) = core_at_zero();
        core.add("motion", StandNodWave::default()).unwrap();
        let commands = Collector::<JointState>::add(&mut core, "motion/joint_commands");
        let states = core.inlet("joint_states").unwrap();
        let bent = JointState { name: vec!["r_el".into()], position: vec![-1.0], ..JointState::default() };
        states.publish(bent).unwrap();
        let elbow = index_of("r_el").unwrap();
        let mut last: Option<f64> = None;
        for cycle in 0..300 {
            let is_set = cycle == 100;
            clock.advance(if is_set { Duration::from_secs(1_000_000_000) } else { CYCLE });
            core.cycle().unwrap();
            for command in commands.take() {
                let angle = command.position[elbow];
                assert!(last.is_none_or(|last| (angle - last).abs() < 0.02), "{last:?} to {angle}");
                last = Some(angle);
            }
        }
        assert!(last.is_some_and(|last| last > -0.9), "it goes on: {last:?}");
    }

    #[test]
    fn an_unknown_joint_does_not_move() {
        let state =
            JointState { name: vec!["r_el".into()], position: vec![f64::NAN], ..JointState::default() };
        assert_eq!(start_of(&state), stand());
    }

    const STANDING_UP: Duration = Duration::from_secs(3);
    const CYCLE: Duration = Duration::from_millis(8);

    #[test]
    fn it_starts_at_the_robots_pose_and_reaches_the_stand() {
        let start = [0.3; COUNT];
        assert_eq!(pose(&start, STANDING_UP, Duration::ZERO), start);
        assert_eq!(pose(&start, STANDING_UP, STANDING_UP), stand());
    }

    #[test]
    fn no_joint_exceeds_the_servo_speed_or_its_limits() {
        let start = [0.0; COUNT];
        let mut last = start;
        for cycle in 1..2500 {
            let now = pose(&start, STANDING_UP, CYCLE * cycle);
            for (index, joint) in JOINTS.iter().enumerate() {
                let speed = (now[index] - last[index]).abs() / CYCLE.as_secs_f64();
                assert!(speed < 5.0, "{} goes {speed} rad/s in cycle {cycle}", joint.name);
                assert!((joint.min_rad()..=joint.max_rad()).contains(&now[index]), "{}", joint.name);
            }
            last = now;
        }
    }

    #[test]
    fn it_nods_and_waves_forever_without_moving_the_legs() {
        let at = |seconds: u64| pose(&stand(), STANDING_UP, Duration::from_secs(seconds));
        let round: Duration = STEPS.iter().map(|(time, _)| *time).sum();
        let late = Duration::from_secs(4) + round * 1000;
        assert_eq!(pose(&stand(), STANDING_UP, late), at(4));
        let moved = |id: usize| {
            (0..200).any(|step| {
                let now = pose(&stand(), STANDING_UP, Duration::from_millis(3000 + 50 * step));
                now[id - 1] != stand()[id - 1]
            })
        };
        assert!(moved(HEAD_TILT) && moved(R_SHO_PITCH) && moved(R_SHO_ROLL) && moved(R_ELBOW));
        assert!(!(7..=18).any(moved));
    }
}
