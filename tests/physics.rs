//! A simulated robot from a robot file.
#![cfg(feature = "physics")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::Running;
use common::rclpy::Peer;
use downbeat::App;
use downbeat::bags::{Reader, Selection};
use downbeat::bridge::expose::TopicPattern;
use downbeat::replay::{ReplayOptions, Simulators, replay};
use downbeat::running::{PreparedRobot, RecordPlan};
use serde_json::{Value, json};
use std::path::Path;
use std::time::{Duration, Instant};
use test_machine::free_domain;

const ROBOT: &str = r#"
[robot]
name = "darwin_op"
LAUNCHER
[[module]]
name = "simulator"
kind = "darwin_op_simulator"
settings = { link = "memory:darwin_op", world = "WORLD", camera_hz = 5.0 }
[[module]]
name = "hardware"
kind = "darwin_op"
settings = { port = "memory:darwin_op" }
remap = { joint_commands = "motion/joint_commands" }
[[module]]
name = "motion"
kind = "stand_nod_wave"
[expose]
diagnostics = false
"#;

/// Topic, time and bytes of each message.
type Recorded = Vec<(String, i64, Vec<u8>)>;

/// Three simulated seconds, recorded.
fn run(folder: &Path, launcher: &str) -> Recorded {
    let (robot, bag) = (folder.join("robot.toml"), folder.join("bag"));
    let world = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/worlds/field.toml");
    std::fs::write(&robot, ROBOT.replace("LAUNCHER", launcher).replace("WORLD", world)).unwrap();
    let file = App::with_built_in_kinds().robot_file(&robot).unwrap();
    let mut prepared = PreparedRobot::simulated(file, Some(Duration::from_secs(3))).unwrap();
    let plan = RecordPlan::of_robot(&bag, prepared.file(), None);
    prepared.record(plan).unwrap();
    let running = prepared.start().unwrap();
    let watchdog = Instant::now() + Duration::from_secs(300);
    while !running.is_finished() {
        assert!(Instant::now() < watchdog, "three simulated seconds took five minutes");
        std::thread::yield_now();
    }
    running.stop().unwrap();
    let reader = Reader::open(&bag).unwrap();
    let names: Vec<String> = reader.topics().iter().map(|topic| topic.info.name.clone()).collect();
    let messages = reader.messages(Selection::all()).unwrap().map(Result::unwrap);
    messages
        .map(|message| (names[message.topic.index()].clone(), message.log_time, message.data.to_vec()))
        .collect()
}

#[test]
fn simulated_time_gives_the_same_bag_under_every_launcher() {
    let runs = ["", "launcher = \"pool\"\nthreads = 2", "launcher = \"threads\""].map(|launcher| {
        let folder = tempfile::tempdir().unwrap();
        run(folder.path(), launcher)
    });
    let count = |topic: &str| runs[0].iter().filter(|(name, ..)| name == topic).count();
    assert!(count("/joint_states") > 250 && count("/imu/data_raw") > 250, "{}", count("/joint_states"));
    assert_eq!((count("/ground_truth/odom"), count("/camera/image_raw")), (150, 15));
    for other in &runs[1..] {
        assert_eq!(runs[0].len(), other.len());
        let difference = runs[0].iter().zip(other).find(|(one, other)| one != other);
        assert!(difference.is_none(), "{difference:?}");
    }
}

#[test]
fn a_run_in_simulated_time_replays_bit_for_bit_with_the_hardware_inside_the_cycle() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), "");
    let app = App::with_built_in_kinds();
    let file = app.robot_file(folder.path().join("robot.toml")).unwrap();
    let reader = Reader::open(folder.path().join("bag")).unwrap();
    let of_simulator = ["ground_truth/*", "camera/*", "simulation", "simulator/**"];
    let except = of_simulator.map(|topic| TopicPattern::new(topic).unwrap()).into();
    let report = replay(file, &reader, &ReplayOptions { except, ..ReplayOptions::default() }).unwrap();
    assert_eq!(report.modules, ["hardware", "motion"]);
    assert_eq!(report.left_out[0].module, "simulator");
    let compared = |topic: &str| report.topics.iter().find(|known| known.topic == topic).unwrap().compared;
    assert!(compared("/bus/exchanges") > 250 && compared("/joint_states") > 250, "{report}");
    report.assert_same().unwrap();
}

#[test]
fn a_simulator_runs_again_in_a_replay_and_renders_the_same_pictures() {
    let folder = tempfile::tempdir().unwrap();
    run(folder.path(), "");
    let reader = Reader::open(folder.path().join("bag")).unwrap();
    for launcher in ["linear", "pool:2"] {
        let app = App::with_built_in_kinds();
        let mut file = app.robot_file(folder.path().join("robot.toml")).unwrap();
        file.launcher.choice = launcher.parse().unwrap();
        let options = ReplayOptions { simulators: Simulators::RunAgain, ..ReplayOptions::default() };
        let report = replay(file, &reader, &options).unwrap();
        assert_eq!(report.modules, ["simulator", "hardware", "motion"]);
        let compared =
            |topic: &str| report.topics.iter().find(|known| known.topic == topic).unwrap().compared;
        assert!(compared("/camera/image_raw") >= 14 && compared("/joint_states") > 250, "{report}");
        report.assert_same().unwrap();
    }
}

#[test]
fn a_simulator_does_not_run_again_on_a_bag_of_real_time() {
    let recordings = Path::new(env!("CARGO_MANIFEST_DIR")).join("bags/recordings");
    let file = App::with_built_in_kinds().robot_file(recordings.join("darwin_op_emulated.toml")).unwrap();
    let reader = Reader::open(recordings.join("darwin_op_emulated")).unwrap();
    let options = ReplayOptions { simulators: Simulators::RunAgain, ..ReplayOptions::default() };
    let error = replay(file, &reader, &options).unwrap_err().to_string();
    assert!(error.contains("recorded in real time") && error.contains("--fast"), "{error}");
}

#[test]
fn a_world_file_is_refused_at_the_line_of_the_setting() {
    let folder = tempfile::tempdir().unwrap();
    let (robot, world) = (folder.path().join("robot.toml"), folder.path().join("world.toml"));
    std::fs::write(&world, "\n[ball]\nradius = nan\n").unwrap();
    let text = ROBOT.replace("LAUNCHER", "").replace("WORLD", "world.toml");
    std::fs::write(&robot, text).unwrap();
    let file = App::with_built_in_kinds().robot_file(&robot).unwrap();
    let Err(error) = PreparedRobot::new(file) else { panic!("it was accepted") };
    let error = error.to_string();
    assert!(
        error.contains("robot.toml:8: ") && error.contains("world.toml:2: the radius of the ball is NaN"),
        "{error}"
    );
}

#[test]
fn the_robot_file_of_the_simulated_darwin_op_is_one() {
    let file = App::with_built_in_kinds().robot_file("robots/darwin_op_physics.toml").unwrap();
    assert!(file.is_emulated());
    PreparedRobot::new(file).unwrap();
}

#[test]
fn cyclone_dds_spawns_and_deletes_a_parcel() {
    let resource = json!({"resource_string": "kind = \"box\"\nsize = [0.2, 0.1, 0.1]"});
    // As the two versions of simulation_interfaces have it.
    spawn_and_delete("", "SpawnEntity", &resource);
    let of_version_2 = json!({ "entity_resource": resource });
    spawn_and_delete(", interfaces = \"2.1\"", "SpawnEntity 2.1", &of_version_2);
}

fn spawn_and_delete(settings: &str, spawn: &str, resource: &Value) {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("robot.toml");
    let world = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/worlds/field.toml");
    let services = "services = [\"simulator/spawn_entity\", \"simulator/delete_entity\"]\n";
    let text = ROBOT.replace("LAUNCHER", "").replace("WORLD", world) + services;
    std::fs::write(&robot, text.replace(", camera_hz = 5.0", settings)).unwrap();
    let mut program = Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain.to_string()]);
    let mut ask = |name: &str, fields: Value| {
        let service = format!("/simulator/{}", if name == spawn { "spawn_entity" } else { "delete_entity" });
        let kind = format!("simulation_interfaces/srv/{name}");
        let answer = peer.ask(json!({"do": "request", "service": service, "type": kind, "fields": fields}));
        assert!(answer.is_object(), "no answer of {service}:\n{}", program.output());
        answer
    };
    let pose = json!({
        "position": {"x": 1.0, "y": 0.5, "z": 0.3},
        "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
    });
    let mut parcel = json!({
        "name": "parcel",
        "allow_renaming": false,
        "initial_pose": {"header": {"frame_id": "world"}, "pose": pose},
    });
    parcel.as_object_mut().unwrap().extend(resource.as_object().unwrap().clone());
    let spawned = ask(spawn, parcel.clone());
    assert_eq!(
        (&spawned["result"]["result"], &spawned["entity_name"]),
        (&json!(1), &json!("parcel")),
        "{spawned}"
    );
    let again = ask(spawn, parcel);
    assert_eq!(again["result"]["result"], 101, "the name is taken: {again}");
    let deleted = ask("DeleteEntity", json!({"entity": "parcel"}));
    assert_eq!(deleted["result"]["result"], 1, "{deleted}");
    program.interrupt();
    peer.leave();
}
