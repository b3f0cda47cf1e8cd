//! Service introspection: what a robot's services and calls publish of what they do, as rclpy hears it.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{
    SERVICES_MODULE_NAME, ServiceExposure, ServiceIntrospection, expose_services_with,
};
use downbeat_bridge::ros::{Introspection, NodeName, Participant};
use downbeat_executor::{Context, Core, Module, Setup, SetupError};
use downbeat_msgs::std_srvs::srv::{SetBoolRequest, SetBoolResponse};
use serde_json::{Value, json};
use std::cell::Cell;
use std::sync::mpsc::{Sender, channel};
use std::time::Duration;
use test_machine::free_domain;

const TYPE: &str = "std_srvs/srv/SetBool";
const OURS: &str = "/stand_up/_service_event";
const THEIRS: &str = "/light/_service_event";

/// Serves `stand_up`, and calls `light` on `ask`.
struct Robot(Sender<SetBoolResponse>);

impl Module for Robot {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.serve::<SetBoolRequest, SetBoolResponse, _>("stand_up", |_, request, _| {
            Ok(SetBoolResponse { success: request.data, message: "standing".into() })
        })?;
        let timeout = Duration::from_secs(20);
        let light = setup.client::<SetBoolRequest, SetBoolResponse, _>(
            "light",
            timeout,
            |robot: &mut Self, reply, _| robot.0.send(reply.result.unwrap()).unwrap(),
        )?;
        setup.subscribe::<bool, _>("ask", move |_: &mut Self, data, ctx: &mut Context<'_>| {
            ctx.call(light, SetBoolRequest { data: *data });
        })
    }
}

/// The two events of the request of that number: their types, and what they hold.
fn events_of(rclpy: &mut Peer, topic: &str, number: i64) -> [(Value, Value, Value); 2] {
    let mut events = Vec::new();
    wait_until("both events of the request have come", || {
        let taken = rclpy.ask(json!({"do": "take", "topic": topic}));
        let taken = taken.as_array().unwrap().iter().map(|event| event["fields"].clone());
        events.extend(taken.filter(|event| event["info"]["sequence_number"] == number));
        events.len() >= 2
    });
    let [first, second] = <[Value; 2]>::try_from(events).unwrap();
    assert_eq!(first["info"]["client_gid"], second["info"]["client_gid"]);
    assert!(first["info"]["client_gid"].as_array().unwrap().iter().any(|byte| *byte != 0));
    assert!(first["info"]["stamp"]["sec"].as_i64().unwrap() > 1_700_000_000);
    [first, second].map(|event| {
        (event["info"]["event_type"].clone(), event["request"].clone(), event["response"].clone())
    })
}

/// Calls until an event is heard: who publishes is known a little before the publisher knows who listens.
fn call_until_heard(rclpy: &mut Peer, topic: &str, mut call: impl FnMut(&mut Peer)) {
    wait_until("the first event has come", || {
        call(rclpy);
        rclpy.ask(json!({"do": "take", "topic": topic})) != json!([])
    });
}

#[test]
fn services_and_calls_tell_of_themselves_as_they_are_set_to() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _out = check("Services", "introspection of services: off, metadata, contents", With::Rclpy, Way::Out);
    let _calls =
        check("Services", "introspection of clients: off, metadata, contents", With::Rclpy, Way::Out);
    let _echo = check("Services", "ros2 service echo", With::Rclpy, Way::Out);
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let node = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let mut core = Core::new();
    let (sender, answers) = channel();
    core.add("robot", Robot(sender)).unwrap();
    let ask = core.inlet("ask").unwrap();
    let service_type = Interfaces::carried().service(TYPE).unwrap();
    let timeout = Duration::from_secs(10);
    let offered = ServiceExposure {
        service: "stand_up".into(),
        ros_service: None,
        service_type,
        timeout,
        network: None,
    };
    let called =
        ServiceExposure { service: "light".into(), ros_service: None, service_type, timeout, network: None };
    let introspection =
        ServiceIntrospection { services: Introspection::Metadata, clients: Introspection::Off };
    let status = expose_services_with(&mut core, &node, &[offered], &[called], introspection).unwrap();
    let handle = core.handle();
    let thread = std::thread::spawn(move || core.run().unwrap());
    let set = |setting: &str, word: &str| {
        handle.set(SERVICES_MODULE_NAME, setting, word.to_owned()).wait(WATCHDOG).unwrap()
    };

    rclpy.ask(json!({"do": "serve", "service": "/light", "type": TYPE}));
    rclpy.ask(json!({"do": "client", "service": "/stand_up", "type": TYPE}));
    for topic in [OURS, THEIRS] {
        rclpy.ask(json!({"do": "subscribe", "topic": topic, "type": format!("{TYPE}_Event")}));
    }
    assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": "/stand_up"})), true);
    wait_until("the light is found", || status.services()[1].is_matched);
    let is_matched = |rclpy: &mut Peer, topic: &str| {
        rclpy.ask(json!({"do": "publishers_of", "topic": topic})) != json!([])
    };
    wait_until("events are heard", || is_matched(&mut rclpy, OURS));
    assert!(!is_matched(&mut rclpy, THEIRS), "calls publish no events");
    let calls = Cell::new(0);
    let call = |rclpy: &mut Peer| {
        let answer = rclpy.ask(json!({"do": "call", "service": "/stand_up", "requests": [{"data": true}]}));
        assert_eq!(answer, json!([{"success": true, "message": "standing"}]));
        calls.set(calls.get() + 1);
    };
    call_until_heard(&mut rclpy, OURS, call);
    call(&mut rclpy);
    let none = json!([]);
    assert_eq!(
        events_of(&mut rclpy, OURS, calls.get()),
        [(json!(1), none.clone(), none.clone()), (json!(2), none.clone(), none.clone())]
    );

    set(ServiceIntrospection::OF_SERVICES, "contents").unwrap();
    // The setting takes effect in a cycle after that which accepts it.
    wait_until("contents are published", || {
        call(&mut rclpy);
        events_of(&mut rclpy, OURS, calls.get())[0].1 != none
    });
    call(&mut rclpy);
    let (request, response) = (json!([{"data": true}]), json!([{"success": true, "message": "standing"}]));
    assert_eq!(
        events_of(&mut rclpy, OURS, calls.get()),
        [(json!(1), request, none.clone()), (json!(2), none.clone(), response)]
    );

    set(ServiceIntrospection::OF_CLIENTS, "contents").unwrap();
    wait_until("calls publish events", || is_matched(&mut rclpy, THEIRS));
    let calls_of_light = Cell::new(0);
    let call_light = |_: &mut Peer| {
        ask.publish(true).unwrap();
        answers.recv_timeout(WATCHDOG).unwrap();
        calls_of_light.set(calls_of_light.get() + 1);
    };
    call_until_heard(&mut rclpy, THEIRS, call_light);
    call_light(&mut rclpy);
    let response = json!([{"success": true, "message": "data is True"}]);
    assert_eq!(
        events_of(&mut rclpy, THEIRS, calls_of_light.get()),
        [(json!(0), json!([{"data": true}]), none.clone()), (json!(3), none.clone(), response)]
    );

    let refused = set(ServiceIntrospection::OF_CLIENTS, "loud").unwrap_err().to_string();
    assert!(refused.contains("\"loud\" is none of"), "{refused}");
    set(ServiceIntrospection::OF_SERVICES, "disabled").unwrap();
    wait_until("the publisher has left its node", || {
        let published = rclpy.ask(json!({"do": "published_by", "node": "robot"}));
        published.get(OURS).is_none() && published.get(THEIRS).is_some()
    });
    rclpy.ask(json!({"do": "take", "topic": OURS}));
    call(&mut rclpy);
    assert_eq!(rclpy.ask(json!({"do": "take", "topic": OURS})), none, "off is off");
    handle.stop();
    thread.join().unwrap();
}
