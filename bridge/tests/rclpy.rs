//! What the real rclpy sees of our nodes, and we of its.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{next, on_loopback, wait_until};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{Exposure, expose};
use downbeat_bridge::middleware::{Direction, Sample};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Subscription};
use downbeat_executor::{Context, Core, Module, Received, Setup, SetupError};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::sensor_msgs::msg::JointState;
use downbeat_msgs::std_msgs::msg::Header;
use serde_json::{Value, json};
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::{Duration, Instant};
use test_machine::free_domain;

const TRANSIENT_LOCAL: QosProfile =
    QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT };

/// Node `/robot/downbeat` in a domain on loopback.
fn downbeat(domain_id: u16) -> (Participant, Node) {
    let participant = Participant::join(&on_loopback(domain_id)).unwrap();
    let node = participant.create_node(NodeName::new("/robot", "downbeat").unwrap()).unwrap();
    (participant, node)
}

fn subscribe(
    node: &Node,
    topic: &str,
    kind: &MessageType,
    qos: QosProfile,
) -> (Subscription, Receiver<Sample>) {
    let (sender, samples) = channel();
    let handler = Box::new(move |sample| {
        // The test may have stopped listening.
        let _ = sender.send(sample);
    });
    (node.subscribe(topic, kind, qos, handler).unwrap(), samples)
}

fn joint_state() -> MessageType {
    MessageType::new("sensor_msgs/msg/JointState").unwrap()
}

fn string() -> MessageType {
    MessageType::new("std_msgs/msg/String").unwrap()
}

fn nodding() -> JointState {
    JointState {
        header: Header { frame_id: "base_link".into(), ..Header::default() },
        name: vec!["head_pan".into(), "head_tilt".into()],
        position: vec![0.25, -0.5],
        velocity: vec![],
        effort: vec![1.0, f64::MAX],
    }
}

fn lists(answer: &Value, entry: &str) -> bool {
    answer.as_array().unwrap().iter().any(|item| item == entry)
}

#[test]
fn rclpy_lists_our_node_with_its_topics_types_and_qos() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _nodes = check("Graph", "node names", With::Rclpy, Way::Out);
    let _endpoints =
        check("Graph", "topics of a node with type, reliability, durability", With::Rclpy, Way::Out);
    let (_participant, node) = downbeat(domain);
    let _states = node.publish("/joint_states", &joint_state(), QosProfile::DEFAULT).unwrap();
    let _text = node.publish("~/text", &string(), TRANSIENT_LOCAL).unwrap();
    let _commands = subscribe(&node, "joint_commands", &joint_state(), QosProfile::SENSOR_DATA);

    wait_until("rclpy lists the node", || lists(&rclpy.ask(json!({"do": "nodes"})), "/robot/downbeat"));
    let topics = ["/joint_states", "/robot/downbeat/text", "/robot/joint_commands"];
    wait_until("rclpy lists the topics", || {
        let listed = rclpy.ask(json!({"do": "topics"}));
        topics.iter().all(|topic| listed.get(topic).is_some())
    });
    let listed = rclpy.ask(json!({"do": "topics"}));
    assert_eq!(listed["/joint_states"], json!(["sensor_msgs/msg/JointState"]));
    assert_eq!(listed["/robot/downbeat/text"], json!(["std_msgs/msg/String"]));

    let endpoint = |kind, reliability, durability| json!([{"node": "/robot/downbeat", "type": kind, "reliability": reliability, "durability": durability}]);
    let mut wait_for = |command: Value, expected: Value| {
        let mut last = Value::Null;
        let found = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
            wait_until("rclpy knows the endpoint and its node", || {
                last = rclpy.ask(command.clone());
                last == expected
            });
        }));
        assert!(found.is_ok(), "{command}: expected {expected}, last answer {last}");
    };
    wait_for(
        json!({"do": "publishers_of", "topic": "/joint_states"}),
        endpoint("sensor_msgs/msg/JointState", "RELIABLE", "VOLATILE"),
    );
    wait_for(
        json!({"do": "publishers_of", "topic": "/robot/downbeat/text"}),
        endpoint("std_msgs/msg/String", "RELIABLE", "TRANSIENT_LOCAL"),
    );
    wait_for(
        json!({"do": "subscriptions_of", "topic": "/robot/joint_commands"}),
        endpoint("sensor_msgs/msg/JointState", "BEST_EFFORT", "VOLATILE"),
    );
}

#[test]
fn what_we_publish_reaches_rclpy_unchanged() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Topics", "reliable messages, byte for byte", With::Rclpy, Way::Out);
    let (_participant, node) = downbeat(domain);
    rclpy.ask(json!({
        "do": "subscribe", "topic": "/joint_states", "type": "sensor_msgs/msg/JointState", "qos": {"depth": 100},
    }));
    let states = node.publish("/joint_states", &joint_state(), QosProfile::DEFAULT).unwrap();
    wait_until("both are matched", || {
        states.matched_subscriptions() == 1
            && rclpy.ask(json!({"do": "matched", "topic": "/joint_states"})) == 1
    });
    let sent = cdr::to_vec(&nodding());
    for _ in 0..100 {
        states.publish(sent.clone().into()).unwrap();
    }
    let received = rclpy.take("/joint_states", 100);
    assert_eq!(received.len(), 100);
    for message in received {
        let bytes = from_hex(message["cdr"].as_str().unwrap());
        assert_eq!(bytes[..sent.len()], sent[..], "the bytes");
        assert_eq!(message["fields"]["name"], json!(["head_pan", "head_tilt"]));
        assert_eq!(message["fields"]["position"], json!([0.25, -0.5]));
        assert_eq!(message["fields"]["header"]["frame_id"], "base_link");
    }
}

#[test]
fn what_rclpy_publishes_reaches_us_unchanged() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Topics", "reliable messages, byte for byte", With::Rclpy, Way::In);
    let (_participant, node) = downbeat(domain);
    let (commands, samples) = subscribe(&node, "/joint_commands", &joint_state(), QosProfile::DEFAULT);
    rclpy.ask(json!({"do": "advertise", "topic": "/joint_commands", "type": "sensor_msgs/msg/JointState"}));
    wait_until("both are matched", || {
        commands.matched_publishers() == 1
            && rclpy.ask(json!({"do": "matched", "topic": "/joint_commands"})) == 1
    });
    let fields = json!({
        "header": {"frame_id": "base_link"}, "name": ["head_pan", "head_tilt"],
        "position": [0.25, -0.5], "effort": [1.0, f64::MAX],
    });
    for number in 1..=100 {
        let publish = json!({"do": "publish", "topic": "/joint_commands", "fields": fields});
        rclpy.ask(publish);
        let sample = next(&samples);
        // Not compared with the bytes of serialize_message: rclpy leaves its padding uninitialised.
        assert_eq!(sample.cdr.len(), cdr::to_vec(&nodding()).len());
        assert_eq!(sample.sequence_number, number);
        assert!(sample.source_time_ns.is_some());
        assert_eq!(cdr::from_slice::<JointState>(&sample.cdr).unwrap(), nodding());
    }
}

#[test]
fn our_node_is_gone_from_rclpy_within_two_seconds_of_our_leaving() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Graph", "a node that leaves disappears immediately", With::Rclpy, Way::Out);
    let (participant, node) = downbeat(domain);
    let states = node.publish("/joint_states", &joint_state(), QosProfile::DEFAULT).unwrap();
    let commands = subscribe(&node, "/joint_commands", &joint_state(), QosProfile::DEFAULT);
    wait_until("rclpy lists the node", || lists(&rclpy.ask(json!({"do": "nodes"})), "/robot/downbeat"));

    drop((participant, node, states, commands));
    let left = Instant::now();
    wait_until("the node is gone", || !lists(&rclpy.ask(json!({"do": "nodes"})), "/robot/downbeat"));
    wait_until("its topics are gone", || {
        let topics = rclpy.ask(json!({"do": "topics"}));
        topics.get("/joint_states").is_none() && topics.get("/joint_commands").is_none()
    });
    assert!(left.elapsed() < Duration::from_secs(2), "gone after {:?}", left.elapsed());
}

#[test]
fn we_name_the_node_of_rclpy_and_its_topics_until_it_leaves() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _nodes = check("Graph", "node names", With::Rclpy, Way::In);
    let _gone = check("Graph", "a node that leaves disappears immediately", With::Rclpy, Way::In);
    let (participant, node) = downbeat(domain);
    let (text, _samples) = subscribe(&node, "/text", &string(), QosProfile::DEFAULT);
    rclpy.ask(json!({"do": "advertise", "topic": "/text", "type": "std_msgs/msg/String"}));
    wait_until("we know the node and its topic", || {
        participant.remote_nodes().iter().any(|node| {
            node.name == "/peer"
                && node.endpoints.iter().any(|endpoint| {
                    endpoint.topic.as_str() == "/text"
                        && endpoint.message_type == string()
                        && endpoint.is_published
                })
        })
    });
    wait_until("its publisher is matched", || text.matched_publishers() == 1);
    rclpy.leave();
    wait_until("its publisher is gone", || text.matched_publishers() == 0);
    wait_until("it is gone", || participant.remote_nodes().is_empty());
}

#[test]
fn transient_local_messages_reach_those_that_come_late() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _out = check("Topics", "latched messages to late joiners", With::Rclpy, Way::Out);
    let _in = check("Topics", "latched messages to late joiners", With::Rclpy, Way::In);
    let (_participant, node) = downbeat(domain);
    let latched = json!({"durability": "transient_local", "depth": 1});
    let ours = node.publish("/ours", &string(), QosProfile::LATCHED).unwrap();
    let text = |data: &str| cdr::to_vec(&downbeat_msgs::std_msgs::msg::String { data: data.into() });
    ours.publish(text("from us").into()).unwrap();
    rclpy.ask(json!({"do": "advertise", "topic": "/theirs", "type": "std_msgs/msg/String", "qos": latched}));
    rclpy.ask(json!({"do": "publish", "topic": "/theirs", "fields": {"data": "from rclpy"}}));

    let kind = "std_msgs/msg/String";
    rclpy.ask(json!({"do": "subscribe", "topic": "/ours", "type": kind, "qos": latched}));
    assert_eq!(rclpy.take("/ours", 1)[0]["fields"]["data"], "from us");
    let (_subscription, samples) = subscribe(&node, "/theirs", &string(), QosProfile::LATCHED);
    let sample = next(&samples);
    assert_eq!(sample.cdr[..text("from rclpy").len()], text("from rclpy")[..]);
}

/// Publishes its count as a joint position every 8 ms, and passes on the commands it hears.
struct Robot {
    count: u32,
    commands: Sender<JointState>,
}

impl Module for Robot {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let states = setup.publish::<JointState>("joint_states")?;
        setup.every(Duration::from_millis(8), move |robot: &mut Self, ctx| {
            robot.count += 1;
            ctx.publish(
                states,
                JointState { position: vec![f64::from(robot.count)], ..JointState::default() },
            );
        })?;
        let pass_on = |robot: &mut Self, command: Received<'_, JointState>, _: &mut Context<'_>| {
            robot.commands.send(command.clone()).unwrap();
        };
        setup.subscribe("joint_commands", pass_on)
    }
}

#[test]
fn a_running_core_is_seen_and_driven_from_rclpy_and_leaves_at_once() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Topics", "topics of a running core at 125 Hz without loss", With::Rclpy, Way::Both);
    let (participant, node) = downbeat(domain);
    let mut core = Core::new();
    let (sender, commands) = channel();
    core.add("robot", Robot { count: 0, commands: sender }).unwrap();
    let joint_state = Interfaces::carried().message("sensor_msgs/msg/JointState").unwrap();
    let exposure = |topic: &str, direction| Exposure {
        ros_topic: Some(format!("/{topic}")),
        qos: QosProfile::DEFAULT.keep_last(100).into(),
        ..Exposure::new(topic, joint_state, direction)
    };
    let exposures = [exposure("joint_states", Direction::Out), exposure("joint_commands", Direction::In)];
    let status = expose(&mut core, &node, &exposures).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run());

    let (kind, qos) = ("sensor_msgs/msg/JointState", json!({"depth": 1000}));
    rclpy.ask(json!({"do": "subscribe", "topic": "/joint_states", "type": kind, "qos": qos}));
    rclpy.ask(json!({"do": "advertise", "topic": "/joint_commands", "type": kind}));
    let counts: Vec<u64> = rclpy
        .take("/joint_states", 250)
        .iter()
        .map(|state| state["fields"]["position"][0].as_f64().unwrap() as u64)
        .collect();
    assert!(
        counts.windows(2).all(|pair| pair[1] == pair[0] + 1),
        "none is lost, none comes twice: {counts:?}"
    );

    wait_until("the command topic is matched", || {
        status.endpoints()[1].traffic.matched == 1
            && rclpy.ask(json!({"do": "matched", "topic": "/joint_commands"})) == 1
    });
    rclpy.ask(json!({"do": "publish", "topic": "/joint_commands", "fields": {"name": ["head_pan"]}}));
    assert_eq!(commands.recv_timeout(common::WATCHDOG).unwrap().name, ["head_pan"]);

    // A message is counted after it was passed on, on the thread that read it.
    wait_until("the command is counted", || status.endpoints()[1].traffic.messages == 1);
    let reports = status.endpoints();
    assert_eq!((reports[0].traffic.matched, reports[0].traffic.errors), (1, 0));
    assert!(reports[0].traffic.messages >= 250);

    handle.stop();
    running.join().unwrap().unwrap();
    drop((node, participant));
    let left = Instant::now();
    wait_until("the node is gone", || !lists(&rclpy.ask(json!({"do": "nodes"})), "/robot/downbeat"));
    assert!(left.elapsed() < Duration::from_secs(2), "gone after {:?}", left.elapsed());
}

#[test]
fn a_subscriber_that_was_killed_does_not_stop_the_others() {
    let domain = free_domain();
    let Some(mut killed) = Peer::start(domain, "LOCALHOST") else { return };
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check(
        "Faults",
        "other subscribers receive messages after a subscriber was killed",
        With::Rclpy,
        Way::Out,
    );
    let (_participant, node) = downbeat(domain);
    let text = node.publish("/text", &string(), QosProfile::DEFAULT).unwrap();
    let subscribe =
        json!({"do": "subscribe", "topic": "/text", "type": "std_msgs/msg/String", "qos": {"depth": 1000}});
    killed.ask(subscribe.clone());
    rclpy.ask(subscribe);
    wait_until("both are matched", || {
        text.matched_subscriptions() == 2 && rclpy.ask(json!({"do": "matched", "topic": "/text"})) == 1
    });
    drop(killed);
    let message = cdr::to_vec(&downbeat_msgs::std_msgs::msg::String { data: "still here".into() });
    for _ in 0..500 {
        text.publish(message.clone().into()).unwrap();
    }
    assert_eq!(text.matched_subscriptions(), 2, "nobody has noticed yet that one was killed");
    assert_eq!(rclpy.take("/text", 500).len(), 500);
}

fn from_hex(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap()).collect()
}
