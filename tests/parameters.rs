//! Settings of a running robot, read and set by real rclpy as `ros2 param` does.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, robot_file, text_of};
use serde_json::{Value, json};
use test_machine::free_domain;

#[test]
fn settings_of_a_running_robot_are_parameters_of_its_node() {
    let domain = free_domain();
    let folder = tempfile::tempdir().unwrap();
    let robot = robot_file(folder.path(), |text| text);
    let robot = robot.to_str().unwrap();
    let checked = text_of(&["check", robot]);
    assert!(checked.contains("parameter mux.hold_s = 2"), "{checked}");

    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Parameters", "settings of the demo", With::Rclpy, Way::In);
    let _running = Running::start(&["run", robot, "--domain", &domain.to_string()]);
    let mut ask = |call: &str, argument: Value| {
        rclpy.ask(json!({"do": "parameters", "node": "/darwin_op", "call": call, "argument": argument}))
    };
    let listed = ask("list_parameters", json!([]));
    let names = listed["result"]["names"].as_array().unwrap().clone();
    for name in ["mux.hold_s", "motion.stand_s", "use_sim_time"] {
        assert!(names.contains(&json!(name)), "{name} is in {names:?}");
    }
    let value = |answer: &Value| answer["values"][0]["double_value"].clone();
    assert_eq!(value(&ask("get_parameters", json!(["mux.hold_s"]))), 2.0);
    let set = ask("set_parameters", json!({"mux.hold_s": 3.5}));
    assert_eq!(set["results"][0], json!({"successful": true, "reason": ""}));
    assert_eq!(value(&ask("get_parameters", json!(["mux.hold_s"]))), 3.5);
    let refused = ask("set_parameters", json!({"mux.hold_s": "long"}));
    assert_eq!(
        refused["results"][0]["reason"],
        "Wrong parameter type, parameter {mux.hold_s} is of type {double}, setting it to {string} is not allowed."
    );
}
