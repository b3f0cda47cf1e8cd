//! Ourselves as a peer: the test program once more, in a process of its own, which obeys the commands of
//! `rclpy/peer.py`.
#![allow(dead_code, clippy::unwrap_used)]

use crate::common::rclpy::Peer;
use crate::common::texts::{Heard, TEXT, hear, text_of};
use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Publisher, Subscription};
use downbeat_msgs::qos::{Durability, QosProfile, Reliability};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::io::BufRead;
use std::path::Path;
use std::process::Command;
use std::sync::mpsc::Receiver;
use std::time::Duration;

/// Milliseconds of the lease, where it is not the default.
pub const LEASE_MS: &str = "DOWNBEAT_TEST_LEASE_MS";

/// The name of the node, where it is not `peer`.
pub const NODE: &str = "DOWNBEAT_TEST_NODE";

/// Starts node `/peer` of ours by a command that runs the program it is given.
pub fn start_by(command: impl FnOnce(&Path) -> Command) -> Peer {
    let mut command = command(&std::env::current_exe().unwrap());
    // More threads than one: the name of the test is then printed after what the test prints.
    command.args(["--exact", "ours::a_peer_obeys", "--ignored", "--nocapture", "--test-threads=2"]);
    Peer::run(&mut command)
}

/// Starts it in a domain on loopback.
pub fn start(domain_id: u16) -> Peer {
    start_by(|program| on_loopback(program, domain_id))
}

pub fn on_loopback(program: &Path, domain_id: u16) -> Command {
    let mut command = Command::new(program);
    command.env("ROS_DOMAIN_ID", domain_id.to_string()).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    command
}

#[test]
#[ignore = "a process that other tests start"]
fn a_peer_obeys() {
    let lease = std::env::var(LEASE_MS).ok().map(|ms| Duration::from_millis(ms.parse().unwrap()));
    let mut options = ParticipantOptions::from_env().unwrap();
    options.lease = lease.unwrap_or(options.lease);
    let participant = Participant::join(&options).unwrap();
    let name = std::env::var(NODE).unwrap_or_else(|_| "peer".to_owned());
    let node = participant.create_node(NodeName::new("/", &name).unwrap()).unwrap();
    let mut ours = Ours { node, publishers: HashMap::new(), subscriptions: HashMap::new() };
    println!("{}", json!("ready"));
    for line in std::io::stdin().lock().lines() {
        let command: Value = serde_json::from_str(&line.unwrap()).unwrap();
        println!("{}", ours.obey(&command));
    }
}

struct Ours {
    node: Node,
    publishers: HashMap<String, Publisher>,
    subscriptions: HashMap<String, (Subscription, Receiver<Heard>)>,
}

impl Ours {
    fn obey(&mut self, command: &Value) -> Value {
        let topic = command["topic"].as_str().unwrap();
        let number = |name: &str| command[name].as_u64().unwrap_or(0) as usize;
        match command["do"].as_str().unwrap() {
            "advertise" => {
                let kind = MessageType::new(TEXT).unwrap();
                let publisher = self.node.publish(topic, &kind, qos(command)).unwrap();
                self.publishers.insert(topic.to_owned(), publisher);
            }
            "subscribe_texts" => {
                self.subscriptions.insert(topic.to_owned(), hear(&self.node, topic, qos(command)));
            }
            "publish_texts" => {
                for count in 0..number("count") {
                    let text = text_of(number("first") + count, number("size"));
                    self.publishers[topic].publish(text).unwrap();
                }
            }
            "take" => return json!(self.subscriptions[topic].1.try_iter().collect::<Vec<_>>()),
            "matched" => {
                let publisher = self.publishers.get(topic).map(Publisher::matched_subscriptions);
                return json!(publisher.unwrap_or_else(|| self.subscriptions[topic].0.matched_publishers()));
            }
            unknown => panic!("no command {unknown}"),
        }
        Value::Null
    }
}

fn qos(command: &Value) -> QosProfile {
    let qos = &command["qos"];
    let is = |name: &str, value| qos[name].as_str().is_some_and(|text| text == value);
    QosProfile {
        reliability: if is("reliability", "best_effort") {
            Reliability::BestEffort
        } else {
            Reliability::Reliable
        },
        durability: if is("durability", "transient_local") {
            Durability::TransientLocal
        } else {
            Durability::Volatile
        },
        ..QosProfile::DEFAULT
    }
    .keep_last(qos["depth"].as_u64().unwrap_or(10) as u32)
}
