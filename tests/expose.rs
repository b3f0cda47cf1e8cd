//! The endpoints that a robot exposes to ROS 2, observed by real rclpy: names, nodes, QoS, rates, and changes
//! at run time.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, downbeat, robot_file, text_of, wait_until};
use downbeat::robot::EndpointReport;
use serde_json::{Value, json};
use test_machine::free_domain;

/// The demo with its `[expose]` replaced.
fn robot(folder: &Path, robot: &str, expose: &str) -> String {
    let path = robot_file(folder, |text| {
        let (before, rest) = text.split_once("[expose]").unwrap();
        let (_, after) = rest.split_once("[record]").unwrap();
        let before = before.replacen("[robot]\n", &format!("[robot]\n{robot}\n"), 1);
        format!("{before}[expose]\n{expose}\n[record]{after}")
    });
    path.to_str().unwrap().to_owned()
}

fn run(domain: u16, robot: &str, more: &[&str]) -> Running {
    let domain = domain.to_string();
    Running::start(&[&["run", robot, "--domain", &domain], more].concat())
}

fn publishers(peer: &mut Peer, topic: &str) -> Vec<(String, String, String)> {
    let listed = peer.ask(json!({"do": "publishers_of", "topic": topic}));
    let text = |endpoint: &Value, key: &str| endpoint[key].as_str().unwrap().to_owned();
    let endpoints = listed.as_array().unwrap().iter();
    endpoints.map(|e| (text(e, "node"), text(e, "reliability"), text(e, "durability"))).collect()
}

fn nodes(peer: &mut Peer) -> Vec<String> {
    let nodes = peer.ask(json!({"do": "nodes"}));
    nodes.as_array().unwrap().iter().map(|node| node.as_str().unwrap().to_owned()).collect()
}

#[test]
fn two_robots_in_namespaces_with_several_nodes_share_a_domain() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _robots = check("Selection", "two robots in namespaces on one domain", With::Rclpy, Way::Out);
    let _nodes = check("Selection", "several nodes of one process", With::Rclpy, Way::Out);
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let expose = "out = [\"joint_states\", { topic = \"imu/*\", as = \"~/*\", node = \"imu_driver\", qos = \"sensor_data\" }]\n\
                  in = [\"joint_commands\"]";
    let mut robots = ["/robot1", "/robot2"].map(|namespace| {
        let folder = &folders[usize::from(namespace == "/robot2")];
        run(domain, &robot(folder.path(), "", expose), &["--ros-args", "-r", &format!("__ns:={namespace}")])
    });
    for namespace in ["/robot1", "/robot2"] {
        wait_until("the robot's topics are listed with their nodes", || {
            let of = |node: &str, reliability: &str| {
                [(format!("{namespace}/{node}"), reliability.to_owned(), "VOLATILE".to_owned())]
            };
            publishers(&mut peer, &format!("{namespace}/joint_states")) == of("darwin_op", "RELIABLE")
                && publishers(&mut peer, &format!("{namespace}/imu_driver/data_raw"))
                    == of("imu_driver", "BEST_EFFORT")
        });
    }
    let states =
        json!({"do": "subscribe", "topic": "/robot2/joint_states", "type": "sensor_msgs/msg/JointState"});
    peer.ask(states);
    assert!(!peer.take("/robot2/joint_states", 1).is_empty());
    assert!(publishers(&mut peer, "/joint_states").is_empty());
    robots[0].interrupt();
    wait_until("the first robot and its nodes have disappeared, the second is present", || {
        let nodes = nodes(&mut peer);
        !nodes.iter().any(|node| node.starts_with("/robot1/"))
            && nodes.iter().any(|node| node == "/robot2/imu_driver")
    });
    robots[1].interrupt();
    peer.leave();
}

#[test]
fn remapping_rules_and_limits_are_seen_by_rclpy() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _names = check("Selection", "--ros-args: names and log level of a robot", With::Rclpy, Way::Out);
    let _rate = check("Selection", "rate limit", With::Rclpy, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let expose = "out = [{ topic = \"joint_states\", rate_hz = 5.0, qos = { durability = \"transient_local\", depth = 1 } }]";
    let file = robot(folder.path(), "remap = { joint_states = \"/from_file\" }", expose);
    let rules = [
        "--ros-args",
        "-r",
        "__node:=renamed",
        "-r",
        "rostopic:///joint_states:=~/states",
        "--log-level",
        "warn",
    ];
    let mut robot = run(domain, &file, &rules);
    let expected = ("/renamed".to_owned(), "RELIABLE".to_owned(), "TRANSIENT_LOCAL".to_owned());
    wait_until("the topic has its new name, node and durability", || {
        publishers(&mut peer, "/renamed/states") == [expected.clone()]
    });
    let qos = json!({"depth": 100});
    peer.ask(json!({"do": "subscribe", "topic": "/renamed/states", "type": "sensor_msgs/msg/JointState", "qos": qos}));
    let stamps: Vec<f64> = peer
        .take("/renamed/states", 6)
        .iter()
        .map(|message| {
            let stamp = &message["fields"]["header"]["stamp"];
            stamp["sec"].as_f64().unwrap() + stamp["nanosec"].as_f64().unwrap() / 1e9
        })
        .collect();
    // On average, in the time of the robot: each message is late by at most one bus cycle.
    let span = stamps[stamps.len() - 1] - stamps[0];
    let least = 0.2 * (stamps.len() - 1) as f64 - 0.05;
    assert!(span >= least, "{stamps:?}");
    assert!(!robot.output().contains("exposed to ROS 2"), "an event of level info: {}", robot.output());
    robot.interrupt();
    peer.leave();
}

fn expose(arguments: &[&str], pid: &str, sockets: &Path) -> (bool, String) {
    let line = [&["expose", pid], arguments].concat();
    let output = downbeat(&line).env("XDG_RUNTIME_DIR", sockets).output().unwrap();
    let text = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
    (output.status.success(), text)
}

#[test]
fn endpoints_come_and_go_in_rclpy_while_the_robot_runs() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check =
        check("Selection", "endpoints are added and removed while the robot runs", With::Rclpy, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let file = robot(folder.path(), "", "out = [\"joint_states\"]");
    let mut robot = Running::start_with(
        &["run", &file, "--domain", &domain.to_string()],
        &[("XDG_RUNTIME_DIR", folder.path())],
    );
    wait_until("the robot can be asked", || expose(&["list"], "darwin_op", folder.path()).0);
    wait_until("its topic is listed", || publishers(&mut peer, "/joint_states").len() == 1);

    let add = [
        "add",
        "out",
        "imu/*",
        "--as",
        "/sensors/*",
        "--qos",
        "{ reliability = \"best_effort\", depth = 2 }",
        "--every",
        "2",
    ];
    let (is_added, text) = expose(&add, "darwin_op", folder.path());
    assert!(is_added && text.contains("added imu/data_raw") && text.contains("/sensors/data_raw"), "{text}");
    wait_until("the added endpoints are listed", || {
        publishers(&mut peer, "/sensors/data_raw")
            == [("/darwin_op".to_owned(), "BEST_EFFORT".to_owned(), "VOLATILE".to_owned())]
    });
    let qos = json!({"reliability": "best_effort"});
    peer.ask(
        json!({"do": "subscribe", "topic": "/sensors/data_raw", "type": "sensor_msgs/msg/Imu", "qos": qos}),
    );
    assert!(!peer.take("/sensors/data_raw", 3).is_empty());
    let (_, listed) = expose(&["list", "--json"], "darwin_op", folder.path());
    let listed: Vec<EndpointReport> = serde_json::from_str(&listed).unwrap();
    assert_eq!((listed.len(), listed[1].endpoint.limits.every, listed[1].traffic.matched), (2, 2, 1));

    let (is_removed, text) = expose(&["remove", "/sensors/**"], "darwin_op", folder.path());
    assert!(is_removed && text.contains("removed imu/data_raw"), "{text}");
    wait_until("the removed endpoints have disappeared from the node", || {
        let published = peer.ask(json!({"do": "published_by", "node": "darwin_op"}));
        published.get("/sensors/data_raw").is_none() && published.get("/joint_states").is_some()
    });
    wait_until("`ros2 topic info` does not count it any more", || {
        publishers(&mut peer, "/sensors/data_raw").is_empty()
    });
    peer.ask(json!({"do": "take", "topic": "/sensors/data_raw"}));
    let (is_added, text) = expose(&add, "darwin_op", folder.path());
    assert!(is_added, "{text}");
    assert!(
        !peer.take("/sensors/data_raw", 3).is_empty(),
        "it is available again for a continuous subscriber"
    );
    let (is_removed, text) = expose(&["remove", "imu/*"], "darwin_op", folder.path());
    assert!(is_removed, "{text}");
    for (arguments, expected) in [
        (vec!["remove", "/nothing"], "\"nothing\" is not exposed; there is /joint_states"),
        (
            vec!["add", "out", "imu/data_rwa"],
            "expose:1: no module has a topic \"imu/data_rwa\" to expose, did you mean",
        ),
        (vec!["add", "out", "joint_states"], "/joint_states is exposed already"),
        (vec!["add", "in", "joint_commands", "--qos", "best"], "unknown QoS preset \"best\""),
    ] {
        let (is_done, text) = expose(&arguments, "darwin_op", folder.path());
        assert!(!is_done && text.contains(expected), "{text}");
    }
    robot.interrupt();
    peer.leave();
}

#[test]
fn rclpy_changes_what_is_exposed_by_a_service_of_the_node() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Selection", "the service `~/expose`", With::Rclpy, Way::In);
    let folder = tempfile::tempdir().unwrap();
    let file = robot(folder.path(), "", "out = [\"joint_states\"]\nexpose_service = true");
    let mut robot = Running::start(&["run", &file, "--domain", &domain.to_string()]);
    let (service, kind) = ("/darwin_op/expose", "rcl_interfaces/srv/SetParametersAtomically");
    peer.ask(json!({"do": "client", "service": service, "type": kind}));
    assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": service})), true);
    let change = |peer: &mut Peer, parameters: &[(&str, Value)]| {
        let parameters = parameters.iter().map(|(name, value)| json!({"name": name, "value": value}));
        let request = json!({"parameters": parameters.collect::<Vec<_>>()});
        let answer = peer.ask(json!({"do": "call", "service": service, "requests": [request]}));
        let result = &answer[0]["result"];
        (result["successful"] == true, result["reason"].as_str().unwrap().to_owned())
    };
    let text = |text: &str| json!({"type": 4, "string_value": text});
    let how = |topic: &str| [("out", text(topic)), ("as", text("/sensors/*")), ("qos", text("sensor_data"))];
    let added = change(&mut peer, &how("imu/*"));
    assert_eq!(added, (true, "/sensors/data_raw [sensor_msgs/msg/Imu]".to_owned()));
    let qos = json!({"reliability": "best_effort"});
    peer.ask(
        json!({"do": "subscribe", "topic": "/sensors/data_raw", "type": "sensor_msgs/msg/Imu", "qos": qos}),
    );
    assert!(!peer.take("/sensors/data_raw", 3).is_empty());
    let (ten, one) = (json!({"type": 2, "integer_value": 10}), json!({"type": 3, "double_value": 1.0}));
    for (parameters, problem) in [
        (how("imu/data_raw").to_vec(), "has a wildcard"),
        (vec![("out", text("joint_states"))], "exposed already"),
        (vec![("out", text("buttons")), ("rate", ten)], "expose:1: "),
        (vec![("out", one)], "value of type 3"),
        (vec![("remove", text("/nothing"))], "is not exposed; there is"),
    ] {
        let (is_done, reason) = change(&mut peer, &parameters);
        assert!(!is_done && reason.contains(problem), "{parameters:?}: {reason}");
    }
    assert!(change(&mut peer, &[("remove", text("/sensors/**"))]).0);
    wait_until("the removed endpoints have disappeared from the node", || {
        let published = peer.ask(json!({"do": "published_by", "node": "darwin_op"}));
        published.get("/sensors/data_raw").is_none() && published.get("/joint_states").is_some()
    });
    robot.interrupt();
    peer.leave();
}

#[test]
fn check_prints_what_would_be_exposed() {
    let folder = tempfile::tempdir().unwrap();
    let expose = "out = [{ topic = \"joint_states\", rate_hz = 10.0, latest_only = true }, { topic = \"imu/*\", as = \"/*\", node = \"imu\" }]\n\
                  in = [{ topic = \"joint_commands\", qos = \"best_available\" }]";
    let file = robot(folder.path(), "", expose);
    let text = text_of(&["check", &file, "--ros-args", "-r", "__ns:=/robot1", "-r", "joint_states:=states"]);
    let lines: Vec<_> =
        text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
    for expected in [
        "exposed to ROS 2 as node /robot1/darwin_op",
        "joint_states -> /robot1/states sensor_msgs/msg/JointState reliable volatile keep_last 10, at most 10 Hz, latest only",
        "of node /robot1/imu",
        "imu/data_raw -> /data_raw sensor_msgs/msg/Imu reliable volatile keep_last 10",
        "joint_commands <- /robot1/joint_commands sensor_msgs/msg/JointState best_available best_available keep_last 10 \
         deadline best_available liveliness best_available lease best_available",
    ] {
        assert!(lines.iter().any(|line| line == expected), "{expected}\n  is not in\n{text}");
    }
    let json: Value = serde_json::from_str(&text_of(&["check", &file, "--json"])).unwrap();
    assert_eq!(json["node"], "/darwin_op");
    assert_eq!((&json["lifecycle"], &json["features"]["clock"]), (&serde_json::json!([]), &"own".into()));
    assert_eq!(json["exposed"][0]["rate_hz"], 10.0);
    assert_eq!(json["exposed"][1]["node"], "/imu");
    assert_eq!(json["exposed"][2]["qos"]["durability"], "best_available");
}

#[test]
fn check_prints_the_further_features_of_the_node() {
    let folder = tempfile::tempdir().unwrap();
    let expose = "clock = { publish_hz = 50.0 }\nexpose_service = true\nlogger_service = false\nnetwork = true\n\
                  parameters = [\"mux.*\"]\nlifecycle = [\"m*\"]\n\
                  calls = [{ service = \"plan\", as = \"~/plan\", type = \"std_srvs/srv/Trigger\" }]";
    let file = robot(folder.path(), "", expose);
    let text = text_of(&["check", &file, "--ros-args", "-r", "__ns:=/robot1", "-r", "motion:__node:=legs"]);
    let lines: Vec<_> =
        text.lines().map(|line| line.split_whitespace().collect::<Vec<_>>().join(" ")).collect();
    for expected in [
        "time -> /clock, 50 Hz",
        "log -> /rosout",
        "what is exposed <- ~/expose",
        "what else is on the network -> topic network of the robot",
        "service plan <- /robot1/darwin_op/plan std_srvs/srv/Trigger",
        "lifecycle of motion -> node /robot1/legs",
        "lifecycle of mux -> node /robot1/mux",
        "parameter mux.hold_s = 2",
    ] {
        assert!(lines.iter().any(|line| line == expected), "{expected}\n  is not in\n{text}");
    }
    assert!(!text.contains("levels of loggers"), "{text}");
    let json: Value = serde_json::from_str(&text_of(&["check", &file, "--json"])).unwrap();
    assert_eq!(json["features"]["clock_hz"], 50.0);
    assert_eq!(json["features"]["logger_service"], false);
    assert_eq!(json["lifecycle"][1], serde_json::json!({"module": "mux", "node": "/mux"}));
    assert_eq!(
        (&json["parameters"][0]["name"], &json["calls"][0]["timeout_s"]),
        (&"mux.hold_s".into(), &10.0.into())
    );
}

#[test]
fn errors_in_ros_args_contain_the_argument() {
    let robot = "robots/darwin_op.toml";
    for (arguments, expected) in [
        (vec!["check", robot, "--ros-args", "-r", "a:="], "--ros-args -r a:=: \"a:=\" is no remapping rule"),
        (vec!["check", robot, "--ros-args", "--lgo-level", "warn"], "did you mean \"--log-level\"?"),
        (
            vec!["check", robot, "--ros-args", "-p", "mix.hold_s:=1.0"],
            "-p mix.hold_s:=1.0: the robot has no module \"mix\"",
        ),
        (vec!["check", robot, "--ros-args", "-r", "__ns:=/a/"], "namespace \"/a/\" is not valid"),
        (
            vec!["check", robot, "--ros-args", "--params-file", "nowhere.yaml"],
            "cannot read the parameter file nowhere.yaml",
        ),
        (vec!["top", "--ros-args", "-r", "a:=b"], "--ros-args is only for commands that create a ROS 2 node"),
    ] {
        let output = common::output_of(&arguments);
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success() && text.contains(expected), "{arguments:?}: {text}");
    }
    let text = text_of(&["check", robot, "--ros-args", "-p", "mux.hold_s:=0.125", "--enclave", "/secret"]);
    assert!(text.contains("hold_s = 0.125"), "{text}");
}
