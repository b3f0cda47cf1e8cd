//! Features of the node of a running robot beyond topics, seen from real rclpy.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeMap;
use std::path::Path;

use common::matrix::{Check, Way, With, check};
use common::rclpy::Peer;
use common::{Running, robot_file, wait_until};
use serde_json::{Value, json};
use test_machine::free_domain;

const URDF: &str = "<robot name=\"stick\"><link name=\"stick\"/></robot>";

fn run(domain: u16, folder: &Path, expose: &str) -> Running {
    std::fs::write(folder.join("stick.urdf"), URDF).unwrap();
    let module =
        "[[module]]\nkind = \"robot_state_publisher\"\nsettings = { robot_description = \"stick.urdf\" }";
    let latched = "{ topic = \"robot_description\", qos = \"latched\" }";
    let robot = robot_file(folder, |text| {
        let text = text.replace("[expose]", &format!("{module}\n[expose]\n{expose}"));
        text.replace("out = [", &format!("out = [{latched},"))
    });
    let bag = folder.join("bag");
    let domain = domain.to_string();
    Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain, "--record", bag.to_str().unwrap()])
}

fn peer(domain: u16) -> Option<Peer> {
    Peer::start(domain, "LOCALHOST")
}

/// Returns the latest levels and messages by component, once all of `names` are present.
fn diagnostics(peer: &mut Peer, names: &[&str]) -> BTreeMap<String, (u64, String)> {
    let mut known = BTreeMap::new();
    wait_until("all components are reported", || {
        for message in peer.ask(json!({"do": "take", "topic": "/diagnostics"})).as_array().unwrap() {
            for status in message["fields"]["status"].as_array().unwrap() {
                // In the fields of rclpy a byte is a list of one number.
                let level = status["level"].as_u64().or(status["level"][0].as_u64()).unwrap_or(0);
                let text = |key: &str| status[key].as_str().unwrap_or_default().to_owned();
                known.insert(text("name"), (level, text("message")));
            }
        }
        names.iter().all(|name| known.contains_key(*name))
    });
    known
}

#[test]
fn rclpy_receives_diagnostics_and_the_robot_description() {
    let domain = free_domain();
    let Some(mut peer) = peer(domain) else { return };
    let _check = check("Node services", "/diagnostics of the process", With::Rclpy, Way::Out);
    let _check2 = check("Node services", "robot_description", With::Rclpy, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(domain, folder.path(), "");
    let kind = "diagnostic_msgs/msg/DiagnosticArray";
    peer.ask(json!({"do": "subscribe", "topic": "/diagnostics", "type": kind}));
    let names = [
        "darwin_op: core",
        "darwin_op: module hardware",
        "darwin_op: module motion",
        "darwin_op: /joint_states",
        "darwin_op: recording",
        "darwin_op: bus",
    ];
    let known = diagnostics(&mut peer, &names);
    assert_eq!(known["darwin_op: module motion"], (0, "running".to_owned()));
    assert_eq!(known["darwin_op: recording"].1, "recording");

    let latched = json!({"depth": 1, "durability": "transient_local"});
    let text = "std_msgs/msg/String";
    peer.ask(json!({"do": "subscribe", "topic": "/robot_description", "type": text, "qos": latched}));
    assert_eq!(peer.take("/robot_description", 1)[0]["fields"]["data"], URDF);
    robot.interrupt();
    peer.leave();
}

#[test]
fn the_time_of_a_robot_is_published_if_its_file_requests_it() {
    let domain = free_domain();
    let Some(mut peer) = peer(domain) else { return };
    let _check = check("Selection", r#"clock = "publish" in the robot file"#, With::Rclpy, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(domain, folder.path(), "clock = { publish_hz = 100.0 }");
    let qos = json!({"depth": 10, "reliability": "best_effort"});
    peer.ask(json!({"do": "subscribe", "topic": "/clock", "type": "rosgraph_msgs/msg/Clock", "qos": qos}));
    let times = peer.take("/clock", 20);
    let seconds = |message: &Value| message["fields"]["clock"]["sec"].as_i64().unwrap();
    assert!(seconds(&times[0]) > 1_700_000_000);
    robot.interrupt();
    peer.leave();
}

#[test]
fn a_robot_that_follows_clock_stamps_its_messages_with_that_time() {
    let domain = free_domain();
    let Some(mut peer) = peer(domain) else { return };
    let _check = check("Selection", r#"clock = "follow" in the robot file"#, With::Rclpy, Way::In);
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(domain, folder.path(), "clock = \"follow\"");
    peer.ask(json!({"do": "advertise", "topic": "/clock", "type": "rosgraph_msgs/msg/Clock"}));
    let kind = "sensor_msgs/msg/JointState";
    peer.ask(json!({"do": "subscribe", "topic": "/joint_states", "type": kind}));
    let (mut milliseconds, mut stamps) = (1_000_000, Vec::new());
    wait_until("joint states carry the time of rclpy", || {
        milliseconds += 8;
        let clock = json!({"sec": milliseconds / 1000, "nanosec": milliseconds % 1000 * 1_000_000});
        peer.ask(json!({"do": "publish", "topic": "/clock", "fields": {"clock": clock}}));
        let states = peer.ask(json!({"do": "take", "topic": "/joint_states"}));
        let stamp = |state: &Value| state["fields"]["header"]["stamp"]["sec"].as_i64().unwrap();
        stamps.extend(states.as_array().unwrap().iter().map(stamp));
        stamps.iter().filter(|&&stamp| stamp >= 1000).count() >= 20
    });
    assert!(stamps.iter().all(|stamp| (0..=milliseconds / 1000).contains(stamp)), "{stamps:?}");
    robot.interrupt();
    peer.leave();
}

/// The wheels of Kilted have no messages of sensors: texts, parameters and the lifecycle are what they know.
#[test]
fn rclpy_of_kilted_reads_and_changes_a_robot() {
    let checks = [
        check("Node services", "robot_description", With::Kilted, Way::Out),
        check("Parameters", "settings of the demo", With::Kilted, Way::In),
        check("Selection", "lifecycle in the robot file", With::Kilted, Way::In),
    ];
    let domain = free_domain();
    let Some(mut peer) = Peer::kilted(domain) else { return checks.into_iter().for_each(Check::skipped) };
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(domain, folder.path(), "lifecycle = [\"motion\"]");
    let (latched, text) = (json!({"depth": 1, "durability": "transient_local"}), "std_msgs/msg/String");
    peer.ask(json!({"do": "subscribe", "topic": "/robot_description", "type": text, "qos": latched}));
    assert_eq!(peer.take("/robot_description", 1)[0]["fields"]["data"], URDF);

    let mut parameters = |call: &str, argument: Value| {
        peer.ask(json!({"do": "parameters", "node": "/darwin_op", "call": call, "argument": argument}))
    };
    let set = parameters("set_parameters", json!({"mux.hold_s": 2.5}));
    assert_eq!(set["results"][0]["successful"], true, "{set}");
    let read = parameters("get_parameters", json!(["mux.hold_s"]));
    assert_eq!(read["values"][0]["double_value"], 2.5, "{read}");

    let mut call = |name: &str, kind: &str, request: Value| {
        let service = format!("/motion/{name}");
        peer.ask(json!({"do": "client", "service": service, "type": format!("lifecycle_msgs/srv/{kind}")}));
        assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": service})), true);
        peer.ask(json!({"do": "call", "service": service, "requests": [request]}))[0].clone()
    };
    assert_eq!(call("get_state", "GetState", json!({}))["current_state"]["label"], "active");
    let changed = call("change_state", "ChangeState", json!({"transition": {"label": "deactivate"}}));
    assert_eq!(changed["success"], true, "{changed}");
    assert_eq!(call("get_state", "GetState", json!({}))["current_state"]["label"], "inactive");
    robot.interrupt();
    peer.leave();
}
