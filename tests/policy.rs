//! A simulated robot that a network moves, recorded and replayed.
#![cfg(all(feature = "physics", feature = "policy"))]
#![allow(clippy::unwrap_used, missing_docs)]

#[allow(dead_code)]
#[path = "../modules/policy/tests/policy/onnx.rs"]
mod onnx;

use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use downbeat::App;
use downbeat::bags::{Reader, Selection};
use downbeat::executor::{Context, Module, Publication, Setup, SetupError};
use downbeat::msgs::cdr;
use downbeat::msgs::geometry_msgs::msg::Vector3Stamped;
use downbeat::msgs::nav_msgs::msg::Odometry;
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

fn run(prepared: PreparedRobot) {
    let running = prepared.start().unwrap();
    let watchdog = Instant::now() + Duration::from_secs(300);
    while !running.is_finished() {
        assert!(Instant::now() < watchdog, "a few simulated seconds took five minutes");
        std::thread::sleep(Duration::from_millis(5));
    }
    running.stop().unwrap();
}

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
    run(prepared);

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

/// Pushes the robot once, and keeps how upright it is.
struct Push {
    impulse: [f64; 2],
    ticks: u32,
    /// The part of the trunk's upward axis that points up.
    upright: Arc<Mutex<f64>>,
}

impl Module for Push {
    type Ports = Publication<Vector3Stamped>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        setup.subscribe::<Odometry, _>("ground_truth/odom", |push, odom, _| {
            let q = odom.pose.pose.orientation;
            *push.upright.lock().unwrap() = 1.0 - 2.0 * (q.x * q.x + q.y * q.y);
        })?;
        setup.every(Duration::from_millis(100), Self::tick)?;
        setup.publish("push")
    }
}

impl Push {
    fn tick(&mut self, ctx: &mut Context<'_, Publication<Vector3Stamped>>) {
        self.ticks += 1;
        if self.ticks == 15 {
            let mut push = Vector3Stamped::default();
            push.header.frame_id = "torso".to_owned();
            [push.vector.x, push.vector.y] = self.impulse;
            ctx.publish(*ctx.ports, push);
        }
    }
}

/// Whether a robot stands two seconds after a push.
fn survives(robot: &Path, impulse: [f64; 2], world: &str) -> bool {
    let text = std::fs::read_to_string(robot).unwrap();
    let text = text.replace("link = \"memory:darwin_op\"", &format!("link = \"memory:darwin_op\", {world}"));
    let pushed = robot.with_file_name("pushed.toml");
    std::fs::write(&pushed, text + "[[module]]\nkind = \"push\"\n").unwrap();
    let upright = Arc::new(Mutex::new(0.0));
    let of_module = upright.clone();
    let push = move || Push { impulse, ticks: 0, upright: of_module.clone() };
    let file = App::with_built_in_kinds().kind("push", "a push", push).robot_file(&pushed).unwrap();
    let prepared = PreparedRobot::simulated(file, Some(Duration::from_millis(3500))).unwrap();
    run(prepared);
    let upright = *upright.lock().unwrap();
    upright > 0.6
}

#[test]
fn the_example_balances_better_than_a_network_of_zeros_against_twenty_pushes() {
    let example = Path::new(env!("CARGO_MANIFEST_DIR")).join("modules/policy/examples/balance");
    let folder = tempfile::tempdir().unwrap();
    let robots = ["balance", "zeros"].map(|name| {
        let copy = folder.path().join(name);
        std::fs::create_dir(&copy).unwrap();
        for file in ["robot.toml", "balance.toml", "balance.onnx"] {
            std::fs::copy(example.join(file), copy.join(file)).unwrap();
        }
        copy.join("robot.toml")
    });
    let zeros = onnx::perceptron(&[19, 14], "Tanh", || 0.0);
    std::fs::write(robots[1].with_file_name("balance.onnx"), zeros).unwrap();
    let mut survived = [0; 2];
    // None of those that it was trained with: directions all around, each by the golden angle from the last.
    const GOLDEN: [f64; 2] = [-0.737_369, 0.675_490]; // its cosine and sine
    let [mut x, mut y] = [1.0, 0.0];
    for seed in 1..=20 {
        [x, y] = [x * GOLDEN[0] - y * GOLDEN[1], x * GOLDEN[1] + y * GOLDEN[0]];
        let part = f64::from(seed * 7 % 20) / 20.0;
        let world = format!("seed = {seed}, mass = {}, friction = {}", 0.9 + part / 5.0, 1.2 - part / 3.0);
        let impulse = 0.6 + 0.9 * part;
        for (robot, survived) in robots.iter().zip(&mut survived) {
            *survived += u32::from(survives(robot, [impulse * x, impulse * y], &world));
        }
    }
    println!("survived of 20 pushes: {} with the example's network, {} with zeros", survived[0], survived[1]);
    assert!(survived[0] > survived[1], "{survived:?}");
}
