//! The kinds of modules that this package offers to robot files.

use downbeat_executor::Synchrony;
use downbeat_kind::Kind;

use crate::controllers::diff_drive::DiffDriveController;
use crate::controllers::forward_command::ForwardCommandController;
use crate::controllers::joint_trajectory::JointTrajectoryController;
use crate::joint_command_mux::JointCommandMux;
use crate::servo_bus::ServoBus;
use crate::servo_bus::bus::RecordedBus;
use crate::servo_emulator::{MemoryPorts, ServoEmulator};
use crate::teleoperation::EPISODES_PANEL;
use crate::teleoperation::episodes::Episodes;
use crate::teleoperation::leader_arm::LeaderArm;

/// The kinds, whose hardware and emulators meet at these ports.
#[must_use]
pub fn kinds(ports: &MemoryPorts) -> Vec<Kind> {
    let (of_servos, of_servo_emulator) = (ports.clone(), ports.clone());
    vec![
        Kind::new(
            "diff_drive",
            "drives a base with wheels on two sides by cmd_vel, with odometry",
            DiffDriveController::default,
        )
        .claiming_joints(),
        Kind::new(
            "episodes",
            "says where demonstrations for a robot that learns begin and end",
            Episodes::default,
        )
        .with_panel("Episodes", EPISODES_PANEL, &["episodes"]),
        Kind::new(
            "forward_command",
            "passes positions, velocities or efforts on to joints",
            ForwardCommandController::default,
        )
        .claiming_joints(),
        Kind::new(
            "joint_command_mux",
            "which of several commands a joint gets, by the order of their sources",
            JointCommandMux::default,
        ),
        Kind::new(
            "joint_trajectory",
            "follows trajectories of joints: the action FollowJointTrajectory",
            JointTrajectoryController::default,
        )
        .claiming_joints(),
        Kind::new("leader_arm", "lets an arm follow another one that a hand moves", LeaderArm::default),
        Kind::new(
            "servo_bus",
            "the hardware of a robot of serial servos, Dynamixel or Feetech, as a file describes it",
            move || ServoBus::new(Box::new(of_servos.bus())),
        )
        .with_files(&["description"])
        .drives_device()
        .detached()
        .replayed_on("bus/exchanges", |messages| {
            Ok(ServoBus::new(Box::new(RecordedBus::of_messages(messages)?)))
        }),
        Kind::new(
            "servo_emulator",
            "emulated servos of such a file behind a pseudo terminal, with faults on request",
            move || ServoEmulator::new(of_servo_emulator.clone()),
        )
        .with_files(&["description"])
        .drives_device()
        .emulated()
        .with_synchrony(Synchrony::WhenDue),
    ]
}
