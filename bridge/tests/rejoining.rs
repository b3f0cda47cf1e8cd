//! What a node has by itself goes on after its participant has left the domain and joined it again.
#![allow(clippy::unwrap_used)]

mod common;

use common::{WATCHDOG, wait_until};
use downbeat_bridge::clock::{self, NodeClock};
use downbeat_bridge::expose::{ParameterExposure, ParameterServer};
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::middleware::rejoining::{Rejoining, Trouble, TroubleSink};
use downbeat_bridge::middleware::{Middleware, RejoinStep, Sample};
use downbeat_bridge::robot_description::RobotDescription;
use downbeat_bridge::ros::{MessageType, Node, NodeName, Participant, Subscription};
use downbeat_bridge::rosout::Rosout;
use downbeat_executor::{Clock, Core};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::Log;
use downbeat_msgs::rcl_interfaces::srv::{ListParameters, ListParametersRequest};
use downbeat_msgs::rosgraph_msgs::msg::Clock as ClockMessage;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_msgs::{Message, Service};
use std::sync::mpsc::{Receiver, channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tracing_subscriber::prelude::*;

/// A node whose participant rejoins a hub, the participant's engine, and where to tell trouble.
fn robot(hub: &Hub) -> (Node, Arc<Rejoining>, TroubleSink) {
    let (hub, sink) = (hub.clone(), Arc::<Mutex<Option<TroubleSink>>>::default());
    let told = Arc::clone(&sink);
    let engine = Rejoining::join(move |sink| {
        *told.lock().unwrap() = Some(sink);
        Ok(Box::new(hub.join()) as Box<dyn Middleware>)
    });
    let engine = Arc::new(engine.unwrap());
    let participant = Participant::on(Arc::clone(&engine) as _).unwrap();
    let node = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let sink = sink.lock().unwrap().clone().unwrap();
    (node, engine, sink)
}

fn peer(hub: &Hub) -> Node {
    let participant = Participant::on(Arc::new(hub.join())).unwrap();
    participant.create_node(NodeName::new("/", "peer").unwrap()).unwrap()
}

fn hear<M: Message>(node: &Node, topic: &str, qos: QosProfile) -> (Subscription, Receiver<M>) {
    let (sender, messages) = channel();
    // The test may have stopped listening.
    let on_sample = move |sample: Sample| drop(sender.send(cdr::from_slice::<M>(&sample.cdr).unwrap()));
    let kind = MessageType::new(M::TYPE_NAME).unwrap();
    (node.subscribe(topic, &kind, qos, Box::new(on_sample)).unwrap(), messages)
}

#[test]
fn the_log_the_time_the_description_and_the_parameters_of_a_node_go_on() {
    let (hub, rosout, node_clock) = (Hub::new(), Rosout::new(), NodeClock::default());
    let (node, engine, sink) = robot(&hub);
    let peer_node = peer(&hub);
    let publishing = rosout.publish(&node).unwrap();
    let _log = tracing_subscriber::registry().with(rosout.layer()).set_default();
    let _description = RobotDescription::publish(&node, "<robot name=\"stick\"/>").unwrap();
    let mut core = Core::new().with_clock(node_clock.clone());
    clock::publish(&mut core, &node, Duration::from_millis(5)).unwrap();
    let server = ParameterServer::start(&core, None).unwrap();
    let _parameters = server.serve(&node, ParameterExposure::default()).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run().unwrap());
    let (_time, times) = hear::<ClockMessage>(&peer_node, "/clock", QosProfile::CLOCK);
    times.recv_timeout(WATCHDOG).unwrap();

    let (sender, steps) = channel();
    engine.on_rejoin(Box::new(move |step| drop(sender.send(step.clone()))));
    sink.tell(Trouble::Engine("a test says so".to_owned()));
    // Lines are logged before, while it is away, and after.
    let mut logged = 0;
    let mut is_back = false;
    wait_until("the participant is there again", || {
        tracing::info!("line {logged}");
        logged += 1;
        is_back |= steps.try_iter().any(|step| matches!(step, RejoinStep::Joined { .. }));
        is_back
    });

    let (_late, lines) = hear::<Log>(&peer(&hub), "/rosout", QosProfile::ROSOUT);
    let mut heard = Vec::new();
    wait_until("who comes late hears all lines", || {
        heard.extend(lines.try_iter().map(|line| line.msg).filter(|line| line.starts_with("line ")));
        heard.len() >= logged.min(900)
    });
    let expected: Vec<_> = (logged - heard.len()..logged).map(|number| format!("line {number}")).collect();
    assert_eq!(heard, expected, "none is missing, none comes twice");
    assert_eq!((rosout.status().failed, rosout.status().dropped), (0, 0));

    let (_late, descriptions) = hear::<Text>(&peer(&hub), "/robot_description", QosProfile::LATCHED);
    assert_eq!(descriptions.recv_timeout(WATCHDOG).unwrap().data, "<robot name=\"stick\"/>");

    let back = node_clock.now().as_nanos();
    let is_after = |time: ClockMessage| time.clock.as_nanos() > back;
    wait_until("who listened before hears the time again", || times.try_iter().any(is_after));

    let service = format!("/robot/list_parameters ({})", ListParameters::TYPE_NAME);
    let client =
        peer_node.client::<ListParameters>("/robot/list_parameters", QosProfile::PARAMETERS).unwrap();
    assert!(client.wait_for_service(WATCHDOG), "{service}");
    let listed = client.call_and_wait(&ListParametersRequest::default(), WATCHDOG).unwrap();
    assert!(listed.result.names.contains(&"use_sim_time".to_owned()));
    handle.stop();
    running.join().unwrap();
    drop(publishing);
}
