//! What a program logs, on `/rosout`.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{on_loopback, wait_until};
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::{
    Endpoint, EventHandler, Gid, Middleware, MiddlewareError, Reader, ReaderCounter, RemoteEndpoint, Sample,
    SampleHandler, WriteError, WriteOptions, Writer,
};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant};
use downbeat_bridge::rosout::{Rosout, RosoutError, RosoutStatus};
use downbeat_executor::{
    Core, Inbox, ManualClock, Module, ModuleOptions, Setup, SetupError, Synchrony, Time,
};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::Log;
use serde_json::json;
use std::sync::Arc;
use std::sync::mpsc::channel;
use std::time::Duration;
use test_machine::free_domain;
use tracing_subscriber::prelude::*;

fn node(participant: Arc<dyn Middleware>) -> (Participant, Node) {
    let participant = Participant::on(participant).unwrap();
    let node = participant.create_node(NodeName::new("/robot", "downbeat").unwrap()).unwrap();
    (participant, node)
}

/// What somebody who comes now hears of `/rosout`.
fn heard_late(hub: &Hub) -> Vec<Log> {
    let peer = Participant::on(Arc::new(hub.join())).unwrap();
    let peer = peer.create_node(NodeName::new("/", "peer").unwrap()).unwrap();
    let (sender, samples) = channel();
    let on_sample = Box::new(move |sample: Sample| drop(sender.send(sample)));
    let kind = MessageType::new("rcl_interfaces/msg/Log").unwrap();
    let _subscription = peer.subscribe("/rosout", &kind, QosProfile::ROSOUT, on_sample).unwrap();
    samples.try_iter().map(|sample| cdr::from_slice(&sample.cdr).unwrap()).collect()
}

/// Logs in each run.
struct Walker;

impl Module for Walker {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.every(Duration::from_millis(10), |_, ctx| tracing::info!(step = ctx.now().as_nanos(), "walks"))
    }
}

#[test]
fn lines_carry_the_names_of_the_modules_that_logged_them() {
    let (rosout, hub) = (Rosout::new(), Hub::new());
    let (_participant, node) = node(Arc::new(hub.join()));
    let publishing = rosout.publish(&node).unwrap();
    tracing::subscriber::with_default(tracing_subscriber::registry().with(rosout.layer()), || {
        let clock = ManualClock::new(Time::ZERO);
        let mut core = Core::new().with_clock(clock.clone());
        core.add("walker", Walker).unwrap();
        let detached =
            ModuleOptions { synchrony: Synchrony::Detached(Inbox::KeepAll), ..ModuleOptions::default() };
        core.add_with("eye", Walker, detached).unwrap();
        for _ in 0..2 {
            core.cycle().unwrap();
            clock.advance(Duration::from_millis(10));
        }
        core.cycle().unwrap();
        tracing::warn!("about the node");
    });
    let mut lines = Vec::new();
    wait_until("the last line is published", || {
        lines = heard_late(&hub);
        lines.iter().any(|line| line.msg == "about the node")
    });
    let received: Vec<_> = lines.iter().map(|line| (line.name.as_str(), line.msg.as_str())).collect();
    for expected in [
        ("robot.downbeat.walker", "walks step=10000000"),
        ("robot.downbeat.eye", "walks step=20000000"),
        ("robot.downbeat", "about the node"),
    ] {
        assert!(received.contains(&expected), "{expected:?} in {received:?}");
    }
    assert!(lines.iter().all(|line| line.file.ends_with(".rs") && line.line > 0));
    drop(publishing);
}

#[test]
fn lines_from_before_the_node_and_from_just_before_the_end_are_published_in_their_order() {
    let (rosout, hub) = (Rosout::new(), Hub::new());
    let (_participant, node) = node(Arc::new(hub.join()));
    let log = tracing_subscriber::registry().with(rosout.layer()).set_default();
    tracing::info!("before the node");
    let listener = Participant::on(Arc::new(hub.join())).unwrap();
    let listener = listener.create_node(NodeName::new("/", "peer").unwrap()).unwrap();
    let (sender, samples) = channel();
    let on_sample = Box::new(move |sample: Sample| drop(sender.send(sample)));
    let kind = MessageType::new("rcl_interfaces/msg/Log").unwrap();
    let _subscription = listener.subscribe("/rosout", &kind, QosProfile::ROSOUT, on_sample).unwrap();
    let publishing = rosout.publish(&node).unwrap();
    assert!(matches!(rosout.publish(&node), Err(RosoutError::Published)));
    tracing::info!("just before the end");
    drop((log, publishing));
    let received: Vec<_> =
        samples.try_iter().map(|sample| cdr::from_slice::<Log>(&sample.cdr).unwrap().msg).collect();
    assert_eq!(received, ["before the node", "just before the end"]);
    rosout.publish(&node).expect("another publisher may follow");
}

#[test]
fn each_endpoint_with_another_type_is_logged_once_with_both_types() {
    let (rosout, hub) = (Rosout::new(), Hub::new());
    let (_participant, node) = node(Arc::new(hub.join()));
    let publishing = rosout.publish(&node).unwrap();
    let _log = tracing_subscriber::registry().with(rosout.layer()).set_default();
    let (text, number) =
        (MessageType::new("std_msgs/msg/String").unwrap(), MessageType::new("std_msgs/msg/Int32").unwrap());
    let publisher = node.publish("/text", &text, QosProfile::DEFAULT).unwrap();
    let peer = Participant::on(Arc::new(hub.join())).unwrap();
    let peer = peer.create_node(NodeName::new("/", "peer").unwrap()).unwrap();
    let subscribe = || peer.subscribe("/text", &number, QosProfile::DEFAULT, Box::new(|_| ())).unwrap();
    let _first = subscribe();
    // Receives the present state again.
    publisher.on_event(Box::new(|_| ()));
    let _second = subscribe();
    tracing::info!("the end");
    let mut lines = Vec::new();
    wait_until("the last line is published", || {
        lines = heard_late(&hub);
        lines.iter().any(|line| line.msg == "the end")
    });
    let words = "Incompatible type on topic '/text', no messages will be sent to it. The publisher of this node has type \
                 std_msgs/msg/String, a subscription of another node has std_msgs/msg/Int32";
    let warnings = lines.iter().filter(|line| line.level == Log::WARN && line.msg.starts_with(words));
    assert_eq!(warnings.count(), 2, "{lines:?}");
    drop(publishing);
}

/// An engine that takes no sample, and says so in the log.
struct Broken(downbeat_bridge::middleware::in_process::InProcessParticipant);

struct BrokenWriter(Box<dyn Writer>);

impl Middleware for Broken {
    fn gid(&self) -> Gid {
        self.0.gid()
    }

    fn create_writer(&self, endpoint: &Endpoint) -> Result<Box<dyn Writer>, MiddlewareError> {
        Ok(Box::new(BrokenWriter(self.0.create_writer(endpoint)?)))
    }

    fn create_reader(
        &self,
        endpoint: &Endpoint,
        on_sample: SampleHandler,
    ) -> Result<Box<dyn Reader>, MiddlewareError> {
        self.0.create_reader(endpoint, on_sample)
    }

    fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        self.0.remote_endpoints()
    }
}

impl Writer for BrokenWriter {
    fn gid(&self) -> Gid {
        self.0.gid()
    }

    fn matched(&self) -> usize {
        self.0.matched()
    }

    fn reader_counter(&self) -> ReaderCounter {
        self.0.reader_counter()
    }

    fn matched_readers(&self) -> Vec<Gid> {
        self.0.matched_readers()
    }

    fn on_match(&self, handler: Box<dyn Fn() + Send + Sync>) {
        self.0.on_match(handler);
    }

    fn on_event(&self, handler: EventHandler) {
        self.0.on_event(handler);
    }

    fn write_with(&self, _cdr: bytes::Bytes, _options: WriteOptions) -> Result<i64, WriteError> {
        tracing::error!("the engine cannot send");
        Err(WriteError::WindowFull)
    }

    fn flush(&self, timeout: Duration) -> bool {
        self.0.flush(timeout)
    }
}

#[test]
fn a_line_that_cannot_be_sent_does_not_become_another_line() {
    let rosout = Rosout::new();
    // The layer has to be that of all threads for this test to mean anything; it runs in a process of its
    // own.
    tracing_subscriber::registry().with(rosout.layer()).init();
    let (_participant, node) = node(Arc::new(Broken(Hub::new().join())));
    let before = rosout.status().failed;
    let publishing = rosout.publish(&node).unwrap();
    for number in 0..10 {
        tracing::info!(number, "cannot be sent");
    }
    wait_until("all lines have failed", || rosout.status().failed >= before + 10);
    drop(publishing);
    // What the creation of the node logged failed too.
    let RosoutStatus { published, failed, dropped } = rosout.status();
    assert_eq!((published, dropped), (0, 0));
    assert!(failed < 20, "{failed} lines of 10");
}

#[test]
fn rclpy_that_comes_late_hears_the_earlier_lines_with_all_they_say() {
    let domain = free_domain();
    let rosout = Rosout::new();
    let log = tracing_subscriber::registry().with(rosout.layer()).set_default();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check =
        check("Node services", "/rosout with level, file and line, for late joiners", With::Rclpy, Way::Out);
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let node = participant.create_node(NodeName::new("/robot", "downbeat").unwrap()).unwrap();
    let publishing = rosout.publish(&node).unwrap();
    let line = line!() + 1;
    tracing::warn!(module = "hardware", servo = 5, "is silent");
    wait_until("the line is published", || rosout.status().published > 0);

    let qos = json!({"depth": 1000, "durability": "transient_local"});
    rclpy.ask(json!({"do": "subscribe", "topic": "/rosout", "type": "rcl_interfaces/msg/Log", "qos": qos}));
    let mut lines = Vec::new();
    let mut of_ours = |rclpy: &mut Peer, text: &str| {
        let mut found = None;
        wait_until("rclpy hears the line", || {
            let more = rclpy.ask(json!({"do": "take", "topic": "/rosout"}));
            lines.extend(more.as_array().unwrap().iter().map(|message| message["fields"].clone()));
            found = lines.iter().find(|line| line["msg"] == text).cloned();
            found.is_some()
        });
        found.unwrap()
    };
    let early = of_ours(&mut rclpy, "is silent servo=5");
    assert_eq!((&early["name"], &early["level"]), (&json!("robot.downbeat.hardware"), &json!(30)));
    assert_eq!((&early["file"], &early["line"]), (&json!(file!()), &json!(line)));
    assert_eq!(early["function"], "rosout");
    tracing::error!("ends");
    assert_eq!(of_ours(&mut rclpy, "ends")["level"], 40);

    let listed = rclpy.ask(json!({"do": "publishers_of", "topic": "/rosout"}));
    let of_node = listed.as_array().unwrap().iter().find(|info| info["node"] == "/robot/downbeat").unwrap();
    let expected = json!({"node": "/robot/downbeat", "type": "rcl_interfaces/msg/Log", "reliability": "RELIABLE", "durability": "TRANSIENT_LOCAL"});
    assert_eq!(of_node, &expected);
    drop((publishing, log));
    rclpy.leave();
}
