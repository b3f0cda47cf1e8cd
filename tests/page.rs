//! The page in a browser, at a running emulated robot.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;
use std::process::Command;

use common::browser::script;
use common::rclpy::Peer;
use common::{Running, downbeat, record_until, robot_file, text_of};
use downbeat::bags::{Reader, Selection};
use downbeat::msgs::downbeat_interfaces::msg::{Episode, RobotState};
use downbeat::msgs::sensor_msgs::msg::JointState;
use downbeat::msgs::{cdr, std_msgs};
use serde_json::json;
use test_machine::free_domain;

/// The URL for browsers.
fn page_of(program: &Running) -> String {
    const BEFORE: &str = "open in a browser: ";
    program.wait_for_output(BEFORE);
    let output = program.output();
    output.lines().find_map(|line| line.strip_prefix(BEFORE)).unwrap().to_owned()
}

/// Runs a script, which must succeed.
fn pass(script: &mut Command, shown: &Running) {
    let output = script.output().unwrap();
    let [out, error] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success(), "{out}\n{error}\n{}", shown.output());
}

/// Two chains, of which the second one is always above its limit.
const CHAINS: &str = r#"
[[latency]]
name = "reaction"
from = "joint_states"
to = "joint_goals"
limit = "1h"

[[latency]]
name = "motion"
from = "joint_states"
to = "motion/joint_commands"
limit = "1ns"
"#;

#[test]
fn each_view_shows_true_values_of_a_running_robot_and_changes_it() {
    let domain_id = free_domain();
    let Some(mut script) = script("robot.mjs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = robot_file(folder.path(), |text| text + CHAINS);
    let domain = domain_id.to_string();
    let line = ["run", file.to_str().unwrap(), "--domain", &domain, "--view=0"];
    // Recordings and the socket are in the folder.
    let robot =
        Running::start_by(downbeat(&line).current_dir(folder.path()).env("XDG_RUNTIME_DIR", folder.path()));
    script.env("DOWNBEAT_PAGE", page_of(&robot)).env("DOWNBEAT_FOLDER", folder.path());
    script.env("XDG_RUNTIME_DIR", folder.path()).env("ROS_DOMAIN_ID", &domain);
    pass(&mut script, &robot);

    // The parameter that was set in the page.
    let Some(mut rclpy) = Peer::start(domain_id, "LOCALHOST") else { return };
    let call = json!({"do": "parameters", "node": "/darwin_op", "call": "get_parameters", "argument": ["mux.hold_s"]});
    assert_eq!(rclpy.ask(call)["values"][0]["double_value"], 3.25);
    rclpy.leave();
}

#[test]
fn a_bag_is_scrubbed_in_the_page() {
    let domain = free_domain().to_string();
    let Some(mut script) = script("bag.mjs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = robot_file(folder.path(), |text| text);
    let bag = folder.path().join("bag");
    let paths = [&bag, &file].map(|path| path.to_str().unwrap());
    let record = ["run", paths[1], "--domain", &domain, "--record", paths[0]];
    record_until(&record, &bag, "/joint_states", 300);
    let shown = Running::start(&["bag", "view", paths[0], "--start-paused", "--port", "0", "--page", "0"]);
    script.env("DOWNBEAT_PAGE", page_of(&shown)).env("DOWNBEAT_BAG", &bag);
    pass(script.env("DOWNBEAT_FOLDER", folder.path()), &shown);
}

#[test]
fn why_the_robot_fell_is_found_in_the_page() {
    let Some(mut script) = script("debug.mjs") else { return };
    const WALK: &str = "bags/recordings/darwin_op_walk_simulated";
    let robot = format!("{WALK}.toml");
    let shown = Running::start(&["bag", "debug", &robot, WALK, "--page", "0"]);
    pass(script.env("DOWNBEAT_PAGE", page_of(&shown)), &shown);
}

#[test]
fn episodes_are_kept_and_discarded_by_button_and_by_key() {
    let Some(mut script) = script("episodes.mjs") else { return };
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let record = ["--record", bag.to_str().unwrap()];
    let line = ["run", "robots/so101_teleop.toml", "--domain", &domain, "--view=0"];
    let mut shown = Running::start(&[&line[..], &record].concat());
    pass(script.env("DOWNBEAT_PAGE", page_of(&shown)), &shown);
    shown.interrupt();

    let reader = Reader::open(&bag).unwrap();
    let selection = Selection::all().topics([reader.topic("/episodes").unwrap()]);
    let messages = reader.messages(selection).unwrap();
    let said = messages.map(|message| cdr::from_slice::<Episode>(&message.unwrap().data).unwrap());
    let said: Vec<_> = said.map(|episode| (episode.number, episode.state)).collect();
    let [started, kept, discarded] = [Episode::STARTED, Episode::KEPT, Episode::DISCARDED];
    assert_eq!(said, [(0, started), (0, kept), (1, started), (1, discarded)]);
}

#[test]
fn a_motion_of_an_arm_is_made_in_the_page_and_played() {
    let Some(mut script) = script("arm_motions.mjs") else { return };
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let [file, motions, bag] = ["robot.toml", "motions.toml", "bag"].map(|name| folder.path().join(name));
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots");
    let robot = std::fs::read_to_string(robots.join("so101.toml")).unwrap();
    let robot = robot
        .replace(
            "{ description = \"servos/so101.toml\" }",
            "{ description = \"servos/so101.toml\", file = \"motions.toml\" }",
        )
        .replace("servos/so101.toml", robots.join("servos/so101.toml").to_str().unwrap())
        .replace("\nin = [\n", "\nin = [\n{ topic = \"hand\", type = \"sensor_msgs/msg/JointState\" },\n");
    std::fs::write(&file, robot).unwrap();
    std::fs::write(&motions, "").unwrap();
    let [line, record] = [&file, &bag].map(|path| path.to_str().unwrap());
    let mut shown = Running::start(&["run", line, "--domain", &domain, "--view=0", "--record", record]);
    script.env("DOWNBEAT_PAGE", page_of(&shown)).env("DOWNBEAT_FILE", &motions);
    pass(script.env("ROS_DOMAIN_ID", &domain), &shown);
    shown.interrupt();

    let angles = recorded_angles(&bag, "elbow_flex");
    let highest = angles.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let last = *angles.last().unwrap();
    assert!((37.0..43.0).contains(&highest) && (-23.0..-17.0).contains(&last), "{highest}, then {last}");
}

/// The angles of a joint on `joint_states`, in degrees.
fn recorded_angles(bag: &Path, joint: &str) -> Vec<f64> {
    let reader = Reader::open(bag).unwrap();
    let selection = Selection::all().topics([reader.topic("/joint_states").unwrap()]);
    let states = reader.messages(selection).unwrap();
    let states = states.map(|message| cdr::from_slice::<JointState>(&message.unwrap().data).unwrap());
    let angle = |state: JointState| {
        let place = state.name.iter().position(|name| name == joint).unwrap();
        state.position[place].to_degrees()
    };
    states.map(angle).collect()
}

/// The Darwin OP walks in simulated physics; its motions are in a file.
#[cfg(feature = "physics")]
#[test]
fn a_motion_is_made_in_the_page_and_played_in_physics() {
    let Some(mut script) = script("motions.mjs") else { return };
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let [file, motions, bag] = ["robot.toml", "motions.toml", "bag"].map(|name| folder.path().join(name));
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots");
    let robot = std::fs::read_to_string(robots.join("darwin_op_walks.toml")).unwrap();
    let robot = robot
        .replace("kind = \"motions\"\n", "kind = \"motions\"\nsettings = { file = \"motions.toml\" }\n")
        .replace("worlds/field.toml", robots.join("worlds/field.toml").to_str().unwrap())
        .replace("\"darwin_op.urdf\"", &format!("{:?}", robots.join("darwin_op.urdf")))
        .replace("camera_hz = 30.0", "camera_hz = 1.0");
    std::fs::write(&file, robot).unwrap();
    let nod = "# Of a robot that nods.\n\n[nod]\n\n[[nod.frame]]\nduration_s = 1.0 # slowly\ndegrees = { head_tilt = 10, head_pan = 5 }\n\n\
               [nod_left]\nmirror_of = \"nod\"\n";
    std::fs::write(&motions, nod).unwrap();
    let [line, record] = [&file, &bag].map(|path| path.to_str().unwrap());
    let mut shown = Running::start(&["run", line, "--domain", &domain, "--view=0", "--record", record]);
    pass(script.env("DOWNBEAT_PAGE", page_of(&shown)).env("DOWNBEAT_FILE", &motions), &shown);
    shown.interrupt();

    // The servos have turned, and the robot has not fallen.
    let reader = Reader::open(&bag).unwrap();
    let of = |topic: &str| {
        let selection = Selection::all().topics([reader.topic(topic).unwrap()]);
        reader.messages(selection).unwrap().map(|message| message.unwrap().data)
    };
    let arm = recorded_angles(&bag, "r_sho_pitch").into_iter();
    // It stands with -48 degrees.
    let [lowest, highest] = arm.fold([0.0_f64; 2], |[low, high], angle| [low.min(angle), high.max(angle)]);
    assert!((52.0..65.0).contains(&highest) && (-65.0..-52.0).contains(&lowest), "{lowest} to {highest}");
    let falls = of("/robot_state").filter(|state| {
        let state: std_msgs::msg::String = cdr::from_slice(state).unwrap();
        state.data != RobotState::UPRIGHT
    });
    assert_eq!(falls.count(), 0);
    // What was edited is a part of the run, which began with the file as it was.
    std::fs::write(&motions, nod).unwrap();
    let replay = text_of(&["bag", "replay", line, record]);
    assert!(replay.contains("/motions/joint_commands"), "{replay}");
}
