//! A robot with a keystore of `ros2 security`: driven by Cyclone DDS with the same keystore, and neither seen
//! nor heard by anybody else.
#![cfg(all(feature = "cli", feature = "security"))]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;
#[allow(dead_code)] // a part of it is for other tests
#[path = "../bridge/tests/security/peer.rs"]
mod peer;

use common::{Running, downbeat, text_of, wait_until};
use peer::{Peer, Vendor};
use std::path::Path;
use std::process::Command;
use test_machine::free_domain;

/// The sources of the peers.
const PEERS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/bridge/security/peers");
/// Written by sros2.
const KEYSTORE: &str =
    concat!(env!("CARGO_MANIFEST_DIR"), "/bridge/security/tests/data/keystores/all_domains");
const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/darwin_op.toml");

fn in_domain(domain: u16, line: &[&str]) -> Command {
    let mut command = downbeat(line);
    command.env("ROS_DOMAIN_ID", domain.to_string());
    command
}

/// A command with an enclave of the keystore, as ROS 2 users say it.
fn with_enclave(domain: u16, enclave: &str, line: &[&str]) -> Command {
    let mut command = in_domain(domain, &[line, &["--ros-args", "--enclave", enclave]].concat());
    command.envs([
        ("ROS_SECURITY_ENABLE", "true"),
        ("ROS_SECURITY_STRATEGY", "Enforce"),
        ("ROS_SECURITY_KEYSTORE", KEYSTORE),
    ]);
    command
}

fn printed(mut command: Command) -> String {
    let output = command.output().unwrap();
    String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
}

#[test]
fn a_secured_robot_is_driven_by_its_own_only_and_its_recording_replays() {
    let (folder, domain) = (tempfile::tempdir().unwrap(), free_domain());
    let bag = folder.path().join("bag");
    let line = ["run", ROBOT, "--record", bag.to_str().unwrap()];
    let mut robot = Running::start_by(&mut with_enclave(domain, "/robot", &line));
    robot.wait_for_output("protected by");

    let drive = ["move /joint_commands head_pan 0.5", "joint /joint_states head_pan"];
    let peer = Peer::start(Vendor::Cyclone, domain, Path::new(KEYSTORE), "/talker", &drive);
    let Some(mut peer) = peer else { return };
    peer.wait_for("joint /joint_states 0.500");
    robot.wait_for_output("CN=/talker has proven its identity");

    // Those of the keystore see who they deal with.
    let graph = printed(with_enclave(domain, "/listener", &["graph"]));
    assert!(graph.contains("/darwin_op") && graph.contains("secured as CN=/robot"), "{graph}");
    let info = printed(with_enclave(domain, "/listener", &["node", "info", "/darwin_op"]));
    assert!(info.contains("Secured as: CN=/robot"), "{info}");

    // Others see nothing, hear nothing and move nothing.
    let nodes = printed(in_domain(domain, &["node", "list"]));
    assert!(!nodes.contains("darwin_op"), "{nodes}");
    let topics = printed(in_domain(domain, &["topic", "list"]));
    assert!(!topics.contains("joint"), "{topics}");
    peer.leave();
    let command = "{name: [head_pan], position: [-0.5]}";
    let publish = ["topic", "pub", "-w", "0", "--times", "20", "--rate", "10", "/joint_commands"];
    let said = printed(in_domain(domain, &[&publish[..], &["sensor_msgs/msg/JointState", command]].concat()));
    assert!(said.contains("-0.5"), "{said}");
    robot.wait_for_output("participants without security are ignored");
    robot.interrupt();

    let replay = text_of(&["bag", "replay", ROBOT, bag.to_str().unwrap()]);
    assert!(replay.contains("/joint_states"), "{replay}");
    let commands = common::recorded_messages(&bag, "/joint_commands");
    assert!(commands > 0);
    let tables = folder.path().join("tables");
    let (bag, output) = (bag.to_str().unwrap(), tables.to_str().unwrap());
    text_of(&["bag", "export", bag, "--topics", "/joint_commands", "--format", "jsonl", "--output", output]);
    let table = std::fs::read_dir(&tables).unwrap().next().unwrap().unwrap().path();
    let recorded = std::fs::read_to_string(table).unwrap();
    assert!(recorded.contains("0.5") && !recorded.contains("-0.5"), "{recorded:.2000}");
}

/// Moves its head on request.
const HEAD: &str = r#"
[robot]
name = "head"
[[module]]
name = "emulator"
kind = "darwin_op_emulator"
settings = { link = "memory:head" }
[[module]]
name = "hardware"
kind = "darwin_op"
settings = { port = "memory:head", hardware_id = "emulated" }
[[module]]
name = "head_controller"
kind = "joint_trajectory"
settings = { joints = ["head_pan", "head_tilt"], "constraints.goal_time" = 20.0 }
[expose]
actions = ["head_controller/follow_joint_trajectory"]
parameters = ["*"]
"#;

#[test]
fn actions_and_parameters_of_a_secured_robot_are_for_its_own_only() {
    let (folder, domain) = (tempfile::tempdir().unwrap(), free_domain());
    let file = folder.path().join("head.toml");
    std::fs::write(&file, HEAD).unwrap();
    let mut robot = Running::start_by(&mut with_enclave(domain, "/robot", &["run", file.to_str().unwrap()]));
    robot.wait_for_output("protected by");
    let action = "/head_controller/follow_joint_trajectory";
    let goal = "{trajectory: {joint_names: [head_pan, head_tilt], points: [{positions: [0.3, 0.0], \
                time_from_start: {sec: 1}}]}}";
    let send = ["action", "send_goal", action, "control_msgs/action/FollowJointTrajectory", goal];
    // It is rejected until the first state of the joints is there.
    wait_until("the goal is reached", || {
        printed(with_enclave(domain, "/listener", &send)).contains("SUCCEEDED")
    });
    let tolerance = "head_controller.constraints.goal_time";
    let set = printed(with_enclave(domain, "/talker", &["param", "set", "/head", tolerance, "7.0"]));
    assert!(set.contains("Set parameter successful"), "{set}");
    let get = printed(with_enclave(domain, "/listener", &["param", "get", "/head", tolerance]));
    assert!(get.contains("7.0"), "{get}");
    let actions = printed(in_domain(domain, &["action", "list"]));
    assert!(!actions.contains(action), "{actions}");
    robot.interrupt();
}

#[test]
fn without_a_usable_keystore_an_enforced_robot_does_not_start_and_a_permissive_one_says_so() {
    let domain = free_domain();
    let line = ["run", ROBOT, "--duration", "1s"];
    let mut enforced = with_enclave(domain, "/nobody", &line);
    let output = enforced.output().unwrap();
    let text = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
    assert!(!output.status.success() && text.contains("enclaves/nobody"), "{text}");
    let mut permissive = with_enclave(domain, "/nobody", &line);
    permissive.env("ROS_SECURITY_STRATEGY", "Permissive");
    let text = printed(permissive);
    assert!(text.contains("joins without protection") && text.contains("enclaves/nobody"), "{text}");
}
