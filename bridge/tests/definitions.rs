//! Peers with another definition of a type are logged before their first message.
#![allow(clippy::unwrap_used)]

mod common;

use common::wait_until;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::{Endpoint, Middleware, Sample};
use downbeat_bridge::ros::{MessageType, NodeName, Participant};
use downbeat_bridge::rosout::Rosout;
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::Log;
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolResponse};
use std::sync::Arc;
use std::sync::mpsc::channel;
use tracing_subscriber::prelude::*;

fn hash(digit: &str) -> Option<String> {
    Some(format!("RIHS01_{}", digit.repeat(64)))
}

#[test]
fn each_peer_with_another_definition_is_logged_once_with_both_hashes() {
    let (rosout, hub) = (Rosout::new(), Hub::new());
    // The layer has to be that of all threads: peers are compared on the worker's.
    tracing_subscriber::registry().with(rosout.layer()).init();
    let participant = Participant::on(Arc::new(hub.join())).unwrap();
    let node = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let listener = Participant::on(Arc::new(hub.join())).unwrap();
    let listener = listener.create_node(NodeName::new("/", "listener").unwrap()).unwrap();
    let (sender, samples) = channel();
    let on_sample = Box::new(move |sample: Sample| drop(sender.send(sample)));
    let log = MessageType::new("rcl_interfaces/msg/Log").unwrap();
    let _subscription = listener.subscribe("/rosout", &log, QosProfile::ROSOUT, on_sample).unwrap();
    let _publishing = rosout.publish(&node).unwrap();

    let string = MessageType::new("std_msgs/msg/String").unwrap();
    let publisher = node.publish("words", &string, QosProfile::DEFAULT).unwrap();
    let _subscription = node.subscribe("heard", &string, QosProfile::DEFAULT, Box::new(|_| ())).unwrap();
    let answer = |_| SetBoolResponse::default();
    let _service = node.serve::<SetBool>("light", QosProfile::SERVICES, answer).unwrap();
    let _client = node.client::<SetBool>("lamp", QosProfile::SERVICES).unwrap();

    let others = hub.join();
    let endpoint = |topic: &str, kind: &str, type_hash: Option<String>| Endpoint {
        type_hash,
        ..Endpoint::new(topic, kind, QosProfile::SERVICES)
    };
    let text = "std_msgs::msg::dds_::String_";
    let request = "std_srvs::srv::dds_::SetBool_Request_";
    let response = "std_srvs::srv::dds_::SetBool_Response_";
    let ours = participant.interfaces().message_hash("std_msgs/msg/String");
    let of_request = participant.interfaces().message_hash("std_srvs/srv/SetBool_Request");
    let reader =
        |topic, kind, hash| others.create_reader(&endpoint(topic, kind, hash), Box::new(|_| ())).unwrap();
    let writer = |topic, kind, hash| others.create_writer(&endpoint(topic, kind, hash)).unwrap();
    let _readers = [
        reader("rt/words", text, ours),
        reader("rt/words", text, None),
        reader("rt/words", text, hash("1")),
        // As rmw_fastrtps_cpp announces it.
        reader("rr/lightReply", response, of_request),
        reader("rr/lightReply", response, hash("2")),
        reader("rq/lampRequest", request, hash("3")),
    ];
    let _writers = [writer("rt/heard", text, hash("4")), writer("rq/lightRequest", request, hash("5"))];
    // The present state comes again with each new handler.
    publisher.on_event(Box::new(|_| ()));

    let mut lines: Vec<String> = Vec::new();
    let mut is_heard = |mark: &str| {
        let heard = samples.try_iter().map(|sample| cdr::from_slice::<Log>(&sample.cdr).unwrap().msg);
        lines.extend(heard.filter(|line| line.contains("another definition") || line == "all were compared"));
        lines.iter().any(|line| line.contains(mark))
    };
    for digit in ["1", "2", "3", "4", "5"] {
        wait_until("the difference is logged", || is_heard(&hash(digit).unwrap()));
    }
    tracing::warn!("all were compared");
    wait_until("the last line comes", || is_heard("all were compared"));
    assert_eq!(lines.len(), 6, "{lines:#?}");
    let of = |digit: &str| {
        lines
            .iter()
            .find(|line| line.contains(&hash(digit).unwrap()))
            .unwrap()
            .split(": its hash")
            .next()
            .unwrap()
    };
    let expected = |of: &str, kind: &str| format!("{of}: another node has another definition of {kind}");
    assert_eq!(of("1"), expected("topic '/words'", "std_msgs/msg/String"));
    assert_eq!(of("2"), expected("service '/light'", "std_srvs/srv/SetBool_Response"));
    assert_eq!(of("3"), expected("service '/lamp'", "std_srvs/srv/SetBool_Request"));
    assert_eq!(of("4"), expected("topic '/heard'", "std_msgs/msg/String"));
    assert_eq!(of("5"), expected("service '/light'", "std_srvs/srv/SetBool_Request"));
}
