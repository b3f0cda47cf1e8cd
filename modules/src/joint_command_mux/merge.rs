//! Decides which joints are commanded from outside.

use downbeat_executor::Time;
use downbeat_msgs::sensor_msgs::msg::JointState;
use std::collections::BTreeMap;
use std::time::Duration;

/// Tracks which joints are commanded from outside.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Merge {
    /// When each joint was last commanded from outside.
    outside: BTreeMap<String, Time>,
}

impl Merge {
    /// Notes a command from outside for the joints it names.
    pub(super) fn note_outside(&mut self, command: &JointState, now: Time) {
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
    pub(super) fn filter_motion(
        &mut self,
        command: &JointState,
        now: Time,
        hold: Duration,
    ) -> Option<JointState> {
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
    use super::*;

    const HOLD: Duration = Duration::from_secs(2);

    fn command(names: &[&str], positions: &[f64]) -> JointState {
        JointState {
            name: names.iter().map(|name| (*name).to_owned()).collect(),
            position: positions.to_vec(),
            ..JointState::default()
        }
    }

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
