//! Topics whose type passes through as bytes.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{RunningCore, WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::edge::{Interfaces, KnownType, RawMessage};
use downbeat_bridge::expose::{ExposeError, Exposure, expose};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant};
use downbeat_executor::{Context, Core, Module, Received, Setup, SetupError};
use downbeat_msgs::dynamic::{Definitions, DynamicMessage, Schemas};
use downbeat_msgs::qos::QosProfile;
use serde_json::json;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use test_machine::free_domain;

/// Passes on what it hears on `bytes`.
struct Listener(Sender<RawMessage>);

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(
            "bytes",
            |listener: &mut Self, message: Received<'_, RawMessage>, _: &mut Context<'_>| {
                // The test may have stopped listening.
                let _ = listener.0.send(message.clone());
            },
        )
    }
}

/// A core that runs, and takes in `/in` and sends it out again as `/out`, as bytes.
struct Relay {
    _core: RunningCore,
    heard: Receiver<RawMessage>,
    node: Node,
}

impl Relay {
    fn start(participant: &Participant, message_type: KnownType) -> Self {
        let node = participant.create_node(NodeName::new("/", "relay").unwrap()).unwrap();
        let mut core = Core::new();
        let (sender, heard) = channel();
        core.add("listener", Listener(sender)).unwrap();
        let exposure = |ros_topic: &str, direction| Exposure {
            ros_topic: Some(ros_topic.into()),
            ..Exposure::new("bytes", message_type, direction)
        };
        let exposures = [exposure("/in", Direction::In), exposure("/out", Direction::Out)];
        expose(&mut core, &node, &exposures).unwrap();
        Self { _core: RunningCore::start(core), heard, node }
    }

    fn next(&self) -> RawMessage {
        self.heard.recv_timeout(WATCHDOG).unwrap()
    }
}

fn leg() -> (Definitions, KnownType) {
    let mut schemas = Schemas::new("walk.mcap");
    schemas.add("legs/msg/Leg", "ros2msg", "float64[] angles\nstring name\n").unwrap();
    let definitions = Definitions::new().with(schemas);
    let leg = KnownType::raw("legs/msg/Leg", &definitions).unwrap();
    (definitions, leg)
}

#[test]
fn a_type_that_is_not_compiled_in_comes_in_to_modules_and_goes_out_again() {
    let (definitions, leg) = leg();
    assert!(leg.is_raw() && leg.hash().starts_with("RIHS01_") && leg.definition().contains("angles"));
    let hub = Hub::new();
    let relay = Relay::start(&Participant::on(Arc::new(hub.join())).unwrap(), leg);
    let peer = Participant::on(Arc::new(hub.join())).unwrap();
    let node = peer.create_node(NodeName::new("/", "peer").unwrap()).unwrap();
    let on_wire = MessageType::new("legs/msg/Leg").unwrap();
    let (sender, samples) = channel();
    let on_sample = Box::new(move |sample| sender.send(sample).unwrap());
    let _out = node.subscribe("/out", &on_wire, QosProfile::DEFAULT, on_sample).unwrap();
    let publisher = node.publish("/in", &on_wire, QosProfile::DEFAULT).unwrap();
    let mut message = DynamicMessage::new(&definitions.find("legs/msg/Leg").unwrap());
    message.push("angles", 0.25).unwrap();
    message.set("name", "left").unwrap();
    let bytes = message.to_cdr();
    publisher.publish(bytes.clone().into()).unwrap();
    let heard = relay.next();
    assert_eq!((heard.message_type(), &heard.cdr()[..]), (leg, &bytes[..]));
    assert_eq!(heard.decode().unwrap().get("name").unwrap().as_str(), Some("left"));
    assert_eq!(samples.recv_timeout(WATCHDOG).unwrap().cdr[..], bytes[..]);
    assert_eq!(relay.node.name().to_string(), "/relay");
}

#[test]
fn bytes_that_would_go_out_where_they_came_in_are_refused() {
    let (_, leg) = leg();
    let participant = Participant::on(Arc::new(Hub::new().join())).unwrap();
    let node = participant.create_node(NodeName::new("/", "n").unwrap()).unwrap();
    let both = [Direction::In, Direction::Out].map(|direction| Exposure::new("bytes", leg, direction));
    let refused = expose(&mut Core::new(), &node, &both).err();
    assert!(matches!(refused, Some(ExposeError::BothDirections(_))), "{refused:?}");
}

#[test]
fn what_is_no_type_is_refused_and_what_is_not_described_is_not_read() {
    for wrong in ["Leg", "legs/Leg", "legs/srv/Walk", "", "legs/msg/"] {
        let error = KnownType::raw(wrong, &Definitions::new()).unwrap_err().to_string();
        assert!(error.contains("expected package/msg/Name"), "{error}");
    }
    let arm = KnownType::raw("arms/msg/Arm", &Definitions::new()).unwrap();
    assert_eq!((arm.hash(), arm.definition()), ("", ""));
    let error = RawMessage::new(arm, common::cdr([0; 4])).decode().unwrap_err().to_string();
    assert!(error.contains("AMENT_PREFIX_PATH"), "{error}");
}

/// That of the tests alone: nobody else looks it up in this process.
const MULTI: &str = "std_msgs/msg/UInt8MultiArray";

#[test]
fn the_publisher_is_asked_what_its_type_looks_like() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _checks = [
        check("Topics", "types as bytes, described by their publisher", With::Rclpy, Way::In),
        check("Topics", "types as bytes", With::Rclpy, Way::Out),
    ];
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    // As if it were not compiled in: there is no place to look it up.
    let multi = KnownType::raw(MULTI, &Definitions::new()).unwrap();
    assert_eq!(multi.hash(), "");
    let relay = Relay::start(&participant, multi);
    peer.ask(json!({"do": "advertise", "topic": "/in", "type": MULTI}));
    peer.ask(json!({"do": "subscribe", "topic": "/out", "type": MULTI}));
    wait_until("the type is described", || !multi.hash().is_empty());
    let compiled = Interfaces::carried().message(MULTI).unwrap();
    assert_eq!(multi.hash(), compiled.hash());
    assert!(multi.definition().contains("MultiArrayDimension"), "{}", multi.definition());
    wait_until("rclpy knows both endpoints", || {
        let mut matched = |topic: &str| peer.ask(json!({"do": "matched", "topic": topic})) == 1;
        matched("/in") && matched("/out")
    });
    peer.ask(json!({"do": "publish", "topic": "/in", "fields": {"layout": {"data_offset": 7}}}));
    let heard = relay.next().decode().unwrap();
    assert_eq!(heard.get("layout.data_offset").unwrap().as_u64(), Some(7));
    assert_eq!(peer.take("/out", 1)[0]["fields"]["layout"]["data_offset"], 7);
    peer.leave();
}

#[test]
fn a_type_of_a_users_own_comes_from_cyclone_and_goes_back() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Topics", "a user's own type as bytes", With::Cyclone, Way::Both);
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let (definitions, _) = leg();
    let leg = KnownType::raw("legs/msg/Leg", &definitions).unwrap();
    let relay = Relay::start(&participant, leg);
    peer.ask(json!({"do": "subscribe", "topic": "/out", "type": "legs/msg/Leg"}));
    peer.ask(json!({"do": "advertise", "topic": "/in", "type": "legs/msg/Leg"}));
    wait_until("both are matched", || {
        let mut matched = |topic: &str| peer.ask(json!({"do": "matched", "topic": topic})) == 1;
        matched("/in") && matched("/out")
    });
    let fields = json!({"angles": [0.5, -1.0], "name": "right"});
    peer.ask(json!({"do": "publish", "topic": "/in", "fields": fields}));
    let heard = relay.next().decode().unwrap();
    assert_eq!(heard.get("angles[1]").unwrap().as_f64(), Some(-1.0));
    assert_eq!(peer.take("/out", 1)[0]["fields"], fields);
}
