//! The log of a running robot: on the console in the format of ROS 2, in a file, and on `/rosout`.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, downbeat, robot_file, wait_until};
use serde_json::json;
use test_machine::free_domain;

/// Runs the robot briefly without DDS. Returns whether it succeeded, standard output and standard error.
fn run_with(variables: &[(&str, &str)]) -> (bool, String, String) {
    let folder = tempfile::tempdir().unwrap();
    let robot = robot_file(folder.path(), |text| text);
    let output = downbeat(&["run", robot.to_str().unwrap(), "--duration", "300ms"])
        .env("ROS_AUTOMATIC_DISCOVERY_RANGE", "OFF")
        .envs(variables.iter().copied())
        .output()
        .unwrap();
    let [out, error] = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap());
    (output.status.success(), out, error)
}

#[test]
fn lines_have_the_format_of_ros_by_default() {
    let (_, out, error) = run_with(&[]);
    assert_eq!(out, "");
    let exposed = error.lines().find(|line| line.contains("/joint_states")).unwrap();
    assert!(
        exposed.starts_with("[INFO] [1") && exposed.contains("] [darwin_op]: exposed to ROS 2:"),
        "{exposed}"
    );

    let (_, out, error) = run_with(&[
        ("RCUTILS_CONSOLE_OUTPUT_FORMAT", r"{severity}\t{name}|{message} {unknown}"),
        ("RCUTILS_LOGGING_USE_STDOUT", "1"),
        ("RCUTILS_COLORIZED_OUTPUT", "1"),
        ("RCUTILS_LOGGING_BUFFERED_STREAM", "1"),
    ]);
    let expected = "\x1b[0mINFO\tdarwin_op|exposed to ROS 2: /joint_states [sensor_msgs/msg/JointState] {unknown}\x1b[0m\n";
    assert!(out.contains(expected), "{out}\n{error}");
    assert_eq!(error, "");
}

#[test]
fn the_log_file_is_in_ros_log_dir() {
    let folder = tempfile::tempdir().unwrap();
    let logs = folder.path().join("some/logs");
    let (_, _, error) = run_with(&[("ROS_LOG_DIR", logs.to_str().unwrap())]);
    let file = std::fs::read_dir(&logs).unwrap().next().unwrap().unwrap();
    assert!(file.file_name().to_str().unwrap().starts_with("downbeat_"));
    assert_eq!(
        std::fs::read_to_string(file.path()).unwrap(),
        error,
        "the file has the same lines as the console"
    );
}

#[test]
fn invalid_settings_of_the_log_are_refused_with_a_hint() {
    let (ended_well, _, error) = run_with(&[("RCUTILS_COLORIZED_OUTPUT", "yes")]);
    assert!(!ended_well && error.contains("expected 0 (no colors), 1 (colors), or nothing"), "{error}");
    let (ended_well, _, error) = run_with(&[("ROS_LOG_DIR", "/proc/nowhere")]);
    assert!(!ended_well && error.contains("/proc/nowhere/downbeat_"), "{error}");
}

#[test]
fn rclpy_receives_the_log_of_the_robot_unless_the_robot_file_disables_it() {
    for is_on in [true, false] {
        let domain = free_domain();
        let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
        let _check = check("Selection", "/rosout of the program, on and off", With::Rclpy, Way::Out);
        let folder = tempfile::tempdir().unwrap();
        let with = |text: String| text.replace("[expose]", &format!("[expose]\nrosout = {is_on}"));
        let robot = robot_file(folder.path(), with);
        let mut robot = Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain.to_string()]);
        let of_robot = |peer: &mut Peer, ask: &str, topic: &str| {
            let listed = peer.ask(json!({"do": ask, "topic": topic}));
            listed.as_array().unwrap().iter().any(|info| info["node"] == "/darwin_op")
        };
        wait_until("the robot is listed", || of_robot(&mut peer, "publishers_of", "/joint_states"));
        assert_eq!(of_robot(&mut peer, "publishers_of", "/rosout"), is_on);
        if is_on {
            let qos = json!({"depth": 1000, "durability": "transient_local"});
            let kind = "rcl_interfaces/msg/Log";
            peer.ask(json!({"do": "subscribe", "topic": "/rosout", "type": kind, "qos": qos}));
            let text = "exposed to ROS 2: /joint_states [sensor_msgs/msg/JointState]";
            wait_until("rclpy receives a line from before it started", || {
                let lines = peer.ask(json!({"do": "take", "topic": "/rosout"}));
                let lines = lines.as_array().unwrap().iter().map(|message| &message["fields"]);
                lines.filter(|line| line["name"] == "darwin_op").any(|line| line["msg"] == text)
            });
        }
        robot.interrupt();
        peer.leave();
    }
}

#[test]
fn rclpy_reads_and_sets_the_levels_of_loggers_of_a_running_robot() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Node services", "get_logger_levels, set_logger_levels", With::Rclpy, Way::In);
    let folder = tempfile::tempdir().unwrap();
    let robot = robot_file(folder.path(), |text| text);
    let sockets = folder.path().join("sockets");
    std::fs::create_dir(&sockets).unwrap();
    let run = ["run", robot.to_str().unwrap(), "--domain", &domain.to_string()];
    let mut running = Running::start_with(&run, &[("XDG_RUNTIME_DIR", &sockets)]);
    let qos = json!({"depth": 1000, "durability": "transient_local"});
    peer.ask(json!({"do": "subscribe", "topic": "/rosout", "type": "rcl_interfaces/msg/Log", "qos": qos}));
    let service = |verb: &str| format!("/darwin_op/{verb}_logger_levels");
    for (verb, kind) in [("get", "GetLoggerLevels"), ("set", "SetLoggerLevels")] {
        let client =
            json!({"do": "client", "service": service(verb), "type": format!("rcl_interfaces/srv/{kind}")});
        peer.ask(client);
        assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": service(verb)})), true);
    }
    let get = |peer: &mut Peer, names: serde_json::Value| {
        let request = json!({"names": names});
        let answer = peer.ask(json!({"do": "call", "service": service("get"), "requests": [request]}));
        let levels = answer[0]["levels"].as_array().unwrap().iter().map(|level| level["level"].clone());
        levels.collect::<Vec<_>>()
    };
    let set = |peer: &mut Peer, level: u32| {
        let request = json!({"levels": [{"name": "darwin_op", "level": level}]});
        let answer = peer.ask(json!({"do": "call", "service": service("set"), "requests": [request]}));
        answer[0]["results"][0].clone()
    };
    let accepted = json!({"successful": true, "reason": ""});
    assert_eq!(get(&mut peer, json!(["", "darwin_op"])), [20, 0]);
    let expose = |verb: &[&str]| {
        let mut command = downbeat(&[&["expose", "darwin_op"], verb].concat());
        assert!(command.env("XDG_RUNTIME_DIR", &sockets).status().unwrap().success());
    };
    assert_eq!(set(&mut peer, 40), accepted);
    assert_eq!(get(&mut peer, json!(["darwin_op"])), [40]);
    expose(&["add", "out", "joint_goals", "--as", "quietly"]);
    assert_eq!(set(&mut peer, 20), accepted);
    expose(&["add", "out", "joint_goals", "--as", "aloud"]);
    let mut lines_seen = Vec::new();
    wait_until("rclpy receives lines of the new level", || {
        let lines = peer.ask(json!({"do": "take", "topic": "/rosout"}));
        lines_seen.extend(lines.as_array().unwrap().iter().map(|line| line["fields"]["msg"].to_string()));
        lines_seen.iter().any(|line| line.contains("/aloud"))
    });
    assert!(!lines_seen.iter().any(|line| line.contains("/quietly")), "{lines_seen:?}");
    running.wait_for_output("exposed while running: /aloud");
    assert!(!running.output().contains("/quietly"));
    assert_eq!(set(&mut peer, 15)["successful"], false);
    running.interrupt();
    peer.leave();
}
