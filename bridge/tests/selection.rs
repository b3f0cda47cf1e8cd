//! What is exposed, how much of it, under which names and on which nodes, and changing it while the core
//! runs; over the engine in memory.
#![allow(clippy::unwrap_used)]

mod common;

use common::{RunningCore, wait_until};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{Bridge, ExposeError, Exposure, Limits, NetworkNodes, OfACycle, expose};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, RemapRules, Subscription};
use downbeat_executor::{
    Context, Core, GraphEdge, Inlet, ManualClock, Module, Received, Setup, SetupError, Time,
};
use downbeat_msgs::{cdr, qos::QosProfile, std_msgs::msg};
use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

struct Peer {
    participant: Participant,
    node: Node,
}

fn join(hub: &Hub, namespace: &str, name: &str, rules: RemapRules) -> Peer {
    let participant = Participant::on_with(Arc::new(hub.join()), rules, Interfaces::carried()).unwrap();
    let node = participant.create_node(NodeName::new(namespace, name).unwrap()).unwrap();
    Peer { participant, node }
}

fn peers() -> (Peer, Peer) {
    let hub = Hub::new();
    (join(&hub, "/", "robot", RemapRules::default()), join(&hub, "/", "peer", RemapRules::default()))
}

impl Peer {
    fn listen(&self, topic: &str) -> (Subscription, Receiver<String>) {
        let (sender, texts) = channel();
        let on_sample = move |sample: downbeat_bridge::middleware::Sample| {
            let _ = sender.send(cdr::from_slice::<msg::String>(&sample.cdr).unwrap().data);
        };
        (self.node.subscribe(topic, &string(), QosProfile::DEFAULT, Box::new(on_sample)).unwrap(), texts)
    }

    /// The topics of the node of that name.
    fn topics_of(&self, node: &str) -> Vec<String> {
        let nodes = self.participant.remote_nodes().into_iter().filter(|other| other.name == node);
        nodes.flat_map(|node| node.endpoints).map(|endpoint| endpoint.topic.to_string()).collect()
    }
}

fn string() -> MessageType {
    MessageType::new("std_msgs/msg/String").unwrap()
}

fn text(topic: &str, direction: Direction) -> Exposure {
    Exposure::new(topic, Interfaces::carried().message("std_msgs/msg/String").unwrap(), direction)
}

fn message(text: impl ToString) -> msg::String {
    msg::String { data: text.to_string() }
}

/// A core under a clock that is moved by hand, with a way to publish on `text`.
fn core() -> (Core, ManualClock, Inlet<msg::String>) {
    let clock = ManualClock::new(Time::ZERO);
    let mut core = Core::new().with_clock(clock.clone());
    let inlet = core.inlet("text").unwrap();
    (core, clock, inlet)
}

#[test]
fn a_topic_is_thinned_out_by_the_time_of_the_executor() {
    let received = || {
        let (robot, peer) = peers();
        let (mut core, clock, inlet) = core();
        let limits = Limits { period: Some(Duration::from_millis(100)), ..Limits::default() };
        let status =
            expose(&mut core, &robot.node, &[Exposure { limits, ..text("text", Direction::Out) }]).unwrap();
        let (_subscription, texts) = peer.listen("/text");
        for number in 0..50 {
            inlet.publish(message(number)).unwrap();
            core.cycle().unwrap();
            clock.advance(Duration::from_millis(8));
        }
        core.cycle().unwrap();
        let report = &status.endpoints()[0];
        assert_eq!((report.traffic.messages, report.traffic.limited, report.traffic.skipped), (4, 46, 0));
        texts.try_iter().collect::<Vec<_>>()
    };
    assert_eq!(received(), ["0", "13", "25", "38"], "at 0, 104, 200 and 304 ms");
    assert_eq!(received(), received());
}

#[test]
fn of_one_cycle_only_the_latest_and_of_those_each_second() {
    let (robot, peer) = peers();
    let (mut core, _, inlet) = core();
    let limits = Limits { every: 2, of_a_cycle: OfACycle::Latest, ..Limits::default() };
    expose(&mut core, &robot.node, &[Exposure { limits, ..text("text", Direction::Out) }]).unwrap();
    let (_subscription, texts) = peer.listen("/text");
    for cycle in 0..5 {
        for number in 0..3 {
            inlet.publish(message(format!("{cycle}.{number}"))).unwrap();
        }
        core.cycle().unwrap();
    }
    core.cycle().unwrap();
    assert_eq!(texts.try_iter().collect::<Vec<_>>(), ["0.2", "2.2", "4.2"]);
}

/// Passes on what it hears on `text`.
struct Listener(Sender<String>);

impl Module for Listener {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.subscribe(
            "text",
            |listener: &mut Self, text: Received<'_, msg::String>, _: &mut Context<'_>| {
                let _ = listener.0.send(text.data.clone());
            },
        )
    }
}

#[test]
fn what_comes_in_is_thinned_out_too() {
    let heard = |limits: Limits| {
        let (robot, peer) = peers();
        let (mut core, clock, _) = core();
        let (sender, heard) = channel();
        core.add("listener", Listener(sender)).unwrap();
        expose(&mut core, &robot.node, &[Exposure { limits, ..text("text", Direction::In) }]).unwrap();
        let publisher = peer.node.publish("/text", &string(), QosProfile::DEFAULT).unwrap();
        for number in 0..6 {
            publisher.publish(cdr::to_vec(&message(number)).into()).unwrap();
            clock.advance(Duration::from_millis(40));
            if number % 2 == 1 {
                core.cycle().unwrap();
            }
        }
        (0..2).for_each(|_| core.cycle().unwrap());
        heard.try_iter().collect::<Vec<_>>().join(" ")
    };
    assert_eq!(heard(Limits::default()), "0 1 2 3 4 5");
    assert_eq!(heard(Limits { every: 3, ..Limits::default() }), "0 3");
    assert_eq!(heard(Limits { period: Some(Duration::from_millis(80)), ..Limits::default() }), "0 2 4");
    assert_eq!(heard(Limits { of_a_cycle: OfACycle::Latest, ..Limits::default() }), "1 3 5");
}

#[test]
fn an_endpoint_may_be_of_another_node_of_the_same_participant() {
    let (robot, peer) = peers();
    let (mut core, _, _) = core();
    core.inlet::<msg::String>("image").unwrap();
    core.inlet::<msg::String>("info").unwrap();
    let of_camera = |topic: &str, ros_topic: &str| Exposure {
        node: Some(NodeName::new("/sensors", "camera").unwrap()),
        ros_topic: Some(ros_topic.to_owned()),
        ..text(topic, Direction::Out)
    };
    let exposures = [text("text", Direction::Out), of_camera("image", "~/image"), of_camera("info", "info")];
    let status = expose(&mut core, &robot.node, &exposures).unwrap();
    core.cycle().unwrap();
    assert_eq!(peer.topics_of("/robot"), ["/text"]);
    assert_eq!(peer.topics_of("/sensors/camera"), ["/sensors/camera/image", "/sensors/info"]);
    assert_eq!(status.endpoints()[1].endpoint.node, "/sensors/camera");
    core.stop();
    assert_eq!(peer.topics_of("/sensors/camera"), Vec::<String>::new());
    assert!(peer.participant.remote_nodes().iter().all(|node| node.name != "/sensors/camera"));
}

#[test]
fn remapping_rules_apply_to_nodes_and_topics() {
    let hub = Hub::new();
    let rules = ["__ns:=/robot1", "robot:__node:=left", "text:=/said", "left:~/image:=picture"];
    let rules = rules.iter().map(|rule| rule.parse().unwrap()).collect();
    let (robot, peer) = (join(&hub, "/", "robot", rules), join(&hub, "/", "peer", RemapRules::default()));
    let (mut core, _, inlet) = core();
    core.inlet::<msg::String>("image").unwrap();
    let image = Exposure { ros_topic: Some("~/image".into()), ..text("image", Direction::Out) };
    expose(&mut core, &robot.node, &[text("text", Direction::Out), image]).unwrap();
    let (_subscription, texts) = peer.listen("/said");
    inlet.publish(message("hello")).unwrap();
    (0..2).for_each(|_| core.cycle().unwrap());
    assert_eq!(texts.try_iter().collect::<Vec<_>>(), ["hello"]);
    assert_eq!(robot.node.name().to_string(), "/robot1/left");
    assert_eq!(peer.topics_of("/robot1/left"), ["/robot1/picture", "/said"]);
}

#[test]
fn two_nodes_that_remapping_gives_the_same_name_are_refused() {
    let rules = ["__node:=same".parse().unwrap()].into_iter().collect();
    let robot = join(&Hub::new(), "/", "robot", rules);
    let (mut core, _, _) = core();
    let other = Exposure { node: Some(NodeName::new("/", "b").unwrap()), ..text("text", Direction::Out) };
    let error = expose(&mut core, &robot.node, &[other]).err().unwrap().to_string();
    assert!(error.contains("/same") && error.contains("already"), "{error}");
}

/// A core that runs on a thread of its own until it is dropped.
struct Running {
    handle: RunningCore,
    bridge: Bridge,
    inlets: Vec<Inlet<msg::String>>,
}

fn running(robot: &Peer, exposures: &[Exposure], heard: Sender<String>) -> Running {
    let mut core = Core::new();
    let inlets = ["a", "b"].map(|topic| core.inlet(topic).unwrap()).into();
    core.add("listener", Listener(heard)).unwrap();
    let bridge = Bridge::start(&mut core, &robot.node, exposures).unwrap();
    let handle = RunningCore::start(core);
    Running { handle, bridge, inlets }
}

impl Running {
    /// The topics that the bridge takes out of the core.
    fn taken(&self) -> Vec<String> {
        let graph = self.handle.graph().wait(common::WATCHDOG).unwrap();
        let leaves = graph.edges.iter().filter_map(|edge| match edge {
            GraphEdge::Leaves { topic, .. } => Some(graph.topics[*topic].name.clone()),
            _ => None,
        });
        leaves.collect()
    }

    fn remove(&self, topic: &str) -> usize {
        self.bridge.remove(|endpoint| endpoint.topic == topic).len()
    }
}

#[test]
fn endpoints_come_and_go_while_the_core_runs() {
    let (robot, peer) = peers();
    let running = running(&robot, &[text("a", Direction::Out)], channel().0);
    let (_of_a, texts_of_a) = peer.listen("/a");
    let (_of_b, texts_of_b) = peer.listen("/b");
    let next = |texts: &Receiver<String>| texts.recv_timeout(common::WATCHDOG).unwrap();

    running.bridge.add(&[text("b", Direction::Out)]).unwrap();
    assert_eq!(peer.topics_of("/robot"), ["/a", "/b"]);
    running.inlets[1].publish(message("one")).unwrap();
    assert_eq!(next(&texts_of_b), "one");
    assert_eq!(running.taken(), ["a", "b"]);

    assert_eq!(running.remove("b"), 1);
    assert_eq!(peer.topics_of("/robot"), ["/a"], "it is gone when this returns");
    assert_eq!(running.bridge.status().endpoints().len(), 1);
    wait_until("its outlet is gone", || running.taken() == ["a"]);

    assert_eq!(running.remove("a"), 1);
    assert_eq!(peer.topics_of("/robot"), Vec::<String>::new());
    running.inlets[0].publish(message("unheard")).unwrap();
    running.bridge.add(&[text("a", Direction::Out)]).unwrap();
    assert_eq!(running.taken(), ["a"]);
    running.inlets[0].publish(message("two")).unwrap();
    // What was published while nobody exposed it may have been on its way to the bridge.
    wait_until("what is published now goes out again", || next(&texts_of_a) == "two");
    assert_eq!(running.remove("a"), 1);
    assert_eq!(running.remove("a"), 0);
}

#[test]
fn what_comes_in_is_added_and_removed_while_the_core_runs() {
    let (robot, peer) = peers();
    let (sender, heard) = channel();
    let running = running(&robot, &[], sender);
    running.bridge.add(&[text("text", Direction::In)]).unwrap();
    let publisher = peer.node.publish("/text", &string(), QosProfile::DEFAULT).unwrap();
    publisher.publish(cdr::to_vec(&message("one")).into()).unwrap();
    assert_eq!(heard.recv_timeout(common::WATCHDOG).unwrap(), "one");
    assert_eq!(running.remove("text"), 1);
    assert_eq!(publisher.matched_subscriptions(), 0);
    publisher.publish(cdr::to_vec(&message("two")).into()).unwrap();
    running.bridge.add(&[text("text", Direction::In)]).unwrap();
    publisher.publish(cdr::to_vec(&message("three")).into()).unwrap();
    assert_eq!(heard.recv_timeout(common::WATCHDOG).unwrap(), "three");
}

#[test]
fn a_change_that_cannot_be_changes_nothing() {
    let (robot, peer) = peers();
    let running = running(&robot, &[text("a", Direction::Out)], channel().0);
    let refused = |exposures: &[Exposure]| running.bridge.add(exposures).err().unwrap();
    assert!(matches!(
        refused(&[text("b", Direction::Out), text("a", Direction::Out)]),
        ExposeError::Twice(_)
    ));
    assert!(matches!(refused(&[text("a", Direction::In)]), ExposeError::BothDirections(_)));
    let imu = Interfaces::carried().message("sensor_msgs/msg/Imu").unwrap();
    assert!(matches!(refused(&[Exposure::new("b", imu, Direction::Out)]), ExposeError::Setup(_)));
    assert!(matches!(refused(&[Exposure::new("text", imu, Direction::In)]), ExposeError::Setup(_)));
    assert_eq!(peer.topics_of("/robot"), ["/a"]);
    assert_eq!(running.taken(), ["a"]);
    let of_another_type = [text("a", Direction::Out), Exposure::new("b", imu, Direction::Out)];
    assert_eq!(running.remove("a"), 1);
    assert!(matches!(refused(&of_another_type), ExposeError::Setup(_)));
    assert_eq!(peer.topics_of("/robot"), Vec::<String>::new(), "not the one that could be either");
    running.bridge.add(&[text("a", Direction::Out)]).unwrap();
    assert_eq!(running.taken(), ["a"]);
    running.bridge.add(&[text("b", Direction::Out)]).unwrap();
    let bridge = running.bridge.clone();
    drop(running);
    assert!(bridge.add(&[text("text", Direction::In)]).is_err());
    assert_eq!(peer.topics_of("/robot"), Vec::<String>::new(), "all endpoints go with the core");
}

/// A robot in a lab and in a fleet, and somebody who looks at each of them.
struct TwoNetworks {
    robot: NetworkNodes,
    lab: Peer,
    fleet: Peer,
}

impl TwoNetworks {
    fn new() -> Self {
        let (lab, fleet) = (Hub::new(), Hub::new());
        let peer = |hub, name| join(hub, "/", name, RemapRules::default());
        let networks = BTreeMap::from([("fleet".to_owned(), peer(&fleet, "robot").node)]);
        let robot = NetworkNodes::new(peer(&lab, "robot").node, networks);
        Self { robot, lab: peer(&lab, "peer"), fleet: peer(&fleet, "peer") }
    }

    fn start(&self, core: &mut Core, exposures: &[Exposure]) -> Result<Bridge, ExposeError> {
        Bridge::start(core, self.robot.clone(), exposures)
    }
}

fn in_fleet(exposure: Exposure) -> Exposure {
    Exposure { network: Some("fleet".to_owned()), ..exposure }
}

#[test]
fn each_network_has_its_own_selection() {
    let networks = TwoNetworks::new();
    let (mut core, _, _) = core();
    core.inlet::<msg::String>("image").unwrap();
    let out = |topic| text(topic, Direction::Out);
    let bridge = networks.start(&mut core, &[out("text"), out("image"), in_fleet(out("text"))]).unwrap();
    core.cycle().unwrap();
    assert_eq!(networks.lab.topics_of("/robot"), ["/image", "/text"]);
    assert_eq!(networks.fleet.topics_of("/robot"), ["/text"]);
    assert_eq!(bridge.status().endpoints()[2].endpoint.network.as_deref(), Some("fleet"));
    let unknown = Exposure { network: Some("base".to_owned()), ..out("image") };
    assert!(matches!(bridge.add(&[unknown]), Err(ExposeError::NoNetwork { .. })));
}

#[test]
fn messages_of_one_network_go_to_another_only_if_that_is_allowed_and_never_back() {
    let networks = TwoNetworks::new();
    let refused =
        networks.start(&mut core().0, &[text("text", Direction::In), in_fleet(text("text", Direction::Out))]);
    assert!(matches!(refused, Err(ExposeError::Relay(_))), "{:?}", refused.err());

    let (mut core, _, _) = core();
    let relayed = in_fleet(Exposure { relays: true, ..text("text", Direction::Out) });
    let _bridge = networks.start(&mut core, &[text("text", Direction::In), relayed]).unwrap();
    let (_in_lab, heard_in_lab) = networks.lab.listen("text");
    let (_in_fleet, heard_in_fleet) = networks.fleet.listen("text");
    let publisher = networks.lab.node.publish("text", &string(), QosProfile::DEFAULT).unwrap();
    publisher.publish(cdr::to_vec(&message("forward")).into()).unwrap();
    (0..4).for_each(|_| core.cycle().unwrap());
    assert_eq!(heard_in_fleet.try_iter().collect::<Vec<_>>(), ["forward"]);
    assert_eq!(heard_in_lab.try_iter().collect::<Vec<_>>(), ["forward"], "once, from its publisher");
}

#[test]
fn a_slow_network_delays_no_other() {
    let networks = TwoNetworks::new();
    let mut core = Core::new();
    let inlet = core.inlet::<msg::String>("text").unwrap();
    let out = || text("text", Direction::Out);
    let _bridge = networks.start(&mut core, &[in_fleet(out()), out()]).unwrap();
    let (release, held) = channel::<()>();
    let blocks = move |_| assert!(held.recv().is_err(), "nothing is sent, only released");
    let _blocking =
        networks.fleet.node.subscribe("text", &string(), QosProfile::DEFAULT, Box::new(blocks)).unwrap();
    let (_in_lab, heard_in_lab) = networks.lab.listen("text");
    let _running = RunningCore::start(core);
    for number in ["1", "2", "3"] {
        inlet.publish(message(number)).unwrap();
        assert_eq!(heard_in_lab.recv_timeout(Duration::from_secs(30)).unwrap(), number);
    }
    drop(release);
}
