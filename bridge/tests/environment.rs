//! What the environment of ROS 2 says is honoured: with a real rclpy in the same environment.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::wait_until;
use downbeat_bridge::middleware::ParticipantOptions;
use downbeat_bridge::ros::{NodeName, Participant};
use serde_json::{Value, json};
use std::process::Command;
use std::time::{Duration, Instant};
use test_machine::free_domain;

/// rclpy in that environment, and what the same variables say to us.
fn both(variables: &[(&str, &str)]) -> Option<(Peer, ParticipantOptions)> {
    const ALL: [&str; 4] =
        ["ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"];
    let peer = Peer::start_by(|python| {
        let mut command = Command::new(python);
        for name in ALL {
            command.env_remove(name);
        }
        command.envs(variables.iter().copied());
        command
    })?;
    let lookup =
        |name: &str| variables.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned());
    Some((peer, ParticipantOptions::from_variables(lookup).unwrap()))
}

fn lists_us(peer: &mut Peer) -> bool {
    let nodes = peer.ask(json!({"do": "nodes"}));
    nodes.as_array().unwrap().contains(&Value::from("/downbeat"))
}

/// Whether rclpy finds our node within a time that suffices by far where it can.
fn is_found(peer: &mut Peer, options: &ParticipantOptions) -> bool {
    let participant = Participant::join(options).unwrap();
    let _node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    let start = Instant::now();
    while start.elapsed() < Duration::from_secs(15) {
        if lists_us(peer) {
            return true;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    false
}

#[test]
fn nodes_find_each_other_in_one_domain_and_not_in_another() {
    let local = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    let domain = free_domain().to_string();
    let Some((mut peer, options)) = both(&[("ROS_DOMAIN_ID", &domain), local]) else { return };
    let _check = check("Environment", "ROS_DOMAIN_ID", With::Rclpy, Way::Both);
    let other = ParticipantOptions { domain_id: free_domain(), ..options.clone() };
    let stranger = Participant::join(&other).unwrap();
    let _node = stranger.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    let participant = Participant::join(&options).unwrap();
    let _seen = participant.create_node(NodeName::new("/", "seen").unwrap()).unwrap();
    wait_until("rclpy lists the node of its domain", || {
        peer.ask(json!({"do": "nodes"})).as_array().unwrap().contains(&Value::from("/seen"))
    });
    assert!(!lists_us(&mut peer), "the other is in another domain, and was there before");
    peer.leave();
}

#[test]
fn localhost_is_one_machine_by_either_variable() {
    let domain = free_domain().to_string();
    let domain = ("ROS_DOMAIN_ID", &*domain);
    for variable in [("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"), ("ROS_LOCALHOST_ONLY", "1")] {
        let Some((mut peer, options)) = both(&[domain, variable]) else { return };
        let _check = check("Environment", &format!("{}={}", variable.0, variable.1), With::Rclpy, Way::Both);
        assert!(is_found(&mut peer, &options), "{variable:?}");
        peer.leave();
    }
}

#[test]
fn the_subnet_is_the_default_and_what_the_system_takes() {
    let domain = free_domain().to_string();
    let domain = ("ROS_DOMAIN_ID", &*domain);
    for value in ["SUBNET", "SYSTEM_DEFAULT", ""] {
        let Some((mut peer, options)) = both(&[domain, ("ROS_AUTOMATIC_DISCOVERY_RANGE", value)]) else {
            return;
        };
        let name = if value.is_empty() { "nothing set" } else { value };
        let feature = format!("ROS_AUTOMATIC_DISCOVERY_RANGE={name}");
        let _check = check("Environment", &feature, With::Rclpy, Way::Both);
        assert!(is_found(&mut peer, &options), "{value:?}");
        peer.leave();
    }
}

#[test]
fn off_is_found_by_nobody() {
    let local = ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
    let domain = free_domain().to_string();
    let Some((mut peer, mut options)) = both(&[("ROS_DOMAIN_ID", &domain), local]) else { return };
    let _check = check("Environment", "ROS_AUTOMATIC_DISCOVERY_RANGE=OFF", With::Rclpy, Way::Out);
    let lookup = |name: &str| (name == "ROS_AUTOMATIC_DISCOVERY_RANGE").then(|| "OFF".to_owned());
    options.discovery_range = ParticipantOptions::from_variables(lookup).unwrap().discovery_range;
    let hidden = Participant::join(&options).unwrap();
    let _node = hidden.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    let shown = Participant::join(&common::on_loopback(options.domain_id)).unwrap();
    let _seen = shown.create_node(NodeName::new("/", "seen").unwrap()).unwrap();
    wait_until("rclpy lists the other", || {
        peer.ask(json!({"do": "nodes"})).as_array().unwrap().contains(&Value::from("/seen"))
    });
    assert!(!lists_us(&mut peer));
    peer.leave();
}
