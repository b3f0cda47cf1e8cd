//! The Darwin OP walks in its simulated world: rclpy steers it, it falls when pushed and begins to get up,
//! and the recorded run replays. The success rate is tested by `modules/physics/tests/walking.rs`, in
//! simulated time.
#![cfg(feature = "physics")]
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::{Peer, python};
use common::{Running, downbeat, wait_until};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader, Write};
use std::process::{Child, Command, Stdio};
use test_machine::free_domain;

const ROBOT: &str = "robots/darwin_op_walks.toml";

/// The latest message on a topic since the last call.
fn latest(rclpy: &mut Peer, topic: &str) -> Option<Value> {
    rclpy
        .ask(json!({"do": "take", "topic": topic}))
        .as_array()
        .unwrap()
        .last()
        .map(|last| last["fields"].clone())
}

#[test]
fn rclpy_steers_and_pushes_the_robot_and_the_run_replays() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Topics", "a simulated robot is steered by cmd_vel", With::Rclpy, Way::In);
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("walk");
    let bag = bag.to_str().unwrap();
    let mut program = Running::start(&["run", ROBOT, "--domain", &domain.to_string(), "--record", bag]);
    for (topic, kind) in [("/odom", "nav_msgs/msg/Odometry"), ("/robot_state", "std_msgs/msg/String")] {
        rclpy.ask(json!({"do": "subscribe", "topic": topic, "type": kind}));
    }
    for (topic, kind) in
        [("/cmd_vel", "geometry_msgs/msg/Twist"), ("/push", "geometry_msgs/msg/Vector3Stamped")]
    {
        rclpy.ask(json!({"do": "advertise", "topic": topic, "type": kind}));
        wait_until("rclpy has found the robot", || {
            rclpy.ask(json!({"do": "matched", "topic": topic})).as_u64().is_some_and(|count| count > 0)
        });
    }
    let wait_for_state = |rclpy: &mut Peer, wanted: &str| {
        wait_until(&format!("the robot is {wanted}"), || {
            latest(rclpy, "/robot_state").is_some_and(|state| state["data"] == wanted)
        });
    };
    wait_for_state(&mut rclpy, "upright");
    wait_until("the robot has walked 0.3 m", || {
        rclpy.ask(json!({"do": "publish", "topic": "/cmd_vel", "fields": {"linear": {"x": 0.1}}}));
        let position =
            latest(&mut rclpy, "/odom").map(|odometry| odometry["pose"]["pose"]["position"]["x"].clone());
        position.and_then(|x| x.as_f64()).is_some_and(|x| x > 0.3)
    });
    let push = json!({"header": {"frame_id": "torso"}, "vector": {"x": 3.0}});
    rclpy.ask(json!({"do": "publish", "topic": "/push", "fields": push}));
    wait_for_state(&mut rclpy, "getting_up");
    program.interrupt();
    rclpy.leave();

    let replay = downbeat(&["bag", "replay", ROBOT, bag]).output().unwrap();
    assert!(
        replay.status.success(),
        "{}{}",
        String::from_utf8_lossy(&replay.stdout),
        String::from_utf8_lossy(&replay.stderr)
    );
}

/// A running script, which is killed when dropped.
struct Script(Child);

impl Drop for Script {
    fn drop(&mut self) {
        // Fails only if the script has already ended. Closing its terminal ends its child processes too.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

#[test]
fn the_teleoperation_on_the_page_steers_the_robot() {
    let domain = free_domain();
    let (Some(python), Some(mut rclpy)) = (python(), Peer::start(domain, "LOCALHOST")) else { return };
    let (_, script) = include_str!("../docs/walking.md").split_once("```python\n").unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("teleop.py");
    std::fs::write(&path, script.split_once("```").unwrap().0).unwrap();
    let mut program = Running::start(&["run", ROBOT, "--domain", &domain.to_string()]);
    rclpy.ask(json!({"do": "subscribe", "topic": "/odom", "type": "nav_msgs/msg/Odometry"}));
    rclpy.ask(json!({"do": "subscribe", "topic": "/robot_state", "type": "std_msgs/msg/String"}));
    wait_until("the robot is upright", || {
        latest(&mut rclpy, "/robot_state").is_some_and(|state| state["data"] == "upright")
    });
    // The script reads keys from a terminal.
    let in_terminal = "import pty, sys; pty.spawn([sys.executable, sys.argv[1]])";
    let mut command = Command::new(python);
    command.args(["-c", in_terminal]).arg(&path).env("ROS_DOMAIN_ID", domain.to_string());
    command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST").stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut teleop = Script(command.spawn().unwrap());
    let mut keys = teleop.0.stdin.take().unwrap();
    let mut lines = BufReader::new(teleop.0.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap().contains("any other key: stop")), "it has not started");
    let pose = |rclpy: &mut Peer| {
        let odometry = latest(rclpy, "/odom")?;
        let pose = &odometry["pose"]["pose"];
        Some((pose["position"]["x"].as_f64()?, pose["orientation"]["z"].as_f64()?))
    };
    keys.write_all(b"w").unwrap();
    wait_until("the robot has walked 0.15 m", || pose(&mut rclpy).is_some_and(|(x, _)| x > 0.15));
    keys.write_all(b"d").unwrap();
    wait_until("the robot has turned to the right", || pose(&mut rclpy).is_some_and(|(_, z)| z < -0.2));
    keys.write_all(b"\x03").unwrap();
    assert!(teleop.0.wait().is_ok());
    program.interrupt();
    rclpy.leave();
}
