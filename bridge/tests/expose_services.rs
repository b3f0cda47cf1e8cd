//! Services of a core in ROS 2, and services of ROS 2 in a core.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{RunningCore, WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{ExposeError, ServiceExposure, ServiceReport, ServicesStatus, expose_services};
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{Client, Node, NodeName, Participant};
use downbeat_executor::{Context, Core, Module, Setup, SetupError};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_srvs::srv::{
    Empty, EmptyRequest, EmptyResponse, SetBool, SetBoolRequest, SetBoolResponse,
};
use serde_json::json;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;
use test_machine::free_domain;

/// Stands up when it is asked to and refuses to lie down; asks for light on `ask`, and reports the outcome.
struct Robot {
    answers: Sender<Result<SetBoolResponse, String>>,
}

impl Module for Robot {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.serve::<SetBoolRequest, SetBoolResponse, _>("stand_up", |_, request, _| {
            match request.data {
                true => Ok(SetBoolResponse { success: true, message: "standing".into() }),
                false => Err("I do not lie down".into()),
            }
        })?;
        setup.serve::<EmptyRequest, EmptyResponse, _>("panic", |_, _, _| Err("never".into()))?;
        let timeout = Duration::from_secs(20);
        let light = setup.client::<SetBoolRequest, SetBoolResponse, _>(
            "light",
            timeout,
            |robot: &mut Self, reply, _| {
                robot.answers.send(reply.result.map_err(|error| error.to_string())).unwrap();
            },
        )?;
        setup.subscribe::<bool, _>("ask", move |_: &mut Self, data, ctx: &mut Context<'_>| {
            ctx.call(light, SetBoolRequest { data: *data });
        })
    }
}

fn offered(service: &str, service_type: &str) -> ServiceExposure {
    ServiceExposure {
        service: service.into(),
        ros_service: Some(format!("~/{service}")),
        service_type: Interfaces::carried().service(service_type).unwrap(),
        timeout: Duration::from_secs(5),
        network: None,
    }
}

fn light() -> ServiceExposure {
    ServiceExposure {
        service: "light".into(),
        ros_service: Some("/light".into()),
        service_type: Interfaces::carried().service("std_srvs/srv/SetBool").unwrap(),
        timeout: Duration::from_secs(10),
        network: None,
    }
}

struct Running {
    _core: RunningCore,
    status: ServicesStatus,
    answers: Receiver<Result<SetBoolResponse, String>>,
    ask: downbeat_executor::Inlet<bool>,
}

fn run(node: &Node) -> Running {
    let mut core = Core::new();
    let (sender, answers) = channel();
    core.add("robot", Robot { answers: sender }).unwrap();
    let ask = core.inlet("ask").unwrap();
    let offers = [offered("stand_up", "std_srvs/srv/SetBool"), offered("panic", "std_srvs/srv/Empty")];
    let status = expose_services(&mut core, node, &offers, &[light()]).unwrap();
    let core = RunningCore::start(core);
    Running { _core: core, status, answers, ask }
}

fn node(on: Arc<Hub>, name: &str) -> Node {
    let participant = Participant::on(Arc::new(on.join())).unwrap();
    participant.create_node(NodeName::new("/", name).unwrap()).unwrap()
}

#[test]
fn a_service_of_a_module_answers_clients_and_says_why_it_refuses() {
    let hub = Arc::new(Hub::new());
    let robot = node(Arc::clone(&hub), "robot");
    let running = run(&robot);
    let script = node(hub, "script");
    let client: Client<SetBool> = script.client("/robot/stand_up", QosProfile::SERVICES).unwrap();
    assert!(client.wait_for_service(WATCHDOG));
    let ask = |data| client.call_and_wait(&SetBoolRequest { data }, WATCHDOG).unwrap();
    assert_eq!(ask(true), SetBoolResponse { success: true, message: "standing".into() });
    assert_eq!(ask(false), SetBoolResponse { success: false, message: "I do not lie down".into() });

    let empty: Client<Empty> = script.client("/robot/panic", QosProfile::SERVICES).unwrap();
    let answer = empty.call_and_wait(&EmptyRequest {}, WATCHDOG).unwrap();
    assert_eq!(answer, EmptyResponse {}, "a type that cannot refuse");
    let expected = [("/robot/stand_up", true, 1, 1), ("/robot/panic", true, 0, 1), ("/light", false, 0, 0)];
    wait_until("the calls are counted", || {
        running.status.services()
            == expected.map(|(service, is_matched, answered, failed)| ServiceReport {
                service: service.into(),
                network: None,
                is_matched,
                answered,
                failed,
            })
    });
    drop(running);
    wait_until("the services are gone with the core", || !client.is_available());
}

#[test]
fn a_module_calls_a_service_of_another_node_and_is_told_why_there_is_no_answer() {
    let hub = Arc::new(Hub::new());
    let running = run(&node(Arc::clone(&hub), "robot"));
    running.ask.publish(true).unwrap();
    let error = running.answers.recv_timeout(WATCHDOG).unwrap().unwrap_err();
    assert!(error.contains("/light: no server of another process"), "{error}");
    let lamp = node(hub, "lamp");
    let _service = lamp
        .serve::<SetBool>("light", QosProfile::SERVICES, |request| SetBoolResponse {
            success: request.data,
            message: "light".into(),
        })
        .unwrap();
    for data in [true, false] {
        running.ask.publish(data).unwrap();
        let answer = running.answers.recv_timeout(WATCHDOG).unwrap().unwrap();
        assert_eq!(answer, SetBoolResponse { success: data, message: "light".into() });
    }
}

#[test]
fn a_service_of_another_type_is_refused() {
    let mut core = Core::new();
    core.add("robot", Robot { answers: channel().0 }).unwrap();
    let node = node(Arc::new(Hub::new()), "robot");
    let wrong = offered("stand_up", "std_srvs/srv/Trigger");
    let Err(ExposeError::Setup(error)) = expose_services(&mut core, &node, &[wrong], &[]) else { panic!() };
    assert!(error.to_string().contains("stand_up"), "{error}");
    let known = core.services().find(|service| &*service.name == "stand_up");
    let known = known.and_then(|service| Interfaces::carried().service_of(service));
    assert_eq!(known, Some(Interfaces::carried().service("std_srvs/srv/SetBool").unwrap()));
}

#[test]
fn rclpy_calls_a_module_and_a_module_calls_rclpy() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Services", "service of a module", With::Rclpy, Way::In);
    let _check2 = check("Services", "service called by a module", With::Rclpy, Way::Out);
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let node = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let running = run(&node);
    let (name, kind) = ("/robot/stand_up", "std_srvs/srv/SetBool");
    rclpy.ask(json!({"do": "serve", "service": "/light", "type": kind}));
    rclpy.ask(json!({"do": "client", "service": name, "type": kind}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": name})), true);
    let requests = json!([{"data": true}, {"data": false}]);
    assert_eq!(
        rclpy.ask(json!({"do": "call", "service": name, "requests": requests})),
        json!([
            {"success": true, "message": "standing"},
            {"success": false, "message": "I do not lie down"},
        ])
    );
    wait_until("the light is found", || running.status.services()[2].is_matched);
    running.ask.publish(true).unwrap();
    let answer = running.answers.recv_timeout(WATCHDOG).unwrap().unwrap();
    assert_eq!(answer, SetBoolResponse { success: true, message: "data is True".into() });
}
