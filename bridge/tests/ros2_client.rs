//! The crate `ros2-client`, the other ROS 2 client in Rust, as a peer: topics, services, parameters and
//! actions both ways.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::{WATCHDOG, on_loopback, wait_until};
use downbeat_actions::{ActionClient, ActionServer, GoalId, GoalResponse};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{
    ActionExposure, ParameterExposure, ParameterServer, TopicPattern, expose, expose_services,
};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::ros::{Client, MessageType, Node, NodeName, Participant};
use downbeat_executor::{Core, Module, Received, Setup, SetupError};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::srv::{GetParameters, GetParametersRequest};
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use downbeat_msgs::test_msgs::action::{Fibonacci, FibonacciFeedback, FibonacciGoal, FibonacciResult};
use futures_lite::future::{block_on, poll_fn};
use ros2_client::action::{
    ActionClientQosPolicies, ActionServerQosPolicies, AsyncActionServer, GoalEndStatus,
};
use ros2_client::qos::{Durability, History, WhenFull};
use ros2_client::rcl_interfaces::{
    GetParametersRequest as TheirGetParametersRequest, GetParametersResponse as TheirGetParametersResponse,
};
use ros2_client::{ActionTypeName, MessageTypeName, Name, ParameterValue, ServiceMapping, ServiceTypeName};
use serde::{Deserialize, Serialize};
use std::net::Ipv4Addr;
use std::sync::mpsc::{Sender, channel};
use std::task::Poll;
use std::time::{Duration, Instant};
use test_machine::free_domain;

/// A node `/peer` of ros2-client, and the thread that spins it.
struct Peer {
    node: ros2_client::Node,
    spinning: Option<std::thread::JoinHandle<()>>,
}

impl Peer {
    fn start(domain_id: u16) -> Self {
        let participant = rustdds::DomainParticipantBuilder::new(domain_id)
            .with_only_networks([Ipv4Addr::LOCALHOST])
            .build()
            .unwrap();
        let context = ros2_client::Context::from_domain_participant(participant).unwrap();
        let options = ros2_client::NodeOptions::new().declare_parameter("gain", ParameterValue::Double(2.5));
        let mut node = context.new_node(ros2_client::NodeName::new("/", "peer").unwrap(), options).unwrap();
        let spinner = node.spinner().unwrap();
        let spinning = Some(std::thread::spawn(move || block_on(spinner.spin()).unwrap()));
        Self { node, spinning }
    }
}

impl Drop for Peer {
    fn drop(&mut self) {
        self.node.stop_spinner();
        if let Some(spinning) = self.spinning.take() {
            // A panic in it has failed the test already.
            let _ = spinning.join();
        }
    }
}

/// The result of `work`, which is given up after the watchdog's time.
fn within_watchdog<T>(work: impl Future<Output = T>) -> T {
    let start = Instant::now();
    let mut work = std::pin::pin!(work);
    block_on(poll_fn(|context| match work.as_mut().poll(context) {
        Poll::Pending => {
            assert!(start.elapsed() < WATCHDOG, "gave up waiting for ros2-client");
            // Looked at again soon, whatever wakes it: nothing here has a timer.
            std::thread::sleep(Duration::from_millis(1));
            context.waker().wake_by_ref();
            Poll::Pending
        }
        ready => ready,
    }))
}

fn their_qos() -> ros2_client::QosProfile {
    ros2_client::QosProfile::publisher_default()
        .reliability_reliable(WhenFull::DEFAULT)
        .durability(Durability::Volatile)
        .history(History::KeepLast { depth: 10 })
}

fn their_name(name: &str) -> Name {
    Name::new("/", name).unwrap()
}

fn downbeat(domain_id: u16) -> (Participant, Node) {
    let participant = Participant::join(&on_loopback(domain_id)).unwrap();
    let node = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    (participant, node)
}

#[test]
fn topics_go_both_ways() {
    let domain = free_domain();
    let _out = check("Topics", "messages", With::Ros2Client, Way::Out);
    let _in = check("Topics", "messages", With::Ros2Client, Way::In);
    let (_participant, node) = downbeat(domain);
    let mut peer = Peer::start(domain);
    let text = MessageType::new("std_msgs/msg/String").unwrap();
    let to_peer = node.publish("/to_peer", &text, QosProfile::DEFAULT).unwrap();
    let (sender, heard) = channel();
    let on_sample = Box::new(move |sample: downbeat_bridge::middleware::Sample| {
        // The test may have stopped listening.
        let _ = sender.send(cdr::from_slice::<Text>(&sample.cdr).unwrap().data);
    });
    let _from_peer = node.subscribe("/from_peer", &text, QosProfile::DEFAULT, on_sample).unwrap();

    let topic = |name: &str| {
        peer.node.create_topic(&their_name(name), MessageTypeName::new("std_msgs", "String"), &their_qos())
    };
    let (to, from) = (topic("to_peer").unwrap(), topic("from_peer").unwrap());
    let subscription = peer.node.create_subscription::<String>(&to, None).unwrap();
    let publisher = peer.node.create_publisher::<String>(&from, None).unwrap();
    wait_until("we have found the subscription", || to_peer.matched_subscriptions() == 1);
    within_watchdog(publisher.wait_for_subscription(&peer.node));

    for number in 0..20 {
        to_peer.publish(cdr::to_vec(&Text { data: number.to_string() }).into()).unwrap();
        publisher.publish(number.to_string()).unwrap();
    }
    for number in 0..20 {
        assert_eq!(within_watchdog(subscription.async_take()).unwrap().0, number.to_string());
        assert_eq!(heard.recv_timeout(WATCHDOG).unwrap(), number.to_string());
    }
}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct TheirSetBoolRequest {
    data: bool,
}
impl ros2_client::Message for TheirSetBoolRequest {}

#[derive(Clone, Debug, Serialize, Deserialize)]
struct TheirSetBoolResponse {
    success: bool,
    message: String,
}
impl ros2_client::Message for TheirSetBoolResponse {}

/// Longer than a datagram of a local network.
const LONG: usize = 20_000;

#[test]
fn services_go_both_ways_with_long_answers() {
    let domain = free_domain();
    let _out = check("Services", "calls", With::Ros2Client, Way::Out);
    let _in = check("Services", "calls", With::Ros2Client, Way::In);
    let (_participant, node) = downbeat(domain);
    let mut peer = Peer::start(domain);
    let answer =
        |request: SetBoolRequest| SetBoolResponse { success: request.data, message: "x".repeat(LONG) };
    let _service = node.serve::<SetBool>("/ours", QosProfile::SERVICES, answer).unwrap();
    let ours: Client<SetBool> = node.client("/theirs", QosProfile::SERVICES).unwrap();

    let kind = ServiceTypeName::new("std_srvs", "SetBool");
    let theirs = peer
        .node
        .create_client::<TheirSetBoolRequest, TheirSetBoolResponse>(
            ServiceMapping::Enhanced,
            &their_name("ours"),
            &kind,
            their_qos(),
            their_qos(),
        )
        .unwrap();
    within_watchdog(theirs.wait_for_service(&peer.node));
    let answer = within_watchdog(theirs.async_call_service(TheirSetBoolRequest { data: true })).unwrap();
    assert!(answer.success && answer.message.len() == LONG);

    let server = peer
        .node
        .create_server::<TheirSetBoolRequest, TheirSetBoolResponse>(
            ServiceMapping::Enhanced,
            &their_name("theirs"),
            &kind,
            their_qos(),
            their_qos(),
        )
        .unwrap();
    let serving = std::thread::spawn(move || {
        within_watchdog(async {
            let (id, request) = server.async_receive_request().await.unwrap();
            let answer = TheirSetBoolResponse { success: !request.data, message: "of theirs".into() };
            server.async_send_response(id, answer).await.unwrap();
        });
        // Dropped later, so that the answer is repaired if it was lost.
        server
    });
    assert!(ours.wait_for_service(WATCHDOG));
    let answer = ours.call_and_wait(&SetBoolRequest { data: false }, WATCHDOG).unwrap();
    assert_eq!(answer, SetBoolResponse { success: true, message: "of theirs".into() });
    serving.join().unwrap();
}

struct Arm;

impl Module for Arm {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.setting("gain", 1.5, "of the joint controller, 1/s")?;
        Ok(())
    }
}

#[test]
fn parameters_go_both_ways() {
    let domain = free_domain();
    let _out = check("Parameters", "get", With::Ros2Client, Way::Out);
    let _in = check("Parameters", "get", With::Ros2Client, Way::In);
    let (_participant, node) = downbeat(domain);
    let mut peer = Peer::start(domain);
    let mut core = Core::new();
    core.add("arm", Arm).unwrap();
    let server = ParameterServer::new(&core, None);
    let settings = vec![TopicPattern::new("arm.*").unwrap()];
    let _parameters = server.serve(&node, ParameterExposure { settings, of_module: None }).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run().unwrap());

    let client = peer
        .node
        .create_client::<TheirGetParametersRequest, TheirGetParametersResponse>(
            ServiceMapping::Enhanced,
            &Name::new("/robot", "get_parameters").unwrap(),
            &ServiceTypeName::new("rcl_interfaces", "GetParameters"),
            their_qos(),
            their_qos(),
        )
        .unwrap();
    within_watchdog(client.wait_for_service(&peer.node));
    let request = TheirGetParametersRequest { names: vec!["arm.gain".to_owned()] };
    let answer = within_watchdog(client.async_call_service(request)).unwrap();
    let values: Vec<_> = answer.values.into_iter().map(ParameterValue::from).collect();
    assert!(matches!(values[..], [ParameterValue::Double(1.5)]), "{values:?}");

    let ours: Client<GetParameters> = node.client("/peer/get_parameters", QosProfile::PARAMETERS).unwrap();
    assert!(ours.wait_for_service(WATCHDOG));
    let answer =
        ours.call_and_wait(&GetParametersRequest { names: vec!["gain".to_owned()] }, WATCHDOG).unwrap();
    assert_eq!(answer.values[0].double_value, 2.5);
    handle.stop();
    running.join().unwrap();
}

/// Serves `count`: each goal succeeds at once, after one feedback. Uses `far/count` for each goal on `ask`.
struct Counter {
    server: ActionServer<Fibonacci>,
    client: ActionClient<Fibonacci>,
    outcomes: Sender<String>,
}

impl Counter {
    fn answer(&mut self, goal: GoalId, ctx: &mut downbeat_executor::Context<'_>) {
        let sequence = vec![0, 1, 1, 2];
        let feedback = FibonacciFeedback { sequence: sequence.clone() };
        self.server.publish_feedback(ctx, goal, feedback).unwrap();
        self.server.succeed(ctx, goal, FibonacciResult { sequence }).unwrap();
    }
}

impl Module for Counter {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        ActionServer::builder(|counter: &mut Self| &mut counter.server)
            .on_goal(|_, _, _, _| GoalResponse::AcceptAndExecute)
            .declare(setup, "count", &mut self.server)?;
        ActionClient::builder(|counter: &mut Self| &mut counter.client)
            .on_result(|counter, _, end, _| {
                let end = end.unwrap();
                counter.outcomes.send(format!("{} {:?}", end.status, end.result.sequence)).unwrap();
            })
            .declare(setup, "far/count", &mut self.client)?;
        setup.subscribe("work", |counter: &mut Self, _: Received<'_, u8>, ctx| {
            let goals: Vec<_> =
                counter.server.goals().filter(|goal| goal.is_active()).map(|goal| goal.id()).collect();
            goals.into_iter().for_each(|goal| counter.answer(goal, ctx));
        })?;
        setup.subscribe("ask", |counter: &mut Self, order: Received<'_, i32>, ctx| {
            counter.client.send(ctx, FibonacciGoal { order: *order });
        })
    }
}

fn exposure(action: &str, ros_action: &str) -> ActionExposure {
    ActionExposure {
        action: action.into(),
        ros_action: Some(ros_action.into()),
        action_type: Interfaces::carried().action("test_msgs/action/Fibonacci").unwrap(),
        timeout: Duration::from_secs(10),
        network: None,
    }
}

#[test]
fn actions_go_both_ways() {
    let domain = free_domain();
    let _out = check("Actions", "goal and result", With::Ros2Client, Way::Out);
    let _in = check("Actions", "goal, feedback and result", With::Ros2Client, Way::In);
    let (_participant, node) = downbeat(domain);
    let mut peer = Peer::start(domain);
    let (sender, outcomes) = channel();
    let mut core = Core::new();
    let counter =
        Counter { server: ActionServer::default(), client: ActionClient::default(), outcomes: sender };
    core.add("counter", counter).unwrap();
    let (work, ask) = (core.inlet::<u8>("work").unwrap(), core.inlet::<i32>("ask").unwrap());
    let (served, used) = (exposure("count", "/ours"), exposure("far/count", "/theirs"));
    expose(&mut core, &node, &[served.topics(Direction::Out), used.topics(Direction::In)].concat()).unwrap();
    let status = expose_services(&mut core, &node, &served.services(), &used.services()).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run().unwrap());

    let kind = ActionTypeName::new("test_msgs", "Fibonacci");
    let client = peer
        .node
        .create_action_client::<i32, Vec<i32>, Vec<i32>>(
            ServiceMapping::Enhanced,
            &their_name("ours"),
            &kind,
            ActionClientQosPolicies {
                goal_service: their_qos(),
                result_service: their_qos(),
                cancel_service: their_qos(),
                feedback_subscription: their_qos(),
                status_subscription: their_qos(),
            },
        )
        .unwrap();
    within_watchdog(async {
        client.goal_client().wait_for_service(&peer.node).await;
        client.result_client().wait_for_service(&peer.node).await;
    });
    let (goal, response) = within_watchdog(client.async_send_goal(5)).unwrap();
    assert!(response.accepted);
    work.publish(0).unwrap();
    let (_status, result) = within_watchdog(client.async_request_result(goal)).unwrap();
    assert_eq!(result, [0, 1, 1, 2]);
    wait_until("the feedback has come", || client.receive_feedback(goal).unwrap() == Some(vec![0, 1, 1, 2]));

    let latched = their_qos().durability(Durability::TransientLocal);
    let server = peer
        .node
        .create_action_server::<i32, Vec<i32>, Vec<i32>>(
            ServiceMapping::Enhanced,
            &their_name("theirs"),
            &kind,
            ActionServerQosPolicies {
                goal_service: their_qos(),
                result_service: their_qos(),
                cancel_service: their_qos(),
                feedback_publisher: their_qos(),
                status_publisher: latched,
            },
        )
        .unwrap();
    let server = AsyncActionServer::new(server);
    let serving = std::thread::spawn(move || {
        within_watchdog(async {
            let goal = server.receive_new_goal().await.unwrap();
            let order = server.get_new_goal(goal).unwrap();
            let accepted = server.accept_goal(goal).await.unwrap();
            let executing = server.start_executing_goal(accepted).await.unwrap();
            server.send_result_response(executing, GoalEndStatus::Succeeded, vec![order]).await.unwrap();
        });
        server
    });
    wait_until("we have found the action", || {
        status
            .services()
            .iter()
            .filter(|call| call.service.starts_with("/theirs/"))
            .all(|call| call.is_matched)
    });
    ask.publish(7).unwrap();
    assert_eq!(outcomes.recv_timeout(WATCHDOG).unwrap(), "succeeded [7]");
    serving.join().unwrap();
    handle.stop();
    running.join().unwrap();
}
