//! Modules as managed nodes, seen by rclpy through the calls of `ros2 lifecycle`.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{RunningCore, WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::lifecycle::{LifecycleError, LifecycleExposure, LifecycleNodes, expose_lifecycle};
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_executor::{
    Context, Core, Inbox, LifecycleState, Module, ModuleOptions, Restart, Setup, SetupError, Synchrony,
    Transition, TransitionError,
};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use test_machine::free_domain;

/// What the module does when it is activated next.
#[derive(Clone, Default)]
struct Mood {
    fails: Arc<AtomicBool>,
    panics: Arc<AtomicBool>,
}

struct Camera(Mood);

impl Module for Camera {
    type Ports = ();

    fn setup(&mut self, _: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        Ok(())
    }

    fn activate(&mut self, _: &mut Context<'_>) -> Result<(), TransitionError> {
        assert!(!self.0.panics.swap(false, Ordering::SeqCst), "a module that panics, as this test wants it");
        match self.0.fails.swap(false, Ordering::SeqCst) {
            true => Err(TransitionError::new("the lens is covered")),
            false => Ok(()),
        }
    }
}

struct Robot {
    core: RunningCore,
    mood: Mood,
    _nodes: LifecycleNodes,
}

/// The detached module `camera` as the node `/robot/camera`, unconfigured.
fn robot(domain_id: u16) -> Robot {
    let (mut core, mood) = (Core::new(), Mood::default());
    let options = ModuleOptions {
        synchrony: Synchrony::Detached(Inbox::KeepAll),
        initial_state: LifecycleState::Unconfigured,
        restart: Restart::Always { backoff: Duration::from_millis(1) },
        ..ModuleOptions::default()
    };
    let made = mood.clone();
    core.add_restartable("camera", move || Camera(made.clone()), options).unwrap();
    let participant = Participant::join(&on_loopback(domain_id)).unwrap();
    let exposure =
        LifecycleExposure { module: "camera".into(), node: NodeName::new("/robot", "camera").unwrap() };
    let nodes = expose_lifecycle(&core, &participant, &[exposure]).unwrap();
    let core = RunningCore::start(core);
    Robot { core, mood, _nodes: nodes }
}

impl Robot {
    /// Makes a transition of the module and waits for it.
    fn change(&self, transition: Transition) {
        let made = self.core.transition("camera", transition).wait(WATCHDOG);
        assert!(matches!(made, Some(Ok(_))), "{transition}: {made:?}");
    }
}

const SERVICES: [(&str, &str); 5] = [
    ("change_state", "ChangeState"),
    ("get_state", "GetState"),
    ("get_available_states", "GetAvailableStates"),
    ("get_available_transitions", "GetAvailableTransitions"),
    ("get_transition_graph", "GetAvailableTransitions"),
];

fn name(service: &str) -> String {
    format!("/robot/camera/{service}")
}

fn call(rclpy: &mut Peer, service: &str, request: Value) -> Value {
    rclpy.ask(json!({"do": "call", "service": name(service), "requests": [request]}))[0].clone()
}

fn state(rclpy: &mut Peer) -> Value {
    call(rclpy, "get_state", json!({}))["current_state"].clone()
}

/// As `ros2 lifecycle set` asks for it: with the label and id of an available transition.
fn set(rclpy: &mut Peer, label: &str) -> bool {
    let available = call(rclpy, "get_available_transitions", json!({}));
    let available = available["available_transitions"].as_array().unwrap();
    let wanted = available.iter().find(|transition| transition["transition"]["label"] == label).unwrap();
    let request = json!({"transition": wanted["transition"]});
    call(rclpy, "change_state", request)["success"].as_bool().unwrap()
}

/// The states of events that have come since the last call, once the last of them is `goal`.
fn events_until(rclpy: &mut Peer, goal: &str) -> Vec<String> {
    let mut path: Vec<String> = Vec::new();
    wait_until("rclpy hears the transitions", || {
        let events = rclpy.ask(json!({"do": "take", "topic": name("transition_event")}));
        for event in events.as_array().unwrap() {
            let label = |state: &str| event["fields"][state]["label"].as_str().unwrap().to_owned();
            assert!(path.last().is_none_or(|last| *last == label("start_state")), "{path:?}, {event}");
            if path.is_empty() {
                path.push(label("start_state"));
            }
            path.push(label("goal_state"));
        }
        path.last().is_some_and(|last| last == goal)
    });
    path
}

#[test]
fn rclpy_manages_a_module_as_ros2_lifecycle_does() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Node services", "lifecycle: nodes, list, get, set", With::Rclpy, Way::In);
    let _check2 = check("Node services", "transition_event", With::Rclpy, Way::Out);
    let robot = robot(domain);
    let kind = "lifecycle_msgs/msg/TransitionEvent";
    rclpy.ask(json!({"do": "subscribe", "topic": name("transition_event"), "type": kind}));
    for (service, kind) in SERVICES {
        let kind = format!("lifecycle_msgs/srv/{kind}");
        rclpy.ask(json!({"do": "client", "service": name(service), "type": kind}));
        assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": name(service)})), true);
        // By which `ros2 lifecycle nodes` knows a managed node.
        assert_eq!(rclpy.ask(json!({"do": "services_and_types"}))[name(service)], json!([kind]));
    }
    wait_until("the robot hears rclpy", || {
        let publishers = rclpy.ask(json!({"do": "publishers_of", "topic": name("transition_event")}));
        publishers.as_array().unwrap().iter().any(|publisher| publisher["node"] == "/robot/camera")
    });
    assert_eq!(state(&mut rclpy), json!({"id": 1, "label": "unconfigured"}));
    let states = call(&mut rclpy, "get_available_states", json!({}))["available_states"].clone();
    assert_eq!(
        (states.as_array().unwrap().len(), &states[8]),
        (11, &json!({"id": 13, "label": "activating"}))
    );
    let graph = call(&mut rclpy, "get_transition_graph", json!({}))["available_transitions"].clone();
    assert_eq!(graph.as_array().unwrap().len(), 25);
    let expected = json!({
        "transition": {"id": 30, "label": "transition_success"},
        "start_state": {"id": 13, "label": "activating"},
        "goal_state": {"id": 3, "label": "active"},
    });
    assert_eq!(graph[9], expected);

    assert!(set(&mut rclpy, "configure") && set(&mut rclpy, "activate"));
    assert_eq!(state(&mut rclpy), json!({"id": 3, "label": "active"}));
    let path = ["unconfigured", "configuring", "inactive", "activating", "active"];
    assert_eq!(events_until(&mut rclpy, "active"), path);

    // By label alone, as `ros2 service call` would; what does not begin here, or nowhere, is refused.
    let wanted = |label: &str, id: u8| json!({"transition": {"label": label, "id": id}});
    assert_eq!(call(&mut rclpy, "change_state", wanted("configure", 0))["success"], false);
    assert_eq!(call(&mut rclpy, "change_state", wanted("", 99))["success"], false);
    assert_eq!(call(&mut rclpy, "change_state", wanted("deactivate", 0))["success"], true);
    assert_eq!(events_until(&mut rclpy, "inactive"), ["active", "deactivating", "inactive"]);

    robot.mood.fails.store(true, Ordering::SeqCst);
    assert!(!set(&mut rclpy, "activate"));
    assert_eq!(state(&mut rclpy)["label"], "inactive");
    assert_eq!(events_until(&mut rclpy, "inactive"), ["inactive", "activating", "inactive"]);

    robot.mood.panics.store(true, Ordering::SeqCst);
    assert!(!set(&mut rclpy, "activate"));
    let path = ["inactive", "activating", "errorprocessing", "finalized"];
    assert_eq!(events_until(&mut rclpy, "finalized"), path);
    rclpy.leave();
}

/// Nav2's lifecycle manager with a participant of Cyclone DDS: heartbeats of its own, and those of the node.
#[test]
fn an_active_node_answers_the_bond_of_its_manager_and_ends_it_when_it_is_deactivated() {
    let domain = free_domain();
    let Some(mut manager) = Peer::cyclonedds(domain) else { return };
    let _check = check("Node services", "bond with a lifecycle manager", With::Cyclone, Way::Both);
    let robot = robot(domain);
    let (topic, kind, qos) = ("/robot/bond", "bond/msg/Status", json!({"depth": 100}));
    manager.ask(json!({"do": "subscribe", "topic": topic, "type": kind, "qos": qos}));
    manager.ask(json!({"do": "advertise", "topic": topic, "type": kind, "qos": qos}));
    let wanted = |id: &str, instance: &str, active: bool| {
        let fields = json!({
            "header": {}, "id": id, "instance_id": instance, "active": active, "heartbeat_timeout": 4.0, "heartbeat_period": 0.1,
        });
        json!({"do": "publish", "topic": topic, "fields": fields})
    };
    // Of the node, since the last call: which side of the bond says that it is alive.
    let heard = |manager: &mut Peer| -> Vec<(String, bool)> {
        let messages = manager.ask(json!({"do": "take", "topic": topic}));
        let messages = messages.as_array().unwrap().iter().map(|message| &message["fields"]);
        let messages =
            messages.filter(|fields| fields["instance_id"].as_str().unwrap().contains("/robot/camera"));
        let said = messages
            .map(|fields| (fields["id"].as_str().unwrap().to_owned(), fields["active"].as_bool().unwrap()));
        said.collect()
    };
    wait_until("the manager is matched", || manager.ask(json!({"do": "matched", "topic": topic})) == 2);

    // The module is not active, and a bond of another node is not its own.
    manager.ask(wanted("camera", "first", true));
    manager.ask(wanted("other", "first", true));
    for transition in [Transition::Configure, Transition::Activate] {
        robot.change(transition);
    }
    assert!(heard(&mut manager).is_empty());
    manager.ask(wanted("camera", "first", true));
    let mut said = Vec::new();
    wait_until("several heartbeats", || {
        manager.ask(wanted("camera", "first", true));
        said.extend(heard(&mut manager));
        said.len() >= 5
    });
    assert!(said.iter().all(|one| *one == ("camera".to_owned(), true)), "{said:?}");

    robot.change(Transition::Deactivate);
    wait_until("the end of the bond", || {
        manager.ask(wanted("camera", "first", true));
        heard(&mut manager).last().is_some_and(|(_, is_active)| !is_active)
    });
    manager.ask(wanted("camera", "first", false));
    robot.change(Transition::Activate);
    // A manager that was started again.
    wait_until("another bond", || {
        manager.ask(wanted("camera", "second", true));
        heard(&mut manager).last().is_some_and(|(_, is_active)| *is_active)
    });
    drop(robot);
    wait_until("the end of the node", || heard(&mut manager).last().is_some_and(|(_, is_active)| !is_active));
    manager.leave();
}

#[test]
fn a_module_that_is_not_there_is_refused_by_its_name() {
    let participant = Participant::on(Arc::new(Hub::new().join())).unwrap();
    let exposure = LifecycleExposure { module: "eye".into(), node: NodeName::new("/", "eye").unwrap() };
    let refused = expose_lifecycle(&Core::new(), &participant, &[exposure]).err().unwrap();
    assert!(matches!(&refused, LifecycleError::UnknownModule(module) if module == "eye"), "{refused}");
}
