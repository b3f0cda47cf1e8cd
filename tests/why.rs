//! Why a message was published, and how old what it depends on is: `downbeat bag why`, `downbeat bag
//! latency`.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};

use common::{
    Running, downbeat, output_of, record_until, recorded_messages, robot_file, text_of, wait_until,
};
use serde_json::Value;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A recorded run of the emulated robot.
fn recorded(folder: &Path, edit: impl Fn(String) -> String) -> PathBuf {
    let (robot, bag) = (robot_file(folder, edit), folder.join("bag"));
    let arguments = ["bag", "record", "--robot", text(&robot), "--output", text(&bag)];
    record_until(&arguments, &bag, "/joint_goals", 100);
    bag
}

fn json(arguments: &[&str]) -> Value {
    serde_json::from_str(&text_of(&[arguments, &["--json"]].concat())).unwrap()
}

/// Whether a run has that cause; a late one has all that came in the meantime.
fn has_cause(run: &Value, cause: &str) -> bool {
    run["causes"].as_array().unwrap().iter().any(|of| of == cause)
}

fn refusal(arguments: &[&str]) -> String {
    let output = output_of(arguments);
    assert!(!output.status.success(), "{arguments:?}");
    String::from_utf8(output.stderr).unwrap()
}

#[test]
fn a_goal_of_the_darwin_op_is_traced_to_its_servos_and_the_chain_is_measured() {
    let folder = tempfile::tempdir().unwrap();
    let bag = recorded(folder.path(), |text| text);
    let bag = text(&bag);
    let why = json(&["bag", "why", bag, "joint_goals#50"]);
    assert_eq!(why["is_exact"], true);
    let mux = &why["message"]["from"]["run"];
    assert_eq!(mux["module"], "mux");
    assert!(has_cause(mux, "messages"), "{mux}");
    let command = &mux["received"][0];
    assert_eq!(command["topic"], "motion/joint_commands");
    let motion = &command["from"]["run"];
    assert_eq!(motion["module"], "motion");
    assert!(has_cause(motion, "timer"), "{motion}");
    // Remembered by a run on time; a late one has the next of them with it.
    let lists = ["remembered", "received"].map(|list| motion[list].as_array().unwrap());
    let states = lists.into_iter().flatten().find(|states| states["topic"] == "joint_states");
    let states = states.unwrap_or_else(|| panic!("no joint_states: {motion}"));
    let hardware = &states["from"]["run"];
    assert_eq!(hardware["module"], "hardware");
    assert!(hardware["step"].is_u64(), "on its own thread: {hardware}");
    assert!(hardware["time_ns"].as_i64() <= states["time_ns"].as_i64());

    let shown = text_of(&["bag", "why", bag, "/joint_goals@1s", "--depth", "2"]);
    assert!(shown.contains("motion") && shown.contains("follows further with --depth 4"), "{shown}");

    let latency = json(&["bag", "latency", bag, "--from", "joint_states", "--to", "joint_goals"]);
    let [min, max] = ["min", "max"].map(|name| latency["age_ns"][name].as_u64().unwrap());
    assert!(min < max && latency["messages"].as_u64() >= Some(100), "{latency}");
    let worst = &latency["worst"];
    assert_eq!(worst["age_ns"].as_u64(), Some(max));
    let way: Vec<_> =
        worst["hops"].as_array().unwrap().iter().map(|hop| hop["module"].as_str().unwrap()).collect();
    assert_eq!(way, ["motion", "mux"]);
    let shown =
        text_of(&["bag", "latency", bag, "--from", "joint_states", "--to", "joint_goals", "--histogram"]);
    assert!(shown.contains("waited") && shown.contains("##"), "{shown}");
}

#[test]
fn what_is_not_there_is_told_with_what_is_near() {
    let folder = tempfile::tempdir().unwrap();
    let bag = recorded(folder.path(), |text| text);
    let bag = text(&bag);
    let refused = refusal(&["bag", "why", bag, "joint_gaols@1s"]);
    assert!(refused.contains("did you mean /joint_goals?"), "{refused}");
    let refused = refusal(&["bag", "why", bag, "joint_goals@1h"]);
    assert!(
        refused.contains("no message at 3600.0") && refused.contains("near it is /joint_goals#"),
        "{refused}"
    );
    let refused = refusal(&["bag", "why", bag, "joint_goals#99999"]);
    assert!(refused.contains("there is no #99999"), "{refused}");
    let refused = refusal(&["bag", "why", bag, "module_runs#0"]);
    assert!(refused.contains("no module of the robot") || refused.contains("an observer"), "{refused}");
    let refused = refusal(&["bag", "latency", bag, "--from", "led/eyes", "--to", "joint_goals"]);
    assert!(refused.contains("no chain of runs"), "{refused}");
    let refused = refusal(&["bag", "latency", bag, "--from", "joint_goals", "--to", "/joint_goals"]);
    assert!(refused.contains("a chain leads to another topic"), "{refused}");
}

#[test]
fn a_bag_without_runs_gives_a_guess_that_is_called_one() {
    let folder = tempfile::tempdir().unwrap();
    let bag =
        recorded(folder.path(), |text| text.replace("[record]", "[record]\nexcept = [\"module_runs\"]"));
    let output = output_of(&["bag", "why", text(&bag), "imu/data_raw#50", "--json"]);
    let log = String::from_utf8(output.stderr).unwrap();
    assert!(log.contains("has no runs (topic module_runs)"), "{log}");
    let why: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(why["is_exact"], false);

    let jazzy = concat!(env!("CARGO_MANIFEST_DIR"), "/bags/tests/data/jazzy_mcap");
    let shown = json(&["bag", "info", jazzy]);
    let topics = shown["topics"].as_array().unwrap().iter();
    let topic = topics
        .filter(|topic| topic["message_count"].as_u64() > Some(0))
        .find_map(|topic| topic["name"].as_str());
    let output = output_of(&["bag", "why", jazzy, &format!("{}#0", topic.unwrap())]);
    let log = String::from_utf8(output.stderr).unwrap();
    assert!(log.contains("knows of no cycles") && log.contains("guessed"), "{log}");
}

#[test]
fn a_chain_of_the_robot_file_is_shown_and_its_limit_watched_while_the_robot_runs() {
    let chain = |to: &str| {
        format!("[[latency]]\nname = \"reaction\"\nfrom = \"joint_states\"\nto = \"{to}\"\nlimit = \"1ms\"\n")
    };
    let folder = tempfile::tempdir().unwrap();
    let robot = robot_file(folder.path(), |text| format!("{text}\n{}", chain("joint_goal")));
    let refused = refusal(&["check", text(&robot)]);
    assert!(refused.contains("did you mean \"joint_goals\"?"), "{refused}");

    let robot = robot_file(folder.path(), |text| format!("{text}\n{}", chain("joint_goals")));
    let bag = folder.path().join("bag");
    let arguments = ["bag", "record", "--robot", text(&robot), "--output", text(&bag)];
    let mut running = Running::start_with(&arguments, &[("XDG_RUNTIME_DIR", folder.path())]);
    wait_until("top shows the chain", || {
        let top = downbeat(&["top", "--json"]).env("XDG_RUNTIME_DIR", folder.path()).output().unwrap();
        let top: Value = serde_json::from_slice(&top.stdout).unwrap_or_default();
        top["latencies"][0]["name"] == "reaction" && top["latencies"][0]["exceeded"].as_u64() > Some(10)
    });
    let top = downbeat(&["top", "--once"]).env("XDG_RUNTIME_DIR", folder.path()).output().unwrap();
    let top = String::from_utf8(top.stdout).unwrap();
    assert!(top.contains("LATENCY") && top.contains("reaction"), "{top}");
    running.wait_for_output("joint_states waited");
    wait_until("the diagnostics report it", || recorded_messages(&bag, "/diagnostics") > 5);
    running.interrupt();
    let log = running.output();
    assert!(
        log.contains("latency \"reaction\": joint_goals came") && log.contains("the limit is 1ms"),
        "{log}"
    );
    let diagnostics = text_of(&[
        "bag",
        "export",
        text(&bag),
        "--format",
        "jsonl",
        "--topics",
        "diagnostics",
        "--output",
        text(&folder.path().join("tables")),
    ]);
    let reported = std::fs::read_dir(folder.path().join("tables"))
        .unwrap()
        .map(|file| std::fs::read_to_string(file.unwrap().path()).unwrap());
    let reported: String = reported.collect();
    assert!(
        reported.contains("latency reaction") && reported.contains("older than the limit"),
        "{diagnostics}"
    );
}
