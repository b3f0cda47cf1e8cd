//! Where the joints of the robot are, and where they were sent: the start of a motion.

use crate::humanoid::Humanoid;
use crate::joints::Joints;
use downbeat_executor::Time;
use downbeat_msgs::builtin_interfaces;
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::Header;
use std::sync::Arc;
use std::time::Duration;

/// Tracks measured positions and goals of all joints of a robot.
#[derive(Clone, Debug)]
pub(crate) struct PresentPose {
    joints: Arc<Joints>,
    measured: Vec<Option<f64>>,
    /// In rad, and when they were sent.
    goals: Vec<Option<(f64, Time)>>,
}

/// For how long a goal counts: a joint without newer commands may have been moved by hand.
const RECENT: Duration = Duration::from_millis(500);

/// How far a joint may be from its goal because of its load, in rad.
const SAG: f64 = 0.35;

impl Default for PresentPose {
    fn default() -> Self {
        Self::new(Arc::clone(Humanoid::darwin_op().joints()))
    }
}

impl PresentPose {
    pub(crate) fn new(joints: Arc<Joints>) -> Self {
        let count = joints.len();
        Self { joints, measured: vec![None; count], goals: vec![None; count] }
    }

    /// The joints of the robot.
    pub(crate) fn joints(&self) -> &Arc<Joints> {
        &self.joints
    }

    /// Takes measured positions.
    pub(crate) fn take_states(&mut self, states: &JointState) {
        for (index, position) in positions(&self.joints, states) {
            self.measured[index] = Some(position);
        }
    }

    /// Takes goals that were sent to the joints.
    pub(crate) fn take_goals(&mut self, goals: &JointState, now: Time) {
        for (index, position) in positions(&self.joints, goals) {
            self.goals[index] = Some((position, now));
        }
    }

    /// Returns true once a joint was measured.
    pub(crate) fn is_known(&self) -> bool {
        self.measured.iter().any(Option::is_some)
    }

    /// The measured positions, with those of `unknown` for joints that were never measured.
    pub(crate) fn measured(&self, unknown: &[f64]) -> Vec<f64> {
        self.measured.iter().zip(unknown).map(|(measured, unknown)| measured.unwrap_or(*unknown)).collect()
    }

    /// The measured positions, with those of the stand for joints that were never measured.
    pub(crate) fn measured_or_stand(&self) -> Vec<f64> {
        let joints = self.measured.iter().zip(self.joints.iter());
        joints.map(|(measured, joint)| measured.unwrap_or(joint.stand)).collect()
    }

    /// From where a motion starts without a jump of any goal: from recent goals that the joints follow,
    /// otherwise from measured positions, or from those of the stand if there is none.
    pub(crate) fn start(&self, now: Time) -> Vec<f64> {
        let mut start = self.measured_or_stand();
        for (position, goal) in start.iter_mut().zip(&self.goals) {
            match goal {
                Some((goal, at)) if now < *at + RECENT && (goal - *position).abs() < SAG => *position = *goal,
                _ => {}
            }
        }
        start
    }
}

/// A command for the joints of which `is_meant` is true.
pub(crate) fn command(
    now: Time,
    joints: &Joints,
    pose: &[f64],
    is_meant: impl Fn(usize) -> bool,
) -> JointState {
    let stamp = builtin_interfaces::msg::Time::from_nanos(now.as_nanos());
    let mut message =
        JointState { header: Header { stamp, frame_id: String::new() }, ..JointState::default() };
    let joints = joints.iter().zip(pose).enumerate();
    for (_, (joint, position)) in joints.filter(|(index, _)| is_meant(*index)) {
        message.name.push(joint.name.clone());
        message.position.push(*position);
    }
    message
}

/// The known joints of a message with their positions.
fn positions(joints: &Joints, message: &JointState) -> impl Iterator<Item = (usize, f64)> {
    let named = message.name.iter().zip(&message.position).enumerate();
    named.filter(|(_, (_, position))| position.is_finite()).filter_map(|(place, (name, position))| {
        // Most messages have all joints in the order of the robot.
        let is_in_order = joints.get(place).is_some_and(|joint| joint.name == *name);
        let index = if is_in_order { place } else { joints.index_of(name)? };
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
        let stand = pose.joints()[1].stand;
        let found = |now: Time| {
            let start = pose.start(now);
            [start[0], start[18], start[5], start[1]]
        };
        assert_eq!(found(at(200)), [0.15, 0.2, 0.3, stand]);
        assert_eq!(found(at(600)), [0.1, 0.2, 0.3, stand]);
    }
}
