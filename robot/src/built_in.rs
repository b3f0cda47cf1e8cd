//! The kinds of modules that every program has; those of features are in `feature_kinds.rs`.

use std::time::Duration;

use downbeat_darwin_op::emulator::{DarwinOpEmulator, MemoryPorts};
use downbeat_darwin_op::falls::Falls;
use downbeat_darwin_op::gait::Gait;
use downbeat_darwin_op::hardware::DarwinOp;
use downbeat_darwin_op::motions::MotionPlayer;
use downbeat_darwin_op::stand_nod_wave::StandNodWave;
use downbeat_executor::{SettingValue, Synchrony};
use downbeat_imu_filter::ImuFilter;
use downbeat_kinematics::Kinematics;
use downbeat_kinematics::joint_state_merger::JointStateMerger;
use downbeat_kinematics::robot_state_publisher::RobotStatePublisher;
use downbeat_library_host::LibraryOptions;
use downbeat_msgs::downbeat_interfaces::msg::BusExchange;
use downbeat_servos::controllers::diff_drive::DiffDriveController;
use downbeat_servos::controllers::forward_command::ForwardCommandController;
use downbeat_servos::controllers::joint_trajectory::JointTrajectoryController;
use downbeat_servos::joint_command_mux::JointCommandMux;
use downbeat_servos::servo_bus::ServoBus;
use downbeat_servos::servo_bus::bus::{Bus, Exchange, RecordedBus};
use downbeat_servos::servo_emulator::ServoEmulator;
use downbeat_transforms::transform_server::TransformServer;

use crate::feature_kinds::of_features;
use crate::kind::Kind;
use crate::versions::ModuleSource;

pub(crate) fn kinds() -> Vec<Kind> {
    // Emulators and hardware modules of one catalog meet here.
    let ports = MemoryPorts::default();
    let [of_hardware, of_emulator, of_servos, of_servo_emulator] = std::array::from_fn(|_| ports.clone());
    let mut kinds = vec![
        Kind::new(
            "darwin_op",
            "the hardware of a Darwin OP: CM-730 and 20 MX-28 servos on a serial port",
            move || DarwinOp::new(Box::new(of_hardware.bus())),
        )
        .drives_device()
        .detached()
        .replayed_on("bus/exchanges", |messages| Ok(DarwinOp::new(recorded_bus(messages)?))),
        Kind::new(
            "darwin_op_emulator",
            "an emulated Darwin OP behind a pseudo terminal, with faults on request",
            move || DarwinOpEmulator::new(of_emulator.clone()),
        )
        .drives_device()
        .emulated()
        .with_synchrony(Synchrony::WhenDue),
        Kind::new(
            "diff_drive",
            "drives a base with wheels on two sides by cmd_vel, with odometry",
            DiffDriveController::default,
        )
        .claiming_joints(),
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
            "joint_state_merger",
            "joint_states of several buses as one message",
            JointStateMerger::default,
        )
        .with_files(&["robot_description"]),
        Kind::new(
            "joint_trajectory",
            "follows trajectories of joints: the action FollowJointTrajectory",
            JointTrajectoryController::default,
        )
        .claiming_joints(),
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
        Kind::foreign(
            "library",
            "a module in C, C++ or Rust: a shared library (docs/libraries.md)",
            [&["path"], &["reload", "isolate", "time_limit"]],
            |source| downbeat_library_host::load(&library(source)?),
            |source| library(source).map(|options| vec![options.path]).unwrap_or_default(),
        )
        .with_synchrony(Synchrony::WhenDue),
        Kind::new("imu_filter", "orientation from gyroscope and accelerometer", ImuFilter::default),
        Kind::new("gait", "walks with the velocity on cmd_vel, and publishes odometry", Gait::default)
            .with_files(&["humanoid"]),
        Kind::new("motions", "key-frame motions by name: get up, kick, wave", MotionPlayer::default)
            .with_files(&["file", "humanoid"]),
        Kind::new("falls", "detects falls, goes limp, and gets up", Falls::default).with_files(&["humanoid"]),
        Kind::new(
            "servo_bus",
            "the hardware of a robot of serial servos, Dynamixel or Feetech, as a file describes it",
            move || ServoBus::new(Box::new(of_servos.bus())),
        )
        .with_files(&["description"])
        .drives_device()
        .detached()
        .replayed_on("bus/exchanges", |messages| Ok(ServoBus::new(recorded_bus(messages)?))),
        Kind::new(
            "servo_emulator",
            "emulated servos of such a file behind a pseudo terminal, with faults on request",
            move || ServoEmulator::new(of_servo_emulator.clone()),
        )
        .with_files(&["description"])
        .drives_device()
        .emulated()
        .with_synchrony(Synchrony::WhenDue),
        Kind::new("stand_nod_wave", "a small motion: stand up, then nod and wave", StandNodWave::default),
        Kind::new(
            "transform_server",
            "the action tf2_buffer_server: lookups of transforms, for clients without a transform buffer",
            TransformServer::default,
        ),
    ];
    kinds.extend(of_features(&ports));
    kinds
}

/// Reads the keys of a module in a shared library.
fn library(source: &ModuleSource) -> Result<LibraryOptions, String> {
    let Some(SettingValue::Text(path)) = source.keys.get("path") else {
        return Err("`path` is the file of the library, such as \"libfoo.so\"".to_owned());
    };
    Ok(LibraryOptions {
        module: source.module.clone(),
        path: source.file_to_read(&source.folder.join(path)),
        is_reloaded: source.is_set("reload", false)?,
        is_isolated: source.is_set("isolate", false)?,
        time_limit: match source.keys.get("time_limit") {
            // A module that may run for longer is not killed before that is reported.
            None => source.deadline.unwrap_or_default().max(LibraryOptions::TIME_LIMIT),
            Some(SettingValue::Text(text)) => time_limit(text)?,
            Some(other) => {
                return Err(format!("`time_limit` is a time with its unit, such as \"500ms\", not {other}"));
            }
        },
    })
}

fn time_limit(text: &str) -> Result<Duration, String> {
    match downbeat_files::duration::parse(text) {
        Ok(limit) if !limit.is_zero() => Ok(limit),
        Ok(_) => Err("`time_limit` has to be above 0".to_owned()),
        Err(problem) => Err(format!("`time_limit`: {problem}")),
    }
}

fn recorded_bus(messages: Vec<BusExchange>) -> Result<Box<dyn Bus>, String> {
    let exchanges =
        messages.into_iter().map(|message| Exchange::try_from(message).map_err(|error| error.to_string()));
    let (bus, _) = RecordedBus::new(exchanges.collect::<Result<Vec<_>, String>>()?);
    Ok(Box::new(bus))
}
