//! Modules of a running robot, managed by real rclpy.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, robot_file, wait_until};
use serde_json::json;
use test_machine::free_domain;

#[test]
fn rclpy_deactivates_and_activates_the_motion_of_the_demo() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Selection", "lifecycle in the robot file", With::Rclpy, Way::In);
    let folder = tempfile::tempdir().unwrap();
    let with = |text: String| {
        text.replace("[expose]", "[expose]\nlifecycle = [\"motion\"]")
            .replace("\"buttons\",", "\"buttons\", \"motion/joint_commands\",")
    };
    let robot = robot_file(folder.path(), with);
    let mut running = Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain.to_string()]);
    let service = |name: &str| format!("/motion/{name}");
    for (name, kind) in [("change_state", "ChangeState"), ("get_state", "GetState")] {
        peer.ask(
            json!({"do": "client", "service": service(name), "type": format!("lifecycle_msgs/srv/{kind}")}),
        );
        assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": service(name)})), true);
    }
    let topic = "/motion/joint_commands";
    peer.ask(json!({"do": "subscribe", "topic": topic, "type": "sensor_msgs/msg/JointState"}));
    let call = |peer: &mut Peer, name: &str, request: serde_json::Value| {
        peer.ask(json!({"do": "call", "service": service(name), "requests": [request]}))[0].clone()
    };
    let set = |peer: &mut Peer, label: &str, reached: &str| {
        let request = json!({"transition": {"label": label}});
        assert_eq!(call(peer, "change_state", request)["success"], true, "{label}");
        assert_eq!(call(peer, "get_state", json!({}))["current_state"]["label"], reached);
    };
    peer.take(topic, 10);
    // The module logs under the name of its node.
    let qos = json!({"depth": 1000, "durability": "transient_local"});
    peer.ask(json!({"do": "subscribe", "topic": "/rosout", "type": "rcl_interfaces/msg/Log", "qos": qos}));
    let levels = "/darwin_op/set_logger_levels";
    peer.ask(json!({"do": "client", "service": levels, "type": "rcl_interfaces/srv/SetLoggerLevels"}));
    assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": levels})), true);
    let request = json!({"levels": [{"name": "motion", "level": 10}]});
    peer.ask(json!({"do": "call", "service": levels, "requests": [request]}));
    set(&mut peer, "deactivate", "inactive");
    wait_until("rclpy receives it in the log of the node", || {
        let lines = peer.ask(json!({"do": "take", "topic": "/rosout"}));
        let lines = lines.as_array().unwrap().iter().map(|line| &line["fields"]);
        let is_it = |line: &serde_json::Value| {
            line["name"] == "motion" && line["msg"] == "deactivate: active to inactive"
        };
        lines.into_iter().any(is_it)
    });
    let publishers = peer.ask(json!({"do": "publishers_of", "topic": "/rosout"}));
    assert!(publishers.as_array().unwrap().iter().any(|info| info["node"] == "/motion"), "{publishers}");
    running.wait_for_output("[motion]: deactivate: active to inactive");
    // Messages in transit at the time of the answer have arrived by the end of another exchange.
    set(&mut peer, "cleanup", "unconfigured");
    wait_until("messages in transit have arrived", || {
        peer.ask(json!({"do": "take", "topic": topic})).as_array().unwrap().is_empty()
    });
    let parameters =
        json!({"do": "parameters", "node": "/motion", "call": "get_parameters", "argument": ["stand_s"]});
    assert_eq!(peer.ask(parameters)["values"][0]["type"], 3);
    assert_eq!(
        peer.ask(json!({"do": "take", "topic": topic})),
        json!([]),
        "an unconfigured module publishes nothing"
    );
    set(&mut peer, "configure", "inactive");
    set(&mut peer, "activate", "active");
    peer.take(topic, 10);
    running.interrupt();
    peer.leave();
}
