//! Every request has a response, whatever the module does that serves it.
#![allow(clippy::unwrap_used)]

mod common;

use common::rclpy::Peer;
use common::{RunningCore, WATCHDOG, on_loopback, wait_until};
use downbeat_actions::{ActionServer, GoalStatus};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{
    ActionExposure, OfferedService, ServiceExposure, ServicesStatus, expose, expose_services,
};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{Client, Node, NodeName, Participant, ServiceType};
use downbeat_executor::{
    Clock, Core, CoreHandle, Module, ModuleOptions, Restart, Setup, SetupError, Time, Transition,
};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_srvs::srv::{
    Empty, EmptyRequest, EmptyResponse, SetBool, SetBoolRequest, SetBoolResponse, TriggerRequest,
    TriggerResponse,
};
use downbeat_msgs::test_msgs::action::Fibonacci;
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;
use test_machine::free_domain;

const FIBONACCI: &str = "test_msgs/action/Fibonacci";
const SET_BOOL: &str = "std_srvs/srv/SetBool";

/// The order of a goal whose cancel request ends the module.
const PANICS_AT_CANCEL: i32 = 7;

/// Refuses, panics, or keeps what it is asked for without an answer.
struct Unreliable {
    count: ActionServer<Fibonacci>,
    /// Hears of each request without an answer.
    open: Sender<()>,
}

impl Module for Unreliable {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.serve::<SetBoolRequest, SetBoolResponse, _>("light", |_, request, _| match request.data {
            true => panic!("a handler that panics, as this test wants it"),
            false => Err("the lamp is broken".into()),
        })?;
        setup.serve::<EmptyRequest, EmptyResponse, _>("reset", |_, _, _| Err("it moves".into()))?;
        for silent in ["late", "never"] {
            setup.serve_later::<TriggerRequest, TriggerResponse, _>(
                silent,
                |module: &mut Self, _, responder, _| {
                    drop(responder);
                    // The test may have stopped listening.
                    let _ = module.open.send(());
                },
            )?;
        }
        ActionServer::builder(|module: &mut Self| &mut module.count)
            .on_goal(|_, _, goal, _| match goal.order {
                ..0 => panic!("a goal handler that panics, as this test wants it"),
                _ => downbeat_actions::GoalResponse::AcceptAndExecute,
            })
            .on_cancel(|module, id, _| match module.count.goal(id).map(|goal| goal.goal().order) {
                Some(PANICS_AT_CANCEL) => panic!("a cancel handler that panics, as this test wants it"),
                _ => downbeat_actions::CancelResponse::Reject,
            })
            .declare(setup, "count", &mut self.count)
    }
}

fn offered(service: &str, service_type: &str, timeout: Duration) -> ServiceExposure {
    ServiceExposure {
        service: service.into(),
        ros_service: Some(format!("/{service}")),
        service_type: Interfaces::carried().service(service_type).unwrap(),
        timeout,
        network: None,
    }
}

struct Running {
    _core: RunningCore,
    handle: CoreHandle,
    status: ServicesStatus,
    open: Receiver<()>,
}

fn run(node: &Node) -> Running {
    run_on(node, Core::new())
}

fn run_on(node: &Node, mut core: Core) -> Running {
    let restart = Restart::Always { backoff: Duration::from_millis(1) };
    let options = ModuleOptions { restart, ..ModuleOptions::default() };
    let (sender, open) = channel();
    let make = move || Unreliable { count: ActionServer::default(), open: sender.clone() };
    core.add_restartable("robot", make, options).unwrap();
    let action = ActionExposure {
        action: "count".into(),
        ros_action: Some("/count".into()),
        action_type: Interfaces::carried().action(FIBONACCI).unwrap(),
        timeout: WATCHDOG,
        network: None,
    };
    expose(&mut core, node, &action.topics(Direction::Out)).unwrap();
    let mut offers = vec![
        offered("light", SET_BOOL, WATCHDOG),
        offered("reset", "std_srvs/srv/Empty", WATCHDOG),
        offered("late", "std_srvs/srv/Trigger", Duration::from_millis(50)),
        offered("never", "std_srvs/srv/Trigger", Duration::from_secs(100_000)),
    ];
    offers.extend(action.services());
    let status = expose_services(&mut core, node, &offers, &[]).unwrap();
    let handle = core.handle();
    Running { _core: RunningCore::start(core), handle, status, open }
}

fn node(on: &Arc<Hub>, name: &str) -> Node {
    let participant = Participant::on(Arc::new(on.join())).unwrap();
    participant.create_node(NodeName::new("/", name).unwrap()).unwrap()
}

fn is_active(handle: &CoreHandle) -> bool {
    let snapshot = handle.snapshot().wait(WATCHDOG);
    let modules = snapshot.map(|snapshot| snapshot.modules).unwrap_or_default();
    modules.iter().any(|module| module.name == "robot" && module.state.to_string() == "active")
}

fn failed(service: &str) -> String {
    format!(
        "service \"{service}\": module \"robot\" has failed: a handler that panics, as this test wants it"
    )
}

fn gone(service: &str) -> String {
    format!("service \"{service}\": module \"robot\" does not run and cannot answer")
}

#[test]
fn what_a_handler_does_its_client_has_a_response() {
    let hub = Arc::new(Hub::new());
    let robot = node(&hub, "robot");
    let running = run(&robot);
    let script = node(&hub, "script");
    let light: Client<SetBool> = script.client("/light", QosProfile::SERVICES).unwrap();
    assert!(light.wait_for_service(WATCHDOG));
    let ask = |data| light.call_and_wait(&SetBoolRequest { data }, WATCHDOG).unwrap();
    let refused = |message: String| SetBoolResponse { success: false, message };
    assert_eq!(ask(false), refused("the lamp is broken".into()));
    assert_eq!(ask(true), refused(failed("light")));
    wait_until("it has started again", || is_active(&running.handle));
    assert_eq!(ask(false), refused("the lamp is broken".into()));

    let reset: Client<Empty> = script.client("/reset", QosProfile::SERVICES).unwrap();
    assert!(reset.wait_for_service(WATCHDOG));
    assert_eq!(reset.call_and_wait(&EmptyRequest {}, WATCHDOG).unwrap(), EmptyResponse {});
    let late: Client<downbeat_msgs::std_srvs::srv::Trigger> =
        script.client("/late", QosProfile::SERVICES).unwrap();
    assert!(late.wait_for_service(WATCHDOG));
    let answer = late.call_and_wait(&TriggerRequest {}, WATCHDOG).unwrap();
    assert_eq!((answer.success, &*answer.message), (false, "service \"late\": no answer in 50ms"));

    let statuses = running.status.offered();
    let expected = OfferedService {
        service: "/reset".into(),
        network: None,
        type_name: "std_srvs/srv/Empty",
        answered: 0,
        refused: 1,
        last_refusal: Some("service \"reset\": it moves".into()),
    };
    assert_eq!(statuses[1], expected);
}

#[test]
fn a_request_is_answered_when_its_module_is_removed_restarted_or_deactivated_meanwhile() {
    let changes: [fn(&CoreHandle); 3] = [
        |handle| drop(handle.remove("robot")),
        |handle| drop(handle.transition("robot", Transition::Deactivate)),
        |handle| {
            drop(handle.transition("robot", Transition::Deactivate));
            drop(handle.transition("robot", Transition::Activate));
        },
    ];
    for change in changes {
        let hub = Arc::new(Hub::new());
        let robot = node(&hub, "robot");
        let running = run(&robot);
        let script = node(&hub, "script");
        let never: Client<downbeat_msgs::std_srvs::srv::Trigger> =
            script.client("/never", QosProfile::SERVICES).unwrap();
        assert!(never.wait_for_service(WATCHDOG));
        let (sender, answer) = channel();
        never.call(&TriggerRequest {}, WATCHDOG, move |result| sender.send(result).unwrap());
        running.open.recv_timeout(WATCHDOG).unwrap();
        change(&running.handle);
        let answer = answer.recv_timeout(WATCHDOG).unwrap().unwrap();
        assert_eq!((answer.success, answer.message), (false, gone("never")));
    }
}

/// The time of a simulation that is paused.
struct Halted;

impl Clock for Halted {
    fn now(&self) -> Time {
        Time::from_nanos(1_000_000_000)
    }

    fn runs_by_itself(&self) -> bool {
        true
    }
}

#[test]
fn a_request_to_a_core_whose_time_stands_still_has_a_response_in_time() {
    let hub = Arc::new(Hub::new());
    let robot = node(&hub, "robot");
    let running = run_on(&robot, Core::new().with_clock(Halted));
    let script = node(&hub, "script");
    let late: Client<downbeat_msgs::std_srvs::srv::Trigger> =
        script.client("/late", QosProfile::SERVICES).unwrap();
    assert!(late.wait_for_service(WATCHDOG));
    for _ in 0..3 {
        let answer = late.call_and_wait(&TriggerRequest {}, WATCHDOG).unwrap();
        assert_eq!((answer.success, &*answer.message), (false, "service \"late\": no answer in 50ms"));
    }
    assert_eq!(running.status.offered()[2].refused, 3);
}

#[test]
fn bytes_that_are_no_request_are_refused_with_the_reason() {
    let hub = Arc::new(Hub::new());
    let robot = node(&hub, "robot");
    let running = run(&robot);
    let own = robot.serve::<SetBool>("/own", QosProfile::SERVICES, |_| SetBoolResponse::default()).unwrap();
    let script = node(&hub, "script");
    for (service, reason) in
        [("/light", "the bytes are no std_srvs/srv/SetBool"), ("/own", "the request is no")]
    {
        let client =
            script.client_raw(service, &ServiceType::new(SET_BOOL).unwrap(), QosProfile::SERVICES).unwrap();
        wait_until("the service is found", || client.is_available());
        let (sender, answer) = channel();
        // A bool that is neither 0 nor 1.
        let request = bytes::Bytes::from_static(&[0, 1, 0, 0, 7]);
        client.call(request, WATCHDOG, move |result| sender.send(result).unwrap());
        let answer = answer.recv_timeout(WATCHDOG).unwrap().unwrap();
        let answer: SetBoolResponse = downbeat_msgs::cdr::from_slice(&answer).unwrap();
        assert!(!answer.success && answer.message.contains(reason), "{answer:?}");
    }
    drop((running, own));
}

#[test]
fn a_request_that_is_dropped_or_beyond_the_bound_is_refused() {
    let hub = Arc::new(Hub::new());
    let robot = node(&hub, "robot");
    let mut open = Vec::new();
    let (sender, held) = channel();
    let _service = robot
        .serve_later::<SetBool>("/ask", QosProfile::SERVICES, move |request, reply| match request.data {
            true => sender.send(reply).unwrap(),
            false => drop(reply),
        })
        .unwrap();
    let script = node(&hub, "script");
    let clients: [Client<SetBool>; 2] =
        std::array::from_fn(|_| script.client("/ask", QosProfile::SERVICES).unwrap());
    for client in &clients {
        assert!(client.wait_for_service(WATCHDOG));
    }
    let dropped = clients[0].call_and_wait(&SetBoolRequest { data: false }, WATCHDOG).unwrap();
    let expected = SetBoolResponse { success: false, message: "the server has dropped the request".into() };
    assert_eq!(dropped, expected);
    for _ in 0..1024 {
        clients[0].call(&SetBoolRequest { data: true }, WATCHDOG, |_| ());
        open.push(held.recv_timeout(WATCHDOG).unwrap());
    }
    let beyond = clients[1].call_and_wait(&SetBoolRequest { data: true }, WATCHDOG).unwrap();
    assert_eq!((beyond.success, &*beyond.message), (false, "1024 requests are not answered yet"));
}

#[test]
fn rclpy_has_a_response_to_every_request() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let robot = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let running = run(&robot);
    let services =
        [("/light", SET_BOOL), ("/reset", "std_srvs/srv/Empty"), ("/late", "std_srvs/srv/Trigger")];
    for (service, kind) in services {
        rclpy.ask(json!({"do": "client", "service": service, "type": kind}));
        assert_eq!(rclpy.ask(json!({"do": "wait_for_service", "service": service})), true);
    }
    let mut call = |service: &str, request: Value| {
        rclpy.ask(json!({"do": "call", "service": service, "requests": [request]}))
    };
    let refused = |message: &str| json!([{"success": false, "message": message}]);
    assert_eq!(call("/light", json!({"data": false})), refused("the lamp is broken"));
    assert_eq!(call("/light", json!({"data": true})), refused(&failed("light")));
    wait_until("it has started again", || is_active(&running.handle));
    assert_eq!(call("/reset", json!({})), json!([{}]));
    assert_eq!(call("/late", json!({})), refused("service \"late\": no answer in 50ms"));
}

#[test]
fn a_goal_of_rclpy_is_rejected_by_a_panic_and_aborted_by_a_removal() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let robot = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let running = run(&robot);
    rclpy.ask(json!({"do": "action_client", "action": "/count", "type": FIBONACCI}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_action", "action": "/count"})), true);
    let send = |order: i32| json!({"do": "send_goal", "action": "/count", "goal": {"order": order}});
    assert_eq!(rclpy.ask(send(-1)), Value::Null, "it is rejected");
    wait_until("it has started again", || is_active(&running.handle));
    let goal = rclpy.ask(send(3));
    assert_ne!(goal, Value::Null);
    drop(running.handle.remove("robot"));
    for anew in [false, true] {
        let end = rclpy.ask(json!({"do": "result_of", "goal": goal, "anew": anew}));
        assert_eq!(end, json!([GoalStatus::Aborted.to_message(), []]), "asked anew: {anew}");
    }
    assert_eq!(rclpy.ask(json!({"do": "cancel_goal", "goal": goal})), json!([1, []]), "it is refused");
    assert_eq!(rclpy.ask(send(3)), Value::Null, "no module takes goals any more");
}

#[test]
fn a_cancel_request_of_rclpy_is_refused_by_the_module_or_its_panic_and_the_goal_ends() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let robot = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let running = run(&robot);
    rclpy.ask(json!({"do": "action_client", "action": "/count", "type": FIBONACCI}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_action", "action": "/count"})), true);
    let mut send = |order: i32| {
        let goal = rclpy.ask(json!({"do": "send_goal", "action": "/count", "goal": {"order": order}}));
        assert_ne!(goal, Value::Null, "{order} is accepted");
        goal
    };
    let (going_on, last) = (send(3), send(PANICS_AT_CANCEL));
    let mut cancel = |goal: &Value| rclpy.ask(json!({"do": "cancel_goal", "goal": goal}));
    assert_eq!(cancel(&going_on), json!([1, []]), "the module refuses it");
    assert_eq!(cancel(&last), json!([1, []]), "the module panics");
    wait_until("it has started again", || is_active(&running.handle));
    assert_eq!(cancel(&going_on), json!([2, []]), "the module that has started again does not know it");
    // Both goals were lost with the module.
    for goal in [going_on, last] {
        let end = rclpy.ask(json!({"do": "result_of", "goal": goal}));
        assert_eq!(end, json!([GoalStatus::Aborted.to_message(), []]));
    }
}

#[test]
fn cyclone_has_a_response_to_every_request() {
    let domain = free_domain();
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let robot = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let _running = run(&robot);
    cyclone.ask(json!({"do": "client", "service": "/light", "name": "client"}));
    wait_until("Cyclone finds the service", || {
        cyclone.ask(json!({"do": "is_available", "name": "client"})) == true
    });
    let mut call = |data: bool| cyclone.ask(json!({"do": "call", "name": "client", "requests": [data]}));
    assert_eq!(call(false), json!([[[false, "the lamp is broken"]]]));
    assert_eq!(call(true), json!([[[false, failed("light")]]]));
}
