//! The demo, seen and driven from real rclpy.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::Path;
use std::time::{Duration, Instant};

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, robot_file, wait_until};
use downbeat::bags::{Reader, Selection};
use downbeat::msgs::cdr;
use downbeat::msgs::sensor_msgs::msg::JointState;
use serde_json::{Value, json};
use test_machine::free_domain;

const JOINT_STATE: &str = "sensor_msgs/msg/JointState";

fn run(domain: u16, folder: &Path, more: &[&str]) -> Running {
    let (robot, domain) = (robot_file(folder, |text| text), domain.to_string());
    let mut arguments = vec!["run", robot.to_str().unwrap(), "--domain", &domain];
    arguments.extend(more);
    Running::start(&arguments)
}

fn peer(domain: u16) -> Option<Peer> {
    Peer::start(domain, "LOCALHOST")
}

fn has(list: &Value, item: &str) -> bool {
    list.as_array().unwrap().iter().any(|known| known == item)
}

fn stamp_ns(fields: &Value) -> i64 {
    let stamp = &fields["header"]["stamp"];
    stamp["sec"].as_i64().unwrap() * 1_000_000_000 + stamp["nanosec"].as_i64().unwrap()
}

fn position(fields: &Value, joint: &str) -> f64 {
    let index = fields["name"].as_array().unwrap().iter().position(|name| name == joint).unwrap();
    fields["position"][index].as_f64().unwrap()
}

#[test]
fn the_node_is_listed_with_its_topics_types_and_qos() {
    let domain = free_domain();
    let Some(mut peer) = peer(domain) else { return };
    let _check = check("Graph", "the demo robot with all its topics", With::Rclpy, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(domain, folder.path(), &[]);
    wait_until("the node is listed", || has(&peer.ask(json!({"do": "nodes"})), "/darwin_op"));
    let published = [
        ("/joint_states", JOINT_STATE, "RELIABLE"),
        ("/imu/data_raw", "sensor_msgs/msg/Imu", "BEST_EFFORT"),
        ("/battery_state", "sensor_msgs/msg/BatteryState", "RELIABLE"),
        ("/buttons", "sensor_msgs/msg/Joy", "RELIABLE"),
        ("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "RELIABLE"),
    ];
    let endpoint = |type_name: &str, reliability: &str| json!([{ "node": "/darwin_op", "type": type_name, "reliability": reliability, "durability": "VOLATILE" }]);
    for (topic, type_name, reliability) in published {
        wait_until(&format!("the publisher of {topic} is listed with its type and QoS"), || {
            peer.ask(json!({"do": "publishers_of", "topic": topic})) == endpoint(type_name, reliability)
        });
        assert_eq!(peer.ask(json!({"do": "topics"}))[topic], json!([type_name]));
    }
    wait_until("the subscription is listed with its type and QoS", || {
        let listed = peer.ask(json!({"do": "subscriptions_of", "topic": "/joint_commands"}));
        listed == endpoint(JOINT_STATE, "RELIABLE")
    });
    // Topics that the robot file does not expose are not listed.
    let topics = peer.ask(json!({"do": "topics"}));
    assert!(topics.get("/bus/exchanges").is_none() && topics.get("/joint_goals").is_none(), "{topics}");
    robot.interrupt();
    peer.leave();
}

/// The most frequent period in ms. Occasional stalls of the machine make some periods longer.
fn usual_period_ms(stamps: &[i64]) -> f64 {
    let mut periods: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
    periods.sort_unstable();
    periods[periods.len() / 2] as f64 * 1e-6
}

/// Returns the stamps of the published messages and of those that rclpy received.
fn record_and_receive(domain: u16) -> Option<(Vec<i64>, Vec<i64>)> {
    let mut peer = peer(domain)?;
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let subscription = json!({
        "do": "subscribe", "topic": "/joint_states", "type": JOINT_STATE, "qos": {"depth": 1000}
    });
    peer.ask(subscription);
    let mut robot = run(domain, folder.path(), &["--record", bag.to_str().unwrap()]);
    let mut received: Vec<i64> = Vec::new();
    wait_until("joint states have arrived for long enough", || {
        let more = peer.ask(json!({"do": "take", "topic": "/joint_states"}));
        received.extend(more.as_array().unwrap().iter().map(|message| stamp_ns(&message["fields"])));
        received.len() > 600
    });
    robot.interrupt();
    peer.leave();
    let reader = Reader::open(&bag).unwrap();
    let topic = reader.topic("/joint_states").unwrap();
    let messages = reader.messages(Selection::all().topics([topic])).unwrap();
    let stamps = messages.map(|message| {
        let state: JointState = cdr::from_slice(&message.unwrap().data).unwrap();
        state.header.stamp.as_nanos()
    });
    let range = received[0]..=received[received.len() - 1];
    Some((stamps.filter(|stamp| range.contains(stamp)).collect(), received))
}

#[test]
fn joint_states_arrive_at_125_hz_without_loss() {
    let Some((published, received)) = record_and_receive(free_domain()) else { return };
    assert_eq!(received, published);
    let period = usual_period_ms(&published);
    assert!((7.2..8.8).contains(&period), "joint states come every {period} ms, not at 125 Hz");
}

#[test]
fn commands_from_rclpy_move_the_joints_they_name_until_two_seconds_after_the_last_one() {
    let domain = free_domain();
    let Some(mut peer) = peer(domain) else { return };
    let _check = check("Topics", "commands move the joints of the demo", With::Rclpy, Way::In);
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(domain, folder.path(), &[]);
    let of_joint_states = json!({"do": "subscribe", "topic": "/joint_states", "type": JOINT_STATE});
    peer.ask(of_joint_states);
    peer.ask(json!({"do": "advertise", "topic": "/joint_commands", "type": JOINT_STATE}));
    wait_until("the robot receives commands", || {
        peer.ask(json!({"do": "matched", "topic": "/joint_commands"})) == 1
    });
    let command = json!({
        "do": "publish", "topic": "/joint_commands",
        "fields": {"name": ["head_pan", "l_el"], "position": [1.0, -0.2]}
    });
    // The right arm is not commanded: the motion continues to move it.
    let (mut others, mut last) = ((f64::MAX, f64::MIN), Value::Null);
    wait_until("the commanded joints arrive, and the others move", || {
        peer.ask(command.clone());
        for message in peer.ask(json!({"do": "take", "topic": "/joint_states"})).as_array().unwrap() {
            last = message["fields"].clone();
            let other = position(&last, "r_sho_pitch");
            others = (others.0.min(other), others.1.max(other));
        }
        !last.is_null()
            && (position(&last, "head_pan") - 1.0).abs() < 0.05
            && (position(&last, "l_el") + 0.2).abs() < 0.05
            && others.1 - others.0 > 0.1
    });
    let commanded_at = stamp_ns(&last);
    wait_until("the motion takes the joint back", || {
        for message in peer.ask(json!({"do": "take", "topic": "/joint_states"})).as_array().unwrap() {
            last = message["fields"].clone();
            // One and a half seconds after the last command it must still be there.
            let is_held = stamp_ns(&last) - commanded_at < 1_500_000_000;
            assert!(!is_held || (position(&last, "head_pan") - 1.0).abs() < 0.1);
        }
        position(&last, "head_pan").abs() < 0.5
    });
    assert!(stamp_ns(&last) - commanded_at > 1_900_000_000);
    robot.interrupt();
    peer.leave();
}

/// Suspends the robot, as a debugger, a paused container or a sleeping laptop would.
#[test]
fn a_suspended_robot_is_available_again_with_all_endpoints() {
    let domain = free_domain();
    let Some(mut peer) = peer(domain) else { return };
    let _check = check("Faults", "the program is suspended and resumed", With::Rclpy, Way::Both);
    let folder = tempfile::tempdir().unwrap();
    let mut robot = run(domain, folder.path(), &[]);
    peer.ask(json!({"do": "subscribe", "topic": "/joint_states", "type": JOINT_STATE}));
    peer.ask(json!({"do": "advertise", "topic": "/joint_commands", "type": JOINT_STATE}));
    let has_joint_states =
        |peer: &mut Peer| peer.ask(json!({"do": "take", "topic": "/joint_states"})) != json!([]);
    let is_heard = |peer: &mut Peer| peer.ask(json!({"do": "matched", "topic": "/joint_commands"})) == 1;
    wait_until("the robot is available", || has_joint_states(&mut peer) && is_heard(&mut peer));

    robot.signal("-STOP");
    // When nothing more arrives, all earlier messages have arrived.
    wait_until("it is silent", || {
        std::thread::sleep(Duration::from_millis(200));
        !has_joint_states(&mut peer)
    });
    robot.signal("-CONT");
    wait_until("joint states arrive again", || has_joint_states(&mut peer));
    wait_until("commands are received again", || is_heard(&mut peer));
    let hold = json!({"do": "parameters", "node": "/darwin_op", "call": "get_parameters", "argument": ["mux.hold_s"]});
    assert_eq!(peer.ask(hold)["values"][0]["double_value"], 2.0);
    robot.interrupt();
    peer.leave();
}

#[test]
fn the_node_leaves_the_graph_within_two_seconds_of_a_signal() {
    for signal in ["-INT", "-TERM"] {
        let domain = free_domain();
        let Some(mut peer) = peer(domain) else { return };
        let _check = check(
            "Graph",
            "the program leaves the graph immediately when it is stopped",
            With::Rclpy,
            Way::Out,
        );
        let folder = tempfile::tempdir().unwrap();
        let mut robot = run(domain, folder.path(), &[]);
        wait_until("the node is listed", || has(&peer.ask(json!({"do": "nodes"})), "/darwin_op"));
        robot.signal(signal);
        let signalled = Instant::now();
        wait_until("the node has disappeared", || !has(&peer.ask(json!({"do": "nodes"})), "/darwin_op"));
        wait_until("its topics have disappeared", || {
            peer.ask(json!({"do": "topics"})).get("/joint_states").is_none()
        });
        let took = signalled.elapsed();
        assert!(took < Duration::from_secs(2), "{took:?} after {signal}");
        assert!(robot.wait().success(), "{}", robot.output());
        peer.leave();
    }
}
