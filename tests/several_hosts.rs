//! A robot on one host and rclpy on another. Network namespaces represent the hosts, which requires root.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;
use std::time::{Duration, Instant};

use common::hosts::Hosts;
use common::matrix::{Check, Way, With, check};
use common::rclpy::Peer;
use common::{Running, robot_file, wait_until};
use serde_json::json;

const DOWNBEAT: &str = env!("CARGO_BIN_EXE_downbeat");
const JOINT_STATE: &str = "sensor_msgs/msg/JointState";

fn run(hosts: &Hosts, folder: &Path, more: &[&str]) -> Running {
    run_with(hosts, folder, more, &[])
}

fn run_with(hosts: &Hosts, folder: &Path, more: &[&str], variables: &[(&str, &str)]) -> Running {
    let robot = robot_file(folder, |text| text);
    let mut command = hosts.command(0, DOWNBEAT);
    command.envs(variables.iter().copied());
    command.arg("run").arg(robot).args(more).current_dir(env!("CARGO_MANIFEST_DIR"));
    Running::start_by(&mut command)
}

/// Two hosts for a check, with rclpy on the second.
fn hosts(check: Check) -> Option<(Hosts, Peer, Check)> {
    hosts_that(check, |_| ())
}

/// Like `hosts`, but `change` modifies the hosts before rclpy starts.
fn hosts_that(check: Check, change: impl FnOnce(&Hosts)) -> Option<(Hosts, Peer, Check)> {
    let made = Hosts::new().and_then(|hosts| {
        change(&hosts);
        Some((rclpy(&hosts)?, hosts))
    });
    let Some((peer, hosts)) = made else {
        check.skipped();
        return None;
    };
    Some((hosts, peer, check))
}

fn rclpy(hosts: &Hosts) -> Option<Peer> {
    Peer::start_by(|python| hosts.command(1, python))
}

fn hear(peer: &mut Peer) {
    let qos = json!({"depth": 1000});
    peer.ask(json!({"do": "subscribe", "topic": "/joint_states", "type": JOINT_STATE, "qos": qos}));
    peer.take("/joint_states", 1);
}

#[test]
fn the_robot_is_seen_and_driven_from_another_host() {
    let check =
        check("Several hosts", "a robot is observed and driven from another host", With::Rclpy, Way::Both);
    let Some((hosts, mut peer, _check)) = hosts(check) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(&hosts, folder.path(), &[]);
    hear(&mut peer);
    peer.ask(json!({"do": "advertise", "topic": "/joint_commands", "type": JOINT_STATE}));
    wait_until("the robot receives commands", || {
        peer.ask(json!({"do": "matched", "topic": "/joint_commands"})) == 1
    });
    wait_until("the head follows", || {
        let fields = json!({"name": ["head_pan"], "position": [0.3]});
        peer.ask(json!({"do": "publish", "topic": "/joint_commands", "fields": fields}));
        peer.take("/joint_states", 1).iter().any(|state| {
            let fields = &state["fields"];
            let names = fields["name"].as_array().unwrap();
            let head = names.iter().position(|name| name == "head_pan").unwrap();
            (fields["position"][head].as_f64().unwrap() - 0.3).abs() < 0.05
        })
    });
    robot.interrupt();
    let left = Instant::now();
    wait_until("the robot has disappeared", || {
        !peer.ask(json!({"do": "nodes"})).as_array().unwrap().iter().any(|node| node == "/darwin_op")
    });
    wait_until("the robot is not counted any more", || {
        peer.ask(json!({"do": "matched", "topic": "/joint_commands"})) == 0
    });
    assert!(left.elapsed() < Duration::from_secs(5), "not by the end of its lease, which is 20 s");
}

#[test]
fn a_cable_that_was_out_for_30_seconds_is_as_if_it_never_was() {
    let check =
        check("Several hosts", "a cable unplugged for 30 s and plugged in again", With::Rclpy, Way::Out);
    let Some((hosts, mut peer, _check)) = hosts(check) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(&hosts, folder.path(), &[]);
    hear(&mut peer);
    hosts.pull_the_cable();
    // Longer than the lease of Fast DDS, 20 s: both remove each other.
    std::thread::sleep(Duration::from_secs(30));
    peer.ask(json!({"do": "take", "topic": "/joint_states"}));
    hosts.put_the_cable_back();
    peer.take("/joint_states", 100);
    assert!(!robot.output().contains("panicked"), "{}", robot.output());
    robot.interrupt();
}

#[test]
fn a_peer_that_is_killed_and_restarted_20_times_receives_from_the_robot_each_time() {
    let check = check("Several hosts", "a peer killed and started again 20 times", With::Rclpy, Way::Out);
    let Some((hosts, mut peer, _check)) = hosts(check) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(&hosts, folder.path(), &[]);
    hear(&mut peer);
    for _ in 0..20 {
        // Killed by the drop: it does not announce its departure.
        drop(peer);
        peer = rclpy(&hosts).unwrap();
        hear(&mut peer);
    }
    robot.interrupt();
}

#[test]
fn a_host_without_multicast_is_discovered_by_its_address() {
    let check = check("Environment", "ROS_STATIC_PEERS without multicast", With::Rclpy, Way::Both);
    let Some((hosts, mut peer, _check)) = hosts_that(check, Hosts::without_multicast) else { return };
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run_with(&hosts, folder.path(), &[], &[("ROS_STATIC_PEERS", "10.77.0.2")]);
    hear(&mut peer);
    peer.ask(json!({"do": "advertise", "topic": "/joint_commands", "type": JOINT_STATE}));
    wait_until("the robot receives commands", || {
        peer.ask(json!({"do": "matched", "topic": "/joint_commands"})) == 1
    });
    robot.interrupt();
    peer.leave();
}

#[test]
fn with_discovery_on_localhost_another_host_does_not_see_the_robot() {
    let check = check("Several hosts", "discovery on LOCALHOST stays on the host", With::Rclpy, Way::Out);
    let Some((hosts, mut peer, _check)) = hosts(check) else { return };
    let Some(mut neighbour) = Peer::start_by(|python| {
        let mut command = hosts.command(0, python);
        command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
        command
    }) else {
        return;
    };
    let folder = tempfile::tempdir().unwrap();
    let robot_file = robot_file(folder.path(), |text| text);
    let mut command = hosts.command(0, DOWNBEAT);
    command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST").arg("run").arg(robot_file);
    let mut robot = Running::start_by(&mut command);
    hear(&mut neighbour);
    let nodes = peer.ask(json!({"do": "nodes"}));
    assert!(!nodes.as_array().unwrap().iter().any(|node| node == "/darwin_op"), "{nodes}");
    robot.interrupt();
}
