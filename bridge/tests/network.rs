//! The nodes and endpoints of the domain, compared with rclpy and as modules receive them.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{on_loopback, wait_until};
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::network::{self, NetworkWatch};
use downbeat_bridge::ros::{MessageType, NodeName, Participant};
use downbeat_executor::{Core, Module, Setup, SetupError};
use downbeat_msgs::Message;
use downbeat_msgs::downbeat_interfaces::msg::{NetworkEndpoint, NetworkGraph};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::String as Text;
use serde_json::json;
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use test_machine::free_domain;

#[test]
fn the_nodes_topics_services_types_qos_and_hashes_of_rclpy_are_known() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check =
        check("Graph", "the network: nodes, topics, services, types, QoS, hashes", With::Rclpy, Way::In);
    let latched = json!({"depth": 1, "durability": "transient_local"});
    rclpy.ask(json!({"do": "advertise", "topic": "/chatter", "type": Text::TYPE_NAME, "qos": latched}));
    let best_effort = json!({"depth": 5, "reliability": "best_effort", "deadline_ms": 50});
    rclpy.ask(json!({"do": "subscribe", "topic": "/heard", "type": Text::TYPE_NAME, "qos": best_effort}));
    rclpy.ask(json!({"do": "serve", "service": "/light", "type": "std_srvs/srv/SetBool"}));
    rclpy.ask(json!({"do": "client", "service": "/plan", "type": "std_srvs/srv/Trigger"}));
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let mut network = NetworkGraph::default();
    let found = |network: &NetworkGraph, kind, name: &str| {
        let is_it = |endpoint: &&NetworkEndpoint| endpoint.kind == kind && endpoint.name == name;
        network.endpoints.iter().find(is_it).filter(|endpoint| endpoint.node == "/peer").cloned()
    };
    wait_until("all endpoints are found, with their node", || {
        network = participant.network();
        [
            (NetworkEndpoint::PUBLISHER, "/chatter"),
            (NetworkEndpoint::SUBSCRIPTION, "/heard"),
            (NetworkEndpoint::SERVER, "/light"),
            (NetworkEndpoint::CLIENT, "/plan"),
        ]
        .iter()
        .all(|(kind, name)| found(&network, *kind, name).is_some())
    });
    let node = network.nodes.iter().find(|node| node.name == "/peer").unwrap();
    assert_eq!(node.vendor, "eProsima Fast DDS");
    let publisher = found(&network, NetworkEndpoint::PUBLISHER, "/chatter").unwrap();
    assert_eq!((&*publisher.r#type, &*publisher.type_hash), (Text::TYPE_NAME, Text::TYPE_HASH));
    assert!(publisher.is_reliable && publisher.is_transient_local && publisher.deadline_ns == 0);
    let subscription = found(&network, NetworkEndpoint::SUBSCRIPTION, "/heard").unwrap();
    assert!(!subscription.is_reliable && !subscription.is_transient_local);
    assert!((49_999_999..=50_000_001).contains(&subscription.deadline_ns), "{}", subscription.deadline_ns);
    assert_eq!(found(&network, NetworkEndpoint::SERVER, "/light").unwrap().r#type, "std_srvs/srv/SetBool");
    assert_eq!(found(&network, NetworkEndpoint::CLIENT, "/plan").unwrap().r#type, "std_srvs/srv/Trigger");
    rclpy.leave();
}

/// Passes on what it receives.
struct Companion(Sender<NetworkGraph>);

impl Module for Companion {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe::<NetworkGraph, _>(network::TOPIC, |companion, graph, _| {
            let _ = companion.0.send(graph.clone());
        })
    }
}

#[test]
fn modules_are_told_of_the_network_whenever_it_changes() {
    let hub = Hub::new();
    let participant = Participant::on(Arc::new(hub.join())).unwrap();
    let (sender, graphs) = channel();
    let mut core = Core::new();
    core.add("companion", Companion(sender)).unwrap();
    let watch = NetworkWatch::start(&mut core, &participant).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run().unwrap());
    let mut received = Vec::new();
    let mut wait_for = |what: &str, is_it: &dyn Fn(&NetworkGraph) -> bool| {
        wait_until(what, || {
            received.extend(graphs.try_iter());
            received.last().is_some_and(is_it)
        });
    };
    wait_for("the module receives an empty graph", &|graph| graph.nodes.is_empty());
    let other = Participant::on(Arc::new(hub.join())).unwrap();
    let operator = other.create_node(NodeName::new("/", "operator").unwrap()).unwrap();
    let kind = MessageType::new(Text::TYPE_NAME).unwrap();
    let publisher = operator.publish("orders", &kind, QosProfile::DEFAULT).unwrap();
    wait_for("it receives who has joined", &|graph| {
        let orders =
            |endpoint: &NetworkEndpoint| (&*endpoint.name, &*endpoint.node) == ("/orders", "/operator");
        graph.nodes.len() == 1 && graph.endpoints.iter().any(orders)
    });
    drop((publisher, operator, other));
    wait_for("it receives who has left", &|graph| graph.nodes.is_empty() && graph.endpoints.is_empty());
    assert!(received.windows(2).all(|pair| pair[0] != pair[1]), "nothing is published twice");
    drop(watch);
    handle.stop();
    running.join().unwrap();
}
