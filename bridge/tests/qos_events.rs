//! Events of the quality of service of exposed topics: counted, received by modules, and the same as rclpy
//! receives.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::texts::text_of;
use common::{RunningCore, WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{BridgeStatus, Exposure, QOS_EVENTS_TOPIC, QosCounts, expose};
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::rtps::RtpsParticipant;
use downbeat_bridge::middleware::{Direction, EndpointEvent, Middleware, QosPolicyKind};
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant};
use downbeat_executor::{Context, Core, Module, ModuleOptions, Received, Setup, SetupError, Synchrony};
use downbeat_msgs::downbeat_interfaces::msg::QosEvent;
use downbeat_msgs::qos::{Liveliness, QosProfile};
use downbeat_msgs::std_msgs::msg;
use serde_json::{Value, json};
use std::cell::RefCell;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;
use test_machine::free_domain;

const TEXT: &str = "std_msgs/msg/String";

/// Publishes on `text` while it is switched on, and passes on the events it receives.
struct Robot {
    period: Duration,
    is_silent: Arc<std::sync::atomic::AtomicBool>,
    events: Sender<QosEvent>,
}

impl Module for Robot {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let text = setup.publish::<msg::String>("text")?;
        setup.every(self.period, move |robot: &mut Self, ctx| {
            if !robot.is_silent.load(std::sync::atomic::Ordering::Relaxed) {
                ctx.publish(text, msg::String::default());
            }
        })?;
        setup.subscribe("words", |_: &mut Self, _: Received<'_, msg::String>, _: &mut Context<'_>| ())?;
        let hear = |robot: &mut Self, event: Received<'_, QosEvent>, _: &mut Context<'_>| {
            // The test may have stopped listening.
            let _ = robot.events.send(event.clone());
        };
        setup.subscribe(QOS_EVENTS_TOPIC, hear)
    }
}

/// A robot whose topics `text` goes out and `words` comes in, while it runs.
struct Running {
    _core: RunningCore,
    status: BridgeStatus,
    events: Receiver<QosEvent>,
    heard: RefCell<Vec<QosEvent>>,
    is_silent: Arc<std::sync::atomic::AtomicBool>,
    _node: Node,
}

impl Running {
    fn start(participant: &Participant, qos: QosProfile) -> Self {
        let node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
        let mut core = Core::new();
        let (sender, events) = channel();
        let is_silent = Arc::<std::sync::atomic::AtomicBool>::default();
        let robot =
            Robot { period: Duration::from_millis(20), is_silent: Arc::clone(&is_silent), events: sender };
        core.add("robot", robot).unwrap();
        let kind = Interfaces::carried().message(TEXT).unwrap();
        let exposure =
            |topic, direction| Exposure { qos: qos.into(), ..Exposure::new(topic, kind, direction) };
        let exposures = [exposure("text", Direction::Out), exposure("words", Direction::In)];
        let status = expose(&mut core, &node, &exposures).unwrap();
        let core = RunningCore::start(core);
        Self { _core: core, status, events, heard: RefCell::default(), is_silent, _node: node }
    }

    /// What is counted of the topic that goes out, and of the one that comes in.
    fn counts(&self) -> [QosCounts; 2] {
        let mut counts = self.status.endpoints().into_iter().map(|report| report.traffic.qos);
        [counts.next().unwrap(), counts.next().unwrap()]
    }

    /// The next event of that kind, in a module. Others are kept.
    fn event(&self, topic: &str, kind: u8) -> QosEvent {
        let is_meant = |event: &QosEvent| event.topic == topic && event.kind == kind;
        let mut heard = self.heard.borrow_mut();
        loop {
            if let Some(position) = heard.iter().position(is_meant) {
                return heard.remove(position);
            }
            heard.push(self.events.recv_timeout(WATCHDOG).unwrap());
        }
    }

    fn be_silent(&self) {
        self.is_silent.store(true, std::sync::atomic::Ordering::Relaxed);
    }
}

fn join(domain_id: u16) -> Participant {
    Participant::join(&on_loopback(domain_id)).unwrap()
}

#[test]
fn modules_hear_who_is_matched_who_is_not_and_what_was_lost() {
    let domain = free_domain();
    let participant = join(domain);
    let robot = Running::start(&participant, QosProfile::SENSOR_DATA);
    let peer = join(domain);
    let node = peer.create_node(NodeName::new("/", "peer").unwrap()).unwrap();
    let text = MessageType::new(TEXT).unwrap();
    let subscription = node.subscribe("/text", &text, QosProfile::SENSOR_DATA, Box::new(|_| ())).unwrap();
    let matched = robot.event("text", QosEvent::MATCHED);
    assert_eq!((matched.count, matched.total, matched.current, matched.is_publisher), (1, 1, 1, true));
    assert_eq!(matched.ros_topic, "/text");
    let _reliable = node.subscribe("/text", &text, QosProfile::DEFAULT, Box::new(|_| ())).unwrap();
    let incompatible = robot.event("text", QosEvent::INCOMPATIBLE_QOS);
    assert_eq!((incompatible.policy.as_str(), incompatible.total), ("RELIABILITY_QOS_POLICY", 1));
    assert_ne!(incompatible.peer, matched.peer);
    drop(subscription);
    let unmatched = robot.event("text", QosEvent::MATCHED);
    assert_eq!((unmatched.count, unmatched.current, unmatched.peer), (-1, 0, matched.peer));
    let [out, _] = robot.counts();
    let expected = QosCounts {
        matched: 1,
        incompatible: 1,
        last_incompatible: Some(QosPolicyKind::Reliability),
        ..QosCounts::default()
    };
    assert_eq!(out, expected);

    // A handler holds up the thread that reads for the robot until its socket overflows.
    let holder = participant.create_node(NodeName::new("/", "holder").unwrap()).unwrap();
    let ((holding, is_held), (go_on, held)) = (channel::<()>(), channel::<()>());
    let on_sample = Box::new(move |_| {
        let _ = holding.send(());
        let _ = held.recv();
    });
    let _holds = holder.subscribe("/hold", &text, QosProfile::DEFAULT, on_sample).unwrap();
    let hold = node.publish("/hold", &text, QosProfile::DEFAULT).unwrap();
    let words = node.publish("/words", &text, QosProfile::SENSOR_DATA).unwrap();
    let peer = robot.event("words", QosEvent::MATCHED).peer;
    wait_until("the holder is matched", || hold.matched_subscriptions() == 1);
    hold.publish(text_of(0, 10)).unwrap();
    is_held.recv_timeout(WATCHDOG).unwrap();
    for _ in 0..200 {
        // It may be refused while what was written before is not sent yet.
        wait_until("a word is written", || words.publish(text_of(0, 100_000)).is_ok());
    }
    drop(go_on);
    wait_until("words are lost", || {
        let _ = words.publish(text_of(0, 100_000));
        robot.counts()[1].lost > 0
    });
    let lost = robot.event("words", QosEvent::MESSAGE_LOST);
    assert!(lost.count >= 1 && lost.total == lost.count.unsigned_abs(), "{lost:?}");
    assert_eq!(lost.peer, peer);
}

#[test]
fn endpoints_with_another_type_are_counted_and_modules_receive_an_event_of_each() {
    let domain = free_domain();
    let participant = join(domain);
    let robot = Running::start(&participant, QosProfile::DEFAULT);
    let peer = join(domain);
    let node = peer.create_node(NodeName::new("/", "peer").unwrap()).unwrap();
    let other = MessageType::new("std_msgs/msg/Int32").unwrap();
    let _subscription = node.subscribe("/text", &other, QosProfile::DEFAULT, Box::new(|_| ())).unwrap();
    let event = robot.event("text", QosEvent::INCOMPATIBLE_TYPE);
    assert_eq!((event.total, event.is_publisher, event.ros_topic.as_str()), (1, true, "/text"));
    let publisher = node.publish("/words", &other, QosProfile::DEFAULT).unwrap();
    let event = robot.event("words", QosEvent::INCOMPATIBLE_TYPE);
    assert_eq!((event.total, event.is_publisher, event.peer), (1, false, publisher.gid().0));
    assert_eq!(publisher.matched_subscriptions(), 0);
    let expected = QosCounts { incompatible_types: 1, ..QosCounts::default() };
    assert_eq!(robot.counts(), [expected.clone(), expected]);
}

/// Publishes once a cycle.
struct Flood;

impl Module for Flood {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        let text = setup.publish::<msg::String>("text")?;
        setup.every(Duration::from_nanos(1), move |_, ctx| ctx.publish(text, msg::String::default()))
    }
}

#[test]
fn what_the_inbox_of_the_bridge_drops_is_counted_by_topic() {
    // More than the inbox holds, twice: what the bridge took before it was held up, and what waits then.
    const CYCLES: u64 = 10_000;
    let mut core = Core::new();
    let synchrony = Synchrony::EveryCycle;
    core.add_with("flood", Flood, ModuleOptions { synchrony, ..ModuleOptions::default() }).unwrap();
    let hub = Hub::new();
    let join = || Participant::on(Arc::new(hub.join())).unwrap();
    let participant = join();
    let node = participant.create_node(NodeName::new("/", "downbeat").unwrap()).unwrap();
    let kind = Interfaces::carried().message(TEXT).unwrap();
    let status = expose(&mut core, &node, &[Exposure::new("text", kind, Direction::Out)]).unwrap();
    // Holds the bridge up, which sends on the thread that calls this.
    let (go_on, held) = channel::<()>();
    let on_sample = move |_| {
        let _ = held.recv();
    };
    let peer = join();
    let peer_node = peer.create_node(NodeName::new("/", "peer").unwrap()).unwrap();
    let text = MessageType::new(TEXT).unwrap();
    let _slow = peer_node.subscribe("/text", &text, QosProfile::DEFAULT, Box::new(on_sample)).unwrap();
    for _ in 0..CYCLES {
        core.cycle().unwrap();
    }
    drop(go_on);
    let published = core.topics().find(|topic| &*topic.name == "text").unwrap().counter.messages();
    wait_until("the bridge has caught up", || {
        let report = &status.endpoints()[0];
        report.traffic.messages + report.traffic.dropped == published
    });
    let dropped = status.endpoints()[0].traffic.dropped;
    assert!((1..published).contains(&dropped), "{dropped} of {published}");
    core.stop();
}

/// The events of a topic that rclpy received since the last call.
fn events_of(peer: &mut Peer, topic: &str) -> Vec<Value> {
    peer.ask(json!({"do": "take_events", "topic": topic})).as_array().unwrap().clone()
}

/// Waits until rclpy has received such an event.
fn wait_for_event(peer: &mut Peer, topic: &str, event: &str, is: impl Fn(&Value) -> bool) {
    wait_until(&format!("rclpy hears of {event} on {topic}"), || {
        events_of(peer, topic).iter().any(|received| received["event"] == event && is(received))
    });
}

fn rclpy_endpoints(peer: &mut Peer, qos: &Value) {
    peer.ask(json!({"do": "subscribe", "topic": "/text", "type": TEXT, "qos": qos, "events": true}));
    peer.ask(json!({"do": "advertise", "topic": "/words", "type": TEXT, "qos": qos, "events": true}));
}

#[test]
fn rclpy_and_modules_hear_of_matches_and_of_incompatible_endpoints() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _checks = [
        check("Quality of service", "event: incompatible QoS", With::Rclpy, Way::Out),
        check("Quality of service", "event: incompatible QoS", With::Rclpy, Way::In),
        check("Quality of service", "event: matched", With::Rclpy, Way::Out),
        check("Quality of service", "event: matched", With::Rclpy, Way::In),
    ];
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let robot = Running::start(&participant, QosProfile::SENSOR_DATA);
    // What is offered does not suffice for a reliable subscription; any publisher does for ours.
    rclpy_endpoints(&mut peer, &json!({}));
    assert_eq!(robot.event("text", QosEvent::INCOMPATIBLE_QOS).policy, "RELIABILITY_QOS_POLICY");
    wait_for_event(&mut peer, "/text", "incompatible_qos", |received| received["total_count"] == 1);
    assert_eq!(robot.event("words", QosEvent::MATCHED).current, 1);
    wait_for_event(&mut peer, "/words", "matched", |received| received["current_count"] == 1);
    assert_eq!(robot.counts()[0].incompatible, 1);
    drop(robot);

    let latched = Running::start(&participant, QosProfile::LATCHED);
    assert_eq!(latched.event("text", QosEvent::MATCHED).current, 1);
    wait_for_event(&mut peer, "/text", "matched", |received| received["current_count"] == 1);
    assert_eq!(latched.event("words", QosEvent::INCOMPATIBLE_QOS).policy, "DURABILITY_QOS_POLICY");
    wait_for_event(&mut peer, "/words", "incompatible_qos", |received| received["total_count"] == 1);
    assert_eq!(latched.counts()[1].last_incompatible, Some(QosPolicyKind::Durability));
    peer.leave();
    assert_eq!(latched.event("text", QosEvent::MATCHED).current, 0, "it has left");
}

#[test]
fn modules_receive_an_event_of_an_endpoint_of_rclpy_with_another_type() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _checks = [
        check("Quality of service", "event: another type, in downbeat", With::Rclpy, Way::Out),
        check("Quality of service", "event: another type, in downbeat", With::Rclpy, Way::In),
    ];
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let robot = Running::start(&participant, QosProfile::DEFAULT);
    let other = "std_msgs/msg/Int32";
    peer.ask(json!({"do": "subscribe", "topic": "/text", "type": other, "events": true}));
    peer.ask(json!({"do": "advertise", "topic": "/words", "type": other, "events": true}));
    for topic in ["text", "words"] {
        assert_eq!(robot.event(topic, QosEvent::INCOMPATIBLE_TYPE).total, 1);
    }
    assert_eq!(robot.counts().map(|counts| (counts.incompatible_types, counts.matched)), [(1, 0); 2]);
    peer.leave();
}

#[test]
fn a_deadline_that_is_missed_is_told_on_both_sides() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _checks = [
        check("Quality of service", "event: deadline missed", With::Rclpy, Way::Out),
        check("Quality of service", "event: deadline missed", With::Rclpy, Way::In),
    ];
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let deadline = Some(Duration::from_millis(250)); // exact on the wire
    let robot = Running::start(&participant, QosProfile { deadline, ..QosProfile::DEFAULT });
    rclpy_endpoints(&mut peer, &json!({"deadline_ms": 250}));
    peer.take("/text", 3);
    robot.be_silent();
    assert!(robot.event("text", QosEvent::DEADLINE_MISSED).is_publisher);
    wait_for_event(&mut peer, "/text", "deadline", |received| received["total_count"].as_u64() >= Some(1));
    robot.event("words", QosEvent::MATCHED);
    wait_until("rclpy knows our subscription", || peer.ask(json!({"do": "matched", "topic": "/words"})) == 1);
    peer.ask(json!({"do": "publish", "topic": "/words", "fields": {"data": "last"}}));
    let missed = robot.event("words", QosEvent::DEADLINE_MISSED);
    assert!(!missed.is_publisher && missed.total >= 1, "{missed:?}");
    wait_for_event(&mut peer, "/words", "deadline", |received| received["total_count"].as_u64() >= Some(1));
    let [out, into] = robot.counts();
    assert!(out.deadlines_missed >= 1 && into.deadlines_missed >= 1);
}

#[test]
fn a_publisher_that_is_silent_is_told_to_be_not_alive_on_both_sides() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _checks = [
        check("Quality of service", "event: liveliness, manual_by_topic", With::Rclpy, Way::Out),
        check("Quality of service", "event: liveliness, manual_by_topic", With::Rclpy, Way::In),
    ];
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let qos = QosProfile {
        liveliness: Liveliness::ManualByTopic,
        liveliness_lease_duration: Some(Duration::from_millis(500)),
        ..QosProfile::DEFAULT
    };
    let robot = Running::start(&participant, qos);
    rclpy_endpoints(&mut peer, &json!({"liveliness": "manual_by_topic", "lease_ms": 500}));
    wait_for_event(&mut peer, "/text", "liveliness", |received| received["alive_count"] == 1);
    robot.be_silent();
    robot.event("text", QosEvent::LIVELINESS_LOST);
    wait_for_event(&mut peer, "/text", "liveliness", |received| received["not_alive_count"] == 1);

    let changed = |robot: &Running| {
        let event = robot.event("words", QosEvent::LIVELINESS_CHANGED);
        (event.current, event.not_alive)
    };
    // As in Fast DDS, the lease begins with the first message.
    peer.ask(json!({"do": "publish", "topic": "/words", "fields": {"data": "I am"}}));
    assert_eq!([changed(&robot), changed(&robot)], [(1, 0), (0, 1)]);
    wait_for_event(&mut peer, "/words", "liveliness", |received| received["total_count"].as_u64() >= Some(1));
    let [out, into] = robot.counts();
    assert!(out.liveliness_lost >= 1 && into.silences >= 1, "{out:?} {into:?}");
    peer.leave();
}

#[test]
fn events_of_an_endpoint_that_nobody_asked_for_are_not_measured() {
    let participant = RtpsParticipant::new(&on_loopback(free_domain())).unwrap();
    let endpoint = downbeat_bridge::middleware::Endpoint::new("rt/t", "T", QosProfile::DEFAULT);
    let writer = participant.create_writer(&endpoint).unwrap();
    let (sender, events) = channel();
    writer.on_event(Box::new(move |event: &EndpointEvent| {
        let _ = sender.send(event.clone());
    }));
    writer.on_event(Box::new(|_| ()));
    assert!(events.recv().is_err(), "another handler has taken its place");
}
