//! Topics of a core shown to ROS 2 and taken from it, over the engine in memory: no network, no waiting.
#![allow(clippy::unwrap_used)]

use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{BridgeStatus, ExposeError, Exposure, expose};
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::{Direction, Sample};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Publisher, Subscription};
use downbeat_executor::{Context, Core, ManualClock, Module, Received, Setup, SetupError, Time};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::{cdr, std_msgs::msg};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

/// A core, its node `/robot/downbeat`, and a peer on the same hub.
struct World {
    core: Core,
    node: Node,
    clock: ManualClock,
    peer: Participant,
    peer_node: Node,
}

fn world() -> World {
    let hub = Hub::new();
    let join = |namespace, name| {
        let participant = Participant::on(Arc::new(hub.join())).unwrap();
        let node = participant.create_node(NodeName::new(namespace, name).unwrap()).unwrap();
        (participant, node)
    };
    let (_, node) = join("/robot", "downbeat");
    let (peer, peer_node) = join("/", "peer");
    let clock = ManualClock::new(Time::ZERO);
    World { core: Core::new().with_clock(clock.clone()), node, clock, peer, peer_node }
}

impl World {
    fn cycles(&mut self, count: usize) {
        for _ in 0..count {
            self.core.cycle().unwrap();
            self.clock.advance(Duration::from_millis(10));
        }
    }

    fn expose(&mut self, exposure: Exposure) -> BridgeStatus {
        expose(&mut self.core, &self.node, &[exposure]).unwrap()
    }

    fn listen(&self, topic: &str, qos: QosProfile) -> (Subscription, Receiver<Sample>) {
        let (sender, samples) = channel();
        let on_sample = Box::new(move |sample| sender.send(sample).unwrap());
        (self.peer_node.subscribe(topic, &ros_string(), qos, on_sample).unwrap(), samples)
    }

    fn speak(&self, topic: &str) -> Publisher {
        self.peer_node.publish(topic, &ros_string(), QosProfile::DEFAULT).unwrap()
    }
}

/// Says "tick 1", "tick 2", … on `text` every 10 ms.
struct Talker {
    ticks: u32,
}

impl Module for Talker {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let text = setup.publish::<msg::String>("text")?;
        setup.every(Duration::from_millis(10), move |talker: &mut Self, ctx| {
            talker.ticks += 1;
            ctx.publish(text, msg::String { data: format!("tick {}", talker.ticks) });
        })
    }
}

/// Passes on what it hears on `text`.
struct Listener {
    heard: Sender<String>,
}

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(
            "text",
            |listener: &mut Self, text: Received<'_, msg::String>, _: &mut Context<'_>| {
                listener.heard.send(text.data.clone()).unwrap();
            },
        )
    }
}

fn text(direction: Direction) -> Exposure {
    Exposure::new("text", Interfaces::carried().message("std_msgs/msg/String").unwrap(), direction)
}

fn ros_string() -> MessageType {
    MessageType::new("std_msgs/msg/String").unwrap()
}

fn words(samples: &Receiver<Sample>) -> Vec<String> {
    samples.try_iter().map(|sample| cdr::from_slice::<msg::String>(&sample.cdr).unwrap().data).collect()
}

#[test]
fn what_a_module_publishes_goes_out() {
    let mut world = world();
    world.core.add("talker", Talker { ticks: 0 }).unwrap();
    let status = world.expose(text(Direction::Out));
    let (_subscription, samples) = world.listen("/robot/text", QosProfile::DEFAULT);
    world.cycles(4);
    assert_eq!(words(&samples), ["tick 1", "tick 2"]);

    let report = &status.endpoints()[0];
    assert_eq!((report.endpoint.topic.as_str(), report.endpoint.ros_topic.as_str()), ("text", "/robot/text"));
    assert_eq!(
        (report.endpoint.type_name.as_str(), report.endpoint.direction),
        ("std_msgs/msg/String", Direction::Out)
    );
    assert_eq!(
        (report.traffic.matched, report.traffic.messages, report.traffic.skipped, report.traffic.errors),
        (1, 2, 0, 0)
    );
}

#[test]
fn what_nobody_hears_is_skipped_and_counted() {
    let mut world = world();
    world.core.add("talker", Talker { ticks: 0 }).unwrap();
    let status = world.expose(text(Direction::Out));
    world.cycles(4);
    let report = &status.endpoints()[0];
    // The third tick is skipped in the cycle that publishes it, not in the one that would take it.
    assert_eq!((report.traffic.matched, report.traffic.messages, report.traffic.skipped), (0, 0, 3));
}

#[test]
fn a_latched_topic_goes_out_even_when_nobody_hears_yet() {
    let mut world = world();
    world.core.add("talker", Talker { ticks: 0 }).unwrap();
    let status = world.expose(Exposure { qos: QosProfile::LATCHED.into(), ..text(Direction::Out) });
    world.cycles(4);
    let (_late, samples) = world.listen("/robot/text", QosProfile::LATCHED);
    assert_eq!(words(&samples), ["tick 2"]);
    assert_eq!(status.endpoints()[0].traffic.messages, 2);
}

#[test]
fn a_topic_can_have_another_name_outside() {
    let mut world = world();
    world.core.add("talker", Talker { ticks: 0 }).unwrap();
    let status = world.expose(Exposure { ros_topic: Some("~/speech".into()), ..text(Direction::Out) });
    assert_eq!(status.endpoints()[0].endpoint.ros_topic, "/robot/downbeat/speech");
    let (_subscription, samples) = world.listen("/robot/downbeat/speech", QosProfile::DEFAULT);
    world.cycles(3);
    assert_eq!(words(&samples), ["tick 1"]);
}

#[test]
fn what_others_publish_comes_in() {
    let mut world = world();
    let (heard, hears) = channel();
    world.core.add("listener", Listener { heard }).unwrap();
    let status = world.expose(text(Direction::In));
    let speaker = world.speak("/robot/text");
    for data in ["one", "two"] {
        speaker.publish(cdr::to_vec(&msg::String { data: data.into() }).into()).unwrap();
    }
    world.cycles(2);
    assert_eq!(hears.try_iter().collect::<Vec<_>>(), ["one", "two"]);
    let report = &status.endpoints()[0];
    assert_eq!(
        (report.endpoint.direction, report.traffic.matched, report.traffic.messages, report.traffic.errors),
        (Direction::In, 1, 2, 0)
    );
}

#[test]
fn bytes_that_are_no_message_are_counted_and_do_no_harm() {
    let mut world = world();
    let (heard, hears) = channel();
    world.core.add("listener", Listener { heard }).unwrap();
    let status = world.expose(text(Direction::In));
    let speaker = world.speak("/robot/text");
    speaker.publish(bytes::Bytes::from_static(&[0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff])).unwrap();
    speaker.publish(cdr::to_vec(&msg::String { data: "fine".into() }).into()).unwrap();
    world.cycles(2);
    assert_eq!(hears.try_iter().collect::<Vec<_>>(), ["fine"]);
    let report = &status.endpoints()[0];
    assert_eq!((report.traffic.messages, report.traffic.errors), (1, 1));
    let error = report.traffic.last_error.as_deref().unwrap();
    assert!(error.contains("\"text\"") && error.contains("std_msgs/msg/String"), "{error}");
}

#[test]
fn stopping_the_core_removes_the_endpoints_and_dropping_the_node_the_node() {
    let mut world = world();
    world.core.add("talker", Talker { ticks: 0 }).unwrap();
    let status = world.expose(text(Direction::Out));
    let incoming = Exposure { topic: "commands".into(), ..text(Direction::In) };
    let (subscription, _samples) = world.listen("/robot/text", QosProfile::DEFAULT);
    assert_eq!(world.peer.remote_nodes()[0].endpoints.len(), 1);
    assert!(matches!(expose(&mut world.core, &world.node, &[incoming]), Err(ExposeError::SecondBridge)));
    world.cycles(1);
    world.core.stop();
    drop(world.core);
    assert_eq!(subscription.matched_publishers(), 0);
    assert_eq!(status.endpoints()[0].traffic.matched, 0);
    drop(world.node);
    assert_eq!(world.peer.remote_nodes(), []);
}

#[test]
fn a_topic_in_both_directions_is_refused() {
    let mut world = world();
    let error =
        expose(&mut world.core, &world.node, &[text(Direction::Out), text(Direction::In)]).err().unwrap();
    assert!(error.to_string().contains("both directions"), "{error}");
}

#[test]
fn a_topic_of_another_type_is_refused() {
    let mut world = world();
    world.core.add("talker", Talker { ticks: 0 }).unwrap();
    let imu = Interfaces::carried().message("sensor_msgs/msg/Imu").unwrap();
    let wrong = Exposure { message_type: imu, ..text(Direction::Out) };
    let error = expose(&mut world.core, &world.node, &[wrong]).err().unwrap().to_string();
    assert!(error.contains("\"text\"") && error.contains("Imu"), "{error}");
}

#[test]
fn what_left_by_the_bridge_does_not_come_back_by_it() {
    let mut world = world();
    world.core.add("talker", Talker { ticks: 0 }).unwrap();
    let echo = Exposure { topic: "echo".into(), ros_topic: Some("text".into()), ..text(Direction::In) };
    let status = expose(&mut world.core, &world.node, &[text(Direction::Out), echo]).unwrap();
    let peer = world.speak("/robot/text");
    world.cycles(5);
    peer.publish(cdr::to_vec(&msg::String { data: "from outside".into() }).into()).unwrap();
    world.cycles(2);
    let messages: Vec<_> = status.endpoints().iter().map(|report| report.traffic.messages).collect();
    assert!(messages[0] >= 4, "{messages:?}");
    assert_eq!(messages[1], 1, "of the peer");
}
