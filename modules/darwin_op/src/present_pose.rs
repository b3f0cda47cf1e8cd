//! Where the joints of the robot are, and where they were sent: the start of a motion.

use crate::hardware::tables::joints::{COUNT, JOINTS, index_of};
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::Header;
use std::time::Duration;

/// Tracks measured positions and goals of all joints, in the order of the ids.
#[derive(Clone, Debug, Default)]
pub(crate) struct PresentPose {
    measured: [Option<f64>; COUNT],
    /// In rad, and when they were sent.
    goals: [Option<(f64, Time)>; COUNT],
}

/// For how long a goal counts: a joint without newer commands may have been moved by hand.
const RECENT: Duration = Duration::from_millis(500);

/// How far a joint may be from its goal because of its load, in rad.
const SAG: f64 = 0.35;

impl PresentPose {
    /// Takes measured positions.
    pub(crate) fn take_states(&mut self, states: &JointState) {
        for (index, position) in positions(states) {
            self.measured[index] = Some(position);
        }
    }

    /// Takes goals that were sent to the joints.
    pub(crate) fn take_goals(&mut self, goals: &JointState, now: Time) {
        for (index, position) in positions(goals) {
            self.goals[index] = Some((position, now));
        }
    }

    /// Returns true once a joint was measured.
    pub(crate) fn is_known(&self) -> bool {
        self.measured.iter().any(Option::is_some)
    }

    /// The measured positions, with those of `unknown` for joints that were never measured.
    pub(crate) fn measured(&self, unknown: &[f64; COUNT]) -> [f64; COUNT] {
        std::array::from_fn(|index| self.measured[index].unwrap_or(unknown[index]))
    }

    /// From where a motion starts without a jump of any goal: from recent goals that the joints follow,
    /// otherwise from measured positions.
    pub(crate) fn start(&self, now: Time, unknown: &[f64; COUNT]) -> [f64; COUNT] {
        let measured = self.measured(unknown);
        std::array::from_fn(|index| match self.goals[index] {
            Some((goal, at)) if now < at + RECENT && (goal - measured[index]).abs() < SAG => goal,
            _ => measured[index],
        })
    }
}

/// The walking-ready stand.
pub(crate) fn stand() -> [f64; COUNT] {
    JOINTS.map(|joint| crate::hardware::tables::units::radians_from_ticks(joint.walking_ready_ticks, 0))
}

/// A command for the joints of which `is_meant` is true.
pub(crate) fn command(now: Time, pose: &[f64; COUNT], is_meant: impl Fn(usize) -> bool) -> JointState {
    let stamp = builtin_interfaces::msg::Time::from_nanos(now.as_nanos());
    let mut message =
        JointState { header: Header { stamp, frame_id: String::new() }, ..JointState::default() };
    for (index, position) in pose.iter().enumerate().filter(|(index, _)| is_meant(*index)) {
        message.name.push(JOINTS[index].name.to_owned());
        message.position.push(*position);
    }
    message
}

/// The known joints of a message with their positions.
fn positions(message: &JointState) -> impl Iterator<Item = (usize, f64)> {
    let named = message.name.iter().zip(&message.position).enumerate();
    named.filter(|(_, (_, position))| position.is_finite()).filter_map(|(place, (name, position))| {
        // Most messages have all joints in the order of the ids.
        let is_in_order = JOINTS.get(place).is_some_and(|joint| joint.name == name);
        let index = if is_in_order { place } else { index_of(name)? };
        Some((index, *position))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn state(names: &[&str], positions: &[f64]) -> JointState {
        JointState {
            name: names.iter().map(ToString::to_string).collect(),
            position: positions.into(),
            ..JointState::default()
        }
    }

    #[test]
    fn a_motion_starts_at_recent_goals_that_the_joints_follow() {
        let at = |ms: i64| Time::from_nanos(ms * 1_000_000);
        let mut pose = PresentPose::default();
        assert!(!pose.is_known());
        pose.take_states(&state(&["r_sho_pitch", "head_pan", "l_el"], &[0.1, 0.2, 0.3]));
        pose.take_states(&state(&["l_el"], &[f64::NAN]));
        pose.take_goals(&state(&["r_sho_pitch", "head_pan"], &[0.15, 1.5]), at(100));
        let found = |now: Time| {
            let start = pose.start(now, &[9.0; COUNT]);
            [start[0], start[18], start[5], start[1]]
        };
        assert_eq!(found(at(200)), [0.15, 0.2, 0.3, 9.0]);
        assert_eq!(found(at(600)), [0.1, 0.2, 0.3, 9.0]);
    }
}
