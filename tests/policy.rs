//! A simulated robot that a network moves, recorded and replayed.
#![cfg(all(feature = "physics", feature = "policy"))]
#![allow(clippy::unwrap_used, missing_docs)]

#[allow(dead_code)]
#[path = "../modules/policy/tests/policy/onnx.rs"]
mod onnx;

use std::time::{Duration, Instant};

use downbeat::App;
use downbeat::bags::{Reader, Selection};
use downbeat::msgs::cdr;
use downbeat::msgs::sensor_msgs::msg::JointState;
use downbeat::replay::{ReplayOptions, Simulators, replay};
use downbeat::running::{PreparedRobot, RecordPlan};

const ROBOT: &str = r#"
[robot]
name = "darwin_op"
[[module]]
name = "simulator"
kind = "darwin_op_simulator"
settings = { link = "memory:darwin_op" }
[[module]]
name = "hardware"
kind = "darwin_op"
settings = { port = "memory:darwin_op" }
[[module]]
kind = "imu_filter"
[[module]]
name = "look"
kind = "policy"
file = "look.toml"
deadline = "20ms"
[expose]
diagnostics = false
[record]
topics = "all"
"#;

/// The head goes to where the network says, which sees the trunk and the head.
const POLICY: &str = r#"
network = "look.onnx"
rate_hz = 62.5
[[input]]
values = [
    { gravity = true },
    { topic = "imu/data", type = "sensor_msgs/msg/Imu", fields = ["angular_velocity.y", "angular_velocity.z"] },
    { joints = ["head_pan", "head_tilt"] },
    { previous = "action" },
]
[[output]]
values = [{ joints = ["head_pan", "head_tilt"], scale = 0.5, limits = [-0.4, 0.4] }]
"#;

#[test]
fn a_robot_that_a_network_moves_replays_bit_for_bit_under_each_launcher() {
    let folder = tempfile::tempdir().unwrap();
    let [robot, policy, network, bag] =
        ["robot.toml", "look.toml", "look.onnx", "bag"].map(|name| folder.path().join(name));
    std::fs::write(&robot, ROBOT).unwrap();
    std::fs::write(policy, POLICY).unwrap();
    let mut number = 0.0_f32;
    let weights = || {
        number = (number * 5.0 + 0.3).fract();
        number - 0.5
    };
    std::fs::write(&network, onnx::perceptron(&[9, 16, 2], "Tanh", weights)).unwrap();

    let file = App::with_built_in_kinds().robot_file(&robot).unwrap();
    let mut prepared = PreparedRobot::simulated(file, Some(Duration::from_secs(2))).unwrap();
    let plan = RecordPlan::of_robot(&bag, prepared.file(), None);
    prepared.record(plan).unwrap();
    let running = prepared.start().unwrap();
    let watchdog = Instant::now() + Duration::from_secs(300);
    while !running.is_finished() {
        assert!(Instant::now() < watchdog, "two simulated seconds took five minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
    running.stop().unwrap();

    let reader = Reader::open(&bag).unwrap();
    let of = |topic: &str| {
        let selection = Selection::all().topics([reader.topic(topic).unwrap()]);
        let messages = reader.messages(selection).unwrap();
        messages
            .map(|message| cdr::from_slice::<JointState>(&message.unwrap().data).unwrap())
            .collect::<Vec<_>>()
    };
    let commands = of("/joint_commands");
    assert!((80..=130).contains(&commands.len()), "{} commands in two seconds", commands.len());
    let last = commands.last().unwrap();
    assert_eq!(last.name, ["head_pan", "head_tilt"]);
    assert!(last.position.iter().any(|angle| angle.abs() > 0.02), "{:?}", last.position);
    let head = of("/joint_states").pop().unwrap();
    let pan = head.name.iter().position(|name| name == "head_pan").unwrap();
    assert!((head.position[pan] - last.position[0]).abs() < 0.1, "the head follows");

    let options = ReplayOptions { simulators: Simulators::RunAgain, ..ReplayOptions::default() };
    for launcher in ["linear", "pool"] {
        let mut file = App::with_built_in_kinds().robot_file(&robot).unwrap();
        file.launcher.choice = launcher.parse().unwrap();
        let report = replay(file, &Reader::open(&bag).unwrap(), &options).unwrap();
        assert!(report.modules.iter().any(|module| module == "look"), "{:?}", report.modules);
        report.assert_same().unwrap();
    }
    // With another network it is another run.
    std::fs::write(&network, onnx::perceptron(&[9, 16, 2], "Tanh", || 0.1)).unwrap();
    let file = App::with_built_in_kinds().robot_file(&robot).unwrap();
    let report = replay(file, &Reader::open(&bag).unwrap(), &options).unwrap();
    assert!(report.assert_same().is_err());
}
