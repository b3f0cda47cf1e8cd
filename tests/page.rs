//! The page in a browser, at a running emulated robot.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::process::Command;

use common::browser::script;
use common::rclpy::Peer;
use common::{Running, downbeat, record_until, robot_file};
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
