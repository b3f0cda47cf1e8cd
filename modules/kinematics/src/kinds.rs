//! The kinds of modules that this package offers to robot files.

use downbeat_kind::Kind;

use crate::joint_state_merger::JointStateMerger;
use crate::module::Kinematics;
use crate::robot_state_publisher::RobotStatePublisher;

/// The kinds.
#[must_use]
pub fn kinds() -> Vec<Kind> {
    vec![
        Kind::new(
            "joint_state_merger",
            "joint_states of several buses as one message",
            JointStateMerger::default,
        )
        .with_files(&["robot_description"]),
        Kind::new(
            "kinematics",
            "services for poses of links, inverse kinematics, where the camera looks; the centre of mass",
            Kinematics::default,
        )
        .with_files(&["robot_description"]),
        Kind::new(
            "robot_state_publisher",
            "tf, tf_static and robot_description, from a URDF and joint_states",
            RobotStatePublisher::default,
        )
        .with_files(&["robot_description"]),
    ]
}
