//! Names by remapping rules and quality of service by who is there, with the real rclpy.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{on_loopback, wait_until};
use downbeat_bridge::middleware::{Direction, RemoteEndpoint};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, QosRequest, RemapRules};
use downbeat_msgs::qos::{Durability, History, Liveliness, QosProfile, Reliability};
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use serde_json::{Value, json};
use std::time::Duration;
use test_machine::free_domain;

const NS: Duration = Duration::from_nanos(1);

fn downbeat(domain_id: u16, rules: &[&str]) -> (Participant, Node) {
    let rules: RemapRules = rules.iter().map(|rule| rule.parse().unwrap()).collect();
    let participant =
        Participant::join_with(&on_loopback(domain_id), rules, downbeat_bridge::edge::Interfaces::carried())
            .unwrap();
    let node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    (participant, node)
}

fn string() -> MessageType {
    MessageType::new("std_msgs/msg/String").unwrap()
}

#[test]
fn rclpy_sees_nodes_topics_and_services_under_their_new_names() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check =
        check("Selection", "remapping rules: node, namespace, topics, services", With::Rclpy, Way::Out);
    let rules =
        ["__ns:=/robot1", "downbeat:__node:=left", "rostopic://text:=/said", "rosservice://text:=~/say"];
    let (_participant, node) = downbeat(domain, &rules);
    let camera = node.sibling(&NodeName::new("/sensors", "camera").unwrap()).unwrap();
    let _text = node.publish("text", &string(), QosProfile::DEFAULT).unwrap();
    let _image = camera.publish("~/text", &string(), QosProfile::DEFAULT).unwrap();
    let answer =
        |request: SetBoolRequest| SetBoolResponse { success: request.data, ..SetBoolResponse::default() };
    let service = node.serve::<SetBool>("text", QosProfile::SERVICES, answer).unwrap();
    assert_eq!(service.name().as_str(), "/robot1/left/say");

    rclpy.ask(json!({"do": "client", "service": "/robot1/left/say", "type": "std_srvs/srv/SetBool"}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": "/robot1/left/say"})), true);
    let call = json!({"do": "call", "service": "/robot1/left/say", "requests": [{"data": true}]});
    assert_eq!(rclpy.ask(call)[0]["success"], true);
    wait_until("rclpy lists both nodes with their topics", || {
        let node_of = |rclpy: &mut Peer, topic: &str| {
            rclpy.ask(json!({"do": "publishers_of", "topic": topic}))[0]["node"].clone()
        };
        node_of(&mut rclpy, "/said") == "/robot1/left"
            && node_of(&mut rclpy, "/robot1/camera/text") == "/robot1/camera"
    });
    let nodes = rclpy.ask(json!({"do": "nodes"}));
    let is_listed = |name: &str| nodes.as_array().unwrap().iter().any(|node| node == name);
    assert!(is_listed("/robot1/left") && !is_listed("/downbeat") && !is_listed("/sensors/camera"), "{nodes}");
}

/// The endpoint of rclpy on a topic, when it is found.
fn found(participant: &Participant, topic: &str) -> RemoteEndpoint {
    let mut found = None;
    wait_until("the endpoint is found", || {
        let mut endpoints = participant.remote_endpoints().into_iter();
        found = endpoints.find(|endpoint| endpoint.topic_name == format!("rt{topic}"));
        found.is_some()
    });
    found.unwrap()
}

#[test]
fn what_is_best_available_is_decided_by_the_endpoints_of_rclpy() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Quality of service", "best_available", With::Rclpy, Way::Both);
    let (participant, node) = downbeat(domain, &[]);
    let kind = "std_msgs/msg/String";
    let mut ask = |command: &str, topic: &str, qos: Value| {
        rclpy.ask(json!({"do": command, "topic": topic, "type": kind, "qos": qos}));
        found(&participant, topic)
    };
    let qos = json!({
        "reliability": "best_effort", "deadline_ms": 80, "liveliness": "manual_by_topic", "lease_ms": 300
    });
    let sensor = ask("advertise", "/sensor", qos);
    assert_eq!(
        (sensor.deadline, sensor.liveliness, sensor.liveliness_lease_duration),
        (Some(Duration::from_millis(80)), Liveliness::ManualByTopic, Some(Duration::from_millis(300)))
    );
    ask("advertise", "/latched", json!({"durability": "transient_local"}));
    let wanted = ask("subscribe", "/wanted", json!({"deadline_ms": 50}));
    assert_eq!(
        (wanted.deadline, wanted.liveliness),
        (Some(Duration::from_millis(50)), Liveliness::Automatic)
    );

    let best =
        |topic: &str, direction| node.resolve_qos(topic, direction, &QosRequest::BEST_AVAILABLE).unwrap();
    let of_sensor = best("/sensor", Direction::In);
    let expected = QosProfile {
        history: History::KeepLast(10),
        reliability: Reliability::BestEffort,
        deadline: Some(Duration::from_millis(80) + NS),
        liveliness: Liveliness::ManualByTopic,
        liveliness_lease_duration: Some(Duration::from_millis(300) + NS),
        ..QosProfile::DEFAULT
    };
    assert_eq!(of_sensor, expected);
    let of_latched = best("/latched", Direction::In);
    assert_eq!(
        (of_latched.reliability, of_latched.durability),
        (Reliability::Reliable, Durability::TransientLocal)
    );
    let of_wanted = best("/wanted", Direction::Out);
    assert_eq!(
        (of_wanted.durability, of_wanted.deadline),
        (Durability::TransientLocal, wanted.deadline.map(|deadline| deadline - NS))
    );

    // What was decided matches, though times are rounded on the wire.
    let on_sample = |_| Box::new(|_| ());
    let sensor = node.subscribe("/sensor", &string(), of_sensor, on_sample(())).unwrap();
    let latched = node.subscribe("/latched", &string(), of_latched, on_sample(())).unwrap();
    let wanted = node.publish("/wanted", &string(), of_wanted).unwrap();
    wait_until("all are matched", || {
        sensor.matched_publishers() == 1
            && latched.matched_publishers() == 1
            && wanted.matched_subscriptions() == 1
    });
}
