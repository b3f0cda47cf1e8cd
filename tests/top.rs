//! `downbeat top`, `trace` and `graph` as a user sees them.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;
use std::process::{Child, Command, Stdio};

use common::{QUIET_ROBOT, Running, downbeat, text_of, wait_until};
use downbeat::bags::Reader;
use downbeat::edge::Interfaces;
use downbeat::executor::Snapshot;
use downbeat::inspect::{Client, SocketDirectory};
use downbeat::table::{MOST_POINTS, series};
use test_machine::free_domain;

/// A robot with servos, which moves.
const MOVING_ROBOT: &str = r#"
[robot]
name = "moving"

[[module]]
name = "emulator"
kind = "darwin_op_emulator"
settings = { link = "memory:top", seed = 1, faults = [] }

[[module]]
name = "hardware"
kind = "darwin_op"
settings = { port = "memory:top" }
remap = { joint_commands = "joint_goals" }

[[module]]
name = "motion"
kind = "stand_nod_wave"

[[module]]
name = "mux"
kind = "joint_command_mux"
"#;

struct Robot(Child);

impl Robot {
    fn start(folder: &Path) -> Self {
        Self::start_of(folder, QUIET_ROBOT)
    }

    fn start_of(folder: &Path, robot: &str) -> Self {
        let file = folder.join("robot.toml");
        std::fs::write(&file, robot).unwrap();
        let mut command =
            in_folder(folder, &["bag", "record", "--robot", file.to_str().unwrap(), "--output"]);
        command.arg(folder.join("bag")).stdout(Stdio::null()).stderr(Stdio::null());
        let robot = Self(command.spawn().unwrap());
        wait_until("the robot is listed", || {
            in_folder(folder, &["top", "--json"]).output().unwrap().status.success()
        });
        robot
    }
}

impl Drop for Robot {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// The program with a socket directory of this test.
fn in_folder(folder: &Path, arguments: &[&str]) -> Command {
    let mut command = downbeat(arguments);
    command.env("XDG_RUNTIME_DIR", folder).stdin(Stdio::null());
    command
}

fn output(folder: &Path, arguments: &[&str]) -> (bool, String) {
    let output = in_folder(folder, arguments).output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    (output.status.success(), text)
}

#[test]
fn a_running_robot_is_shown_traced_and_found_by_name_and_process_id() {
    let folder = tempfile::tempdir().unwrap();
    let robot = Robot::start(folder.path());
    let (_, json) = output(folder.path(), &["top", "--json", "quiet"]);
    let snapshot: Snapshot = serde_json::from_str(&json).unwrap();
    assert!(snapshot.modules.iter().any(|module| module.name == "motion"));
    let (is_found, json) = output(folder.path(), &["top", "--once", "--json"]);
    assert!(is_found && serde_json::from_str::<Snapshot>(&json).is_ok(), "{json}");
    let pid = robot.0.id().to_string();
    let (is_found, text) = output(folder.path(), &["top", "--once", &pid]);
    assert!(is_found && text.starts_with(&format!("quiet (process {pid})")), "{text}");
    for expected in ["MODULE", "motion", "mux", "TOPIC", "joint_commands"] {
        assert!(text.contains(expected), "no {expected} in {text}");
    }
    let (is_found, text) = output(folder.path(), &["top", "--once", "loud"]);
    assert!(!is_found && text.contains("no robot \"loud\"") && text.contains("quiet (process"), "{text}");

    let trace = folder.path().join("trace.json");
    let (is_traced, text) = output(folder.path(), &["trace", "--cycles", "3", "-o", trace.to_str().unwrap()]);
    assert!(is_traced, "{text}");
    let again = ["trace", "--cycles", "3", "-o", trace.to_str().unwrap()];
    let (is_traced, text) = output(folder.path(), &again);
    assert!(!is_traced && text.contains("trace.json exists already") && text.contains("--force"), "{text}");
    let (is_traced, text) = output(folder.path(), &[&again[..], &["--force"]].concat());
    assert!(is_traced, "{text}");
    let trace: serde_json::Value = serde_json::from_slice(&std::fs::read(trace).unwrap()).unwrap();
    let events = trace["traceEvents"].as_array().unwrap();
    assert_eq!(events.iter().filter(|event| event["name"] == "process").count(), 3);
    assert!(events.iter().any(|event| event["name"] == "motion" && event["ph"] == "X"));
}

#[test]
fn a_robot_that_already_runs_is_not_started_again() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("quiet.toml");
    std::fs::write(&file, QUIET_ROBOT).unwrap();
    let domain = free_domain().to_string();
    let run = |options: &[&str]| {
        in_folder(folder.path(), &[&["run", file.to_str().unwrap(), "--domain", &domain], options].concat())
    };
    let mut first = Running::start_by(&mut run(&[]));
    wait_until("the robot is listed", || output(folder.path(), &["top", "--once"]).0);
    let second = run(&["--duration", "1s"]).output().unwrap();
    let error = String::from_utf8(second.stderr).unwrap();
    assert!(!second.status.success(), "{error}");
    assert!(
        error.contains("quiet (process ") && error.contains(&format!("as /quiet in domain {domain} already")),
        "{error}"
    );
    let elsewhere = run(&["--duration", "10ms", "--ros-args", "-r", "__ns:=/lab"]).output().unwrap();
    assert!(elsewhere.status.success(), "{}", String::from_utf8_lossy(&elsewhere.stderr));
    first.interrupt();
    let after = run(&["--duration", "10ms"]).output().unwrap();
    assert!(after.status.success(), "{}", String::from_utf8_lossy(&after.stderr));
}

#[test]
fn the_absence_of_robots_is_reported_and_dead_sockets_are_removed() {
    let folder = tempfile::tempdir().unwrap();
    drop(Robot::start(folder.path()));
    let sockets = || std::fs::read_dir(folder.path().join("downbeat")).unwrap().count();
    assert_eq!(sockets(), 1);
    let (is_found, text) = output(folder.path(), &["top", "--once"]);
    assert!(!is_found && text.contains("no robot of this user is running"), "{text}");
    assert_eq!(sockets(), 0);
}

#[test]
fn the_graph_of_a_robot_file_is_drawn_without_running_it() {
    let dot = text_of(&["graph", "robots/darwin_op.toml"]);
    assert!(dot.starts_with("digraph robot {"), "{dot}");
    for expected in [r#"label="hardware\ndetached""#, r"joint_states\nsensor_msgs/msg/JointState", "m1 -> t"]
    {
        assert!(dot.contains(expected), "no {expected} in {dot}");
    }
    let mermaid = text_of(&["graph", "robots/darwin_op.toml", "--format", "mermaid"]);
    assert!(mermaid.starts_with("flowchart LR\n"), "{mermaid}");
    assert!(mermaid.contains("[[\"hardware<br/>detached\"]]"), "{mermaid}");
}

#[test]
fn a_closed_output_ends_the_program_without_an_error() {
    for arguments in
        [&["graph", "robots/darwin_op.toml"][..], &["check", "robots/darwin_op.toml"], &["check", "--kinds"]]
    {
        let mut child = downbeat(arguments).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        let message = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success() && message.is_empty(), "{arguments:?}: {message}");
    }
}

#[test]
fn a_screen_needs_a_terminal() {
    let folder = tempfile::tempdir().unwrap();
    let _robot = Robot::start(folder.path());
    let (is_shown, text) = output(folder.path(), &["top"]);
    assert!(!is_shown && text.contains("--once"), "{text}");
    let (is_shown, text) = output(folder.path(), &["top", "--plot", "joint_commands:position[0]"]);
    assert!(!is_shown && text.contains("--once"), "{text}");
}

#[test]
fn watched_values_are_those_that_the_robot_records() {
    let folder = tempfile::tempdir().unwrap();
    let robot = Robot::start_of(folder.path(), MOVING_ROBOT);
    let directory = SocketDirectory::open_at(folder.path().join("downbeat")).unwrap();
    let mut client = Client::connect(&directory.running().unwrap()[0]).unwrap();
    let (topic, field) = ("motion/joint_commands", "position[0]");
    client.watch(topic, &[field.to_owned()]).unwrap();
    let (mut times, mut values) = (Vec::new(), Vec::new());
    wait_until("there are enough values", || {
        let [watched] = <[_; 1]>::try_from(client.values().unwrap()).unwrap();
        assert_eq!((watched.topic.as_str(), watched.missed), (topic, 0));
        times.extend(watched.fields[0].series.times.clone());
        values.extend(watched.fields[0].series.values.clone());
        times.len() > 50
    });
    let bag = folder.path().join("bag");
    let recorded = || {
        let bags = [Reader::open(&bag).ok()?];
        let (topic, interfaces) = (format!("/{topic}"), Interfaces::carried());
        series(&bags, &topic, &[field], MOST_POINTS, &interfaces).ok()?.pop()
    };
    wait_until("they are recorded", || {
        recorded().is_some_and(|recorded| recorded.times.last() >= times.last())
    });
    drop(robot);
    let recorded = recorded().unwrap();
    let first = recorded.times.iter().position(|time| *time == times[0]).unwrap();
    assert_eq!(recorded.times[first..][..times.len()], times);
    assert_eq!(recorded.values[first..][..times.len()], values);
    assert_ne!(values[0], values[values.len() - 1], "the robot moves");
}

#[test]
fn a_field_that_cannot_be_plotted_is_named_with_the_nearest_one() {
    let folder = tempfile::tempdir().unwrap();
    let _robot = Robot::start(folder.path());
    for (field, expected) in [
        (
            "joint_comands:position[0]",
            "there is no topic \"joint_comands\", did you mean \"joint_commands\"?",
        ),
        ("joint_commands:positon[0]", "joint_commands has no number at positon[0]:"),
        ("joint_commands:positon[0]", "did you mean `position`?"),
        ("joint_commands:position", "it is an array: select an element, such as position[0]"),
        ("joint_commands", "write TOPIC:FIELD, such as joint_states:position[3]"),
    ] {
        let (is_shown, text) = output(folder.path(), &["top", "--plot", field]);
        assert!(!is_shown && text.contains(expected), "{field}: {text}");
    }
}
