//! Topics with the second vendor of DDS: the engine of rmw_cyclonedds_cpp.
#![allow(clippy::unwrap_used)]

mod common;

use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{next, on_loopback, wait_until};
use downbeat_bridge::middleware::{Direction, Sample};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Publisher, Subscription};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::{History, Liveliness, QosProfile, Reliability};
use downbeat_msgs::sensor_msgs::msg::{CompressedImage, JointState};
use downbeat_msgs::std_msgs::msg::{Header, String as Text};
use serde_json::{Value, json};
use test_machine::free_domain;

const TEXT: &str = "std_msgs/msg/String";
const JOINT_STATE: &str = "sensor_msgs/msg/JointState";
const BEST_EFFORT: QosProfile = QosProfile { reliability: Reliability::BestEffort, ..QosProfile::DEFAULT };

fn downbeat(domain_id: u16) -> (Participant, Node) {
    let participant = Participant::join(&on_loopback(domain_id)).unwrap();
    let node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    (participant, node)
}

fn publish(node: &Node, topic: &str, kind: &str, qos: QosProfile) -> Publisher {
    node.publish(topic, &MessageType::new(kind).unwrap(), qos).unwrap()
}

fn subscribe(node: &Node, topic: &str, kind: &str, qos: QosProfile) -> (Subscription, Receiver<Sample>) {
    let (sender, samples) = channel();
    let handler = Box::new(move |sample| {
        // The test may have stopped listening.
        let _ = sender.send(sample);
    });
    (node.subscribe(topic, &MessageType::new(kind).unwrap(), qos, handler).unwrap(), samples)
}

fn text(data: impl Into<String>) -> bytes::Bytes {
    cdr::to_vec(&Text { data: data.into() }).into()
}

fn text_of(sample: &Sample) -> String {
    cdr::from_slice::<Text>(&sample.cdr).unwrap().data
}

fn advertise(peer: &mut Peer, topic: &str, kind: &str, qos: Value) {
    peer.ask(json!({"do": "advertise", "topic": topic, "type": kind, "qos": qos}));
}

fn listen(peer: &mut Peer, topic: &str, kind: &str, qos: Value) {
    peer.ask(json!({"do": "subscribe", "topic": topic, "type": kind, "qos": qos}));
}

fn say(peer: &mut Peer, topic: &str, data: &str) {
    peer.ask(json!({"do": "publish", "topic": topic, "fields": {"data": data}}));
}

fn is_matched(peer: &mut Peer, topic: &str) -> bool {
    peer.ask(json!({"do": "matched", "topic": topic})) == 1
}

fn texts(messages: &[Value]) -> Vec<&str> {
    messages.iter().map(|message| message["fields"]["data"].as_str().unwrap()).collect()
}

#[test]
fn what_we_publish_reaches_cyclone() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Topics", "reliable messages, byte for byte", With::Cyclone, Way::Out);
    let (_participant, node) = downbeat(domain);
    listen(&mut peer, "/joint_states", JOINT_STATE, json!({"depth": 1000}));
    let states = publish(&node, "/joint_states", JOINT_STATE, QosProfile::DEFAULT);
    wait_until("both are matched", || {
        states.matched_subscriptions() == 1 && is_matched(&mut peer, "/joint_states")
    });
    let send = |number: f64| {
        let state = JointState {
            header: Header { frame_id: "base_link".into(), ..Header::default() },
            name: vec!["head_pan".into(), "head_tilt".into()],
            position: vec![0.25, number],
            ..JointState::default()
        };
        states.publish(cdr::to_vec(&state).into()).unwrap();
    };
    (0..100).for_each(|number| send(f64::from(number)));
    for (number, message) in peer.take("/joint_states", 100).iter().enumerate() {
        assert_eq!(message["fields"]["name"], json!(["head_pan", "head_tilt"]));
        assert_eq!(message["fields"]["position"], json!([0.25, number as f64]));
        assert_eq!(message["fields"]["header"]["frame_id"], "base_link");
    }
}

#[test]
fn what_cyclone_publishes_reaches_us() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Topics", "reliable messages, byte for byte", With::Cyclone, Way::In);
    let (_participant, node) = downbeat(domain);
    let (commands, samples) = subscribe(&node, "/joint_commands", JOINT_STATE, QosProfile::DEFAULT);
    advertise(&mut peer, "/joint_commands", JOINT_STATE, json!({"depth": 1000}));
    wait_until("both are matched", || {
        commands.matched_publishers() == 1 && is_matched(&mut peer, "/joint_commands")
    });
    for number in 1..=100 {
        let fields =
            json!({"name": ["head_pan"], "position": [f64::from(number)], "header": {"frame_id": "map"}});
        peer.ask(json!({"do": "publish", "topic": "/joint_commands", "fields": fields}));
        let sample = next(&samples);
        assert_eq!(sample.sequence_number, i64::from(number));
        assert!(sample.source_time_ns.is_some());
        let command: JointState = cdr::from_slice(&sample.cdr).unwrap();
        assert_eq!((&*command.name[0], command.position[0]), ("head_pan", f64::from(number)));
        assert_eq!(command.header.frame_id, "map");
    }
}

#[test]
fn best_effort_messages_pass() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _out = check("Quality of service", "best effort", With::Cyclone, Way::Out);
    let _in = check("Quality of service", "best effort", With::Cyclone, Way::In);
    let (_participant, node) = downbeat(domain);
    let best_effort = json!({"reliability": "best_effort", "depth": 100});
    listen(&mut peer, "/ours", TEXT, best_effort.clone());
    advertise(&mut peer, "/theirs", TEXT, best_effort);
    let ours = publish(&node, "/ours", TEXT, BEST_EFFORT);
    let (theirs, samples) = subscribe(&node, "/theirs", TEXT, BEST_EFFORT);
    wait_until("all are matched", || {
        ours.matched_subscriptions() == 1
            && theirs.matched_publishers() == 1
            && is_matched(&mut peer, "/ours")
    });
    // What nobody acknowledges may be lost, on loopback not all of it.
    wait_until("Cyclone hears us", || {
        ours.publish(text("from us")).unwrap();
        peer.ask(json!({"do": "take", "topic": "/ours"})).as_array().is_some_and(|taken| !taken.is_empty())
    });
    wait_until("we hear Cyclone", || {
        say(&mut peer, "/theirs", "from cyclone");
        samples.try_recv().is_ok_and(|sample| text_of(&sample) == "from cyclone")
    });
}

#[test]
fn latched_messages_reach_those_that_come_late() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _out = check("Topics", "latched messages to late joiners", With::Cyclone, Way::Out);
    let _in = check("Topics", "latched messages to late joiners", With::Cyclone, Way::In);
    let (_participant, node) = downbeat(domain);
    let latched = json!({"durability": "transient_local", "depth": 1});
    let ours = publish(&node, "/ours", TEXT, QosProfile::LATCHED);
    ours.publish(text("from us")).unwrap();
    advertise(&mut peer, "/theirs", TEXT, latched.clone());
    say(&mut peer, "/theirs", "from cyclone");

    listen(&mut peer, "/ours", TEXT, latched);
    assert_eq!(texts(&peer.take("/ours", 1)), ["from us"]);
    let (_subscription, samples) = subscribe(&node, "/theirs", TEXT, QosProfile::LATCHED);
    assert_eq!(text_of(&next(&samples)), "from cyclone");
}

#[test]
fn a_reliable_subscription_does_not_match_a_best_effort_publisher() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _out =
        check("Quality of service", "incompatible reliability does not match", With::Cyclone, Way::Out);
    let _in = check("Quality of service", "incompatible reliability does not match", With::Cyclone, Way::In);
    let (participant, node) = downbeat(domain);
    listen(&mut peer, "/ours", TEXT, json!({"reliability": "reliable"}));
    advertise(&mut peer, "/theirs", TEXT, json!({"reliability": "best_effort"}));
    let ours = publish(&node, "/ours", TEXT, BEST_EFFORT);
    let (theirs, _samples) = subscribe(&node, "/theirs", TEXT, QosProfile::DEFAULT);
    // A second, compatible pair shows when discovery is done with the first.
    listen(&mut peer, "/control", TEXT, json!({}));
    let control = publish(&node, "/control", TEXT, QosProfile::DEFAULT);
    wait_until("the compatible pair is matched", || control.matched_subscriptions() == 1);
    wait_until("the others are known", || {
        let known = |topic: &str, direction| {
            participant
                .remote_endpoints()
                .iter()
                .any(|endpoint| endpoint.topic_name == topic && endpoint.direction == direction)
        };
        known("rt/ours", Direction::In) && known("rt/theirs", Direction::Out)
    });
    assert_eq!((ours.matched_subscriptions(), theirs.matched_publishers()), (0, 0));
    assert!(!is_matched(&mut peer, "/ours") && !is_matched(&mut peer, "/theirs"));
}

#[test]
fn deadlines_and_leases_that_are_offered_satisfy_those_that_are_longer() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _deadline =
        check("Quality of service", "deadline and liveliness lease match", With::Cyclone, Way::Out);
    let (_participant, node) = downbeat(domain);
    let offered = QosProfile {
        deadline: Some(Duration::from_millis(100)),
        liveliness: Liveliness::Automatic,
        liveliness_lease_duration: Some(Duration::from_secs(5)),
        ..QosProfile::DEFAULT
    };
    let ours = publish(&node, "/ours", TEXT, offered);
    let strict = publish(&node, "/strict", TEXT, QosProfile::DEFAULT);
    listen(&mut peer, "/ours", TEXT, json!({"deadline_ms": 200, "lease_ms": 10_000}));
    listen(&mut peer, "/strict", TEXT, json!({"deadline_ms": 200}));
    wait_until("the one that satisfies is matched", || {
        ours.matched_subscriptions() == 1 && is_matched(&mut peer, "/ours")
    });
    assert_eq!(strict.matched_subscriptions(), 0, "no deadline is offered");
    ours.publish(text("in time")).unwrap();
    assert_eq!(texts(&peer.take("/ours", 1)), ["in time"]);
}

#[test]
fn what_is_kept_whole_arrives_whole() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Quality of service", "keep all", With::Cyclone, Way::In);
    let (_participant, node) = downbeat(domain);
    let keep_all = QosProfile { history: History::KeepAll, ..QosProfile::DEFAULT };
    let (theirs, samples) = subscribe(&node, "/theirs", TEXT, keep_all);
    advertise(&mut peer, "/theirs", TEXT, json!({"history": "keep_all"}));
    wait_until("both are matched", || theirs.matched_publishers() == 1 && is_matched(&mut peer, "/theirs"));
    for number in 0..1000 {
        say(&mut peer, "/theirs", &number.to_string());
    }
    for number in 0..1000 {
        assert_eq!(text_of(&next(&samples)), number.to_string());
    }
}

#[test]
fn compressed_images_of_100_kb_arrive_both_ways() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _out = check("Topics", "30 compressed images of 100 kB in succession", With::Cyclone, Way::Out);
    let _in = check("Topics", "30 compressed images of 100 kB in succession", With::Cyclone, Way::In);
    let (_participant, node) = downbeat(domain);
    let kind = "sensor_msgs/msg/CompressedImage";
    listen(&mut peer, "/ours", kind, json!({"depth": 50}));
    advertise(&mut peer, "/theirs", kind, json!({"depth": 50}));
    let ours = publish(&node, "/ours", kind, QosProfile::DEFAULT);
    let (theirs, samples) = subscribe(&node, "/theirs", kind, QosProfile::DEFAULT);
    wait_until("all are matched", || {
        ours.matched_subscriptions() == 1
            && theirs.matched_publishers() == 1
            && is_matched(&mut peer, "/ours")
            && is_matched(&mut peer, "/theirs")
    });
    let data: Vec<u8> = (0..100_000_u32).map(|index| (index % 251) as u8).collect();
    let image = CompressedImage { format: "jpeg".into(), data, ..CompressedImage::default() };
    for _ in 0..30 {
        ours.publish(cdr::to_vec(&image).into()).unwrap();
        let received = peer.take("/ours", 1);
        assert_eq!(received[0]["fields"]["data"], json!(image.data));
    }
    for _ in 0..30 {
        let fields = json!({"format": "jpeg", "data": image.data});
        peer.ask(json!({"do": "publish", "topic": "/theirs", "fields": fields}));
        assert_eq!(cdr::from_slice::<CompressedImage>(&next(&samples).cdr).unwrap(), image);
    }
}

#[test]
fn an_endpoint_of_ours_that_is_removed_is_unmatched_and_one_of_cyclone_too() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _out = check("Graph", "a removed endpoint is unmatched", With::Cyclone, Way::Out);
    let _in = check("Graph", "a removed endpoint is unmatched", With::Cyclone, Way::In);
    let (_participant, node) = downbeat(domain);
    listen(&mut peer, "/ours", TEXT, json!({}));
    advertise(&mut peer, "/theirs", TEXT, json!({}));
    let ours = publish(&node, "/ours", TEXT, QosProfile::DEFAULT);
    let (theirs, _samples) = subscribe(&node, "/theirs", TEXT, QosProfile::DEFAULT);
    wait_until("all are matched", || {
        ours.matched_subscriptions() == 1
            && theirs.matched_publishers() == 1
            && is_matched(&mut peer, "/ours")
            && is_matched(&mut peer, "/theirs")
    });
    drop(ours);
    wait_until("our publisher is unmatched", || !is_matched(&mut peer, "/ours"));
    peer.ask(json!({"do": "stop", "topic": "/theirs"}));
    wait_until("the publisher of Cyclone is unmatched", || theirs.matched_publishers() == 0);
}

#[test]
fn a_peer_that_was_killed_is_forgotten_and_one_that_comes_again_is_heard() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Faults", "a killed peer that starts again, five times", With::Cyclone, Way::Both);
    let (_participant, node) = downbeat(domain);
    let ours = publish(&node, "/ours", TEXT, QosProfile::DEFAULT);
    let (_theirs, samples) = subscribe(&node, "/theirs", TEXT, QosProfile::DEFAULT);
    for life in 0..5 {
        if life > 0 {
            // Killed by the drop: it takes no leave.
            drop(peer);
            peer = Peer::cyclonedds(domain).unwrap();
        }
        listen(&mut peer, "/ours", TEXT, json!({"depth": 100}));
        advertise(&mut peer, "/theirs", TEXT, json!({}));
        wait_until("it is matched", || is_matched(&mut peer, "/ours") && is_matched(&mut peer, "/theirs"));
        wait_until("it hears us", || {
            ours.publish(text(life.to_string())).unwrap();
            let taken = peer.ask(json!({"do": "take", "topic": "/ours"}));
            texts(taken.as_array().unwrap()).contains(&&*life.to_string())
        });
        wait_until("we hear it", || {
            say(&mut peer, "/theirs", &life.to_string());
            samples.try_iter().any(|sample| text_of(&sample) == life.to_string())
        });
    }
}
