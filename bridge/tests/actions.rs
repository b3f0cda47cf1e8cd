//! Actions of modules used by ROS 2, and actions of ROS 2 used by modules.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{RunningCore, WATCHDOG, on_loopback, wait_until};
use downbeat_actions::{ActionClient, ActionServer, CancelResponse, GoalId, GoalResponse, GoalStatus};
use downbeat_bridge::edge::Interfaces;
use downbeat_bridge::expose::{ActionExposure, ServicesStatus, expose, expose_services};
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::middleware::in_process::Hub;
use downbeat_bridge::ros::{Node, NodeName, Participant};
use downbeat_executor::{Context, Core, Inlet, Module, Received, Setup, SetupError};
use downbeat_msgs::test_msgs::action::{Fibonacci, FibonacciFeedback, FibonacciGoal, FibonacciResult};
use serde_json::{Value, json};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;
use test_machine::free_domain;

const FIBONACCI: &str = "test_msgs/action/Fibonacci";

/// Serves `count`: works on its goals as `work` says, keeps results for 3 s, and holds on to a goal of order
/// 13.
#[derive(Default)]
struct Counter {
    server: ActionServer<Fibonacci>,
}

#[derive(Clone, Copy)]
enum Work {
    Tell,
    Succeed,
    Abort,
}

impl Counter {
    /// What all goals get that are under way.
    fn work(&mut self, work: Received<'_, Work>, ctx: &mut Context<'_>) {
        let goals: Vec<_> =
            self.server.goals().filter(|goal| goal.is_active()).map(|goal| goal.id()).collect();
        for goal in goals {
            let sequence = vec![0, 1, 1, 2];
            match *work {
                Work::Tell => self.server.publish_feedback(ctx, goal, FibonacciFeedback { sequence }),
                Work::Succeed => self.server.succeed(ctx, goal, FibonacciResult { sequence }),
                Work::Abort => self.server.abort(ctx, goal, FibonacciResult { sequence }),
            }
            .unwrap();
        }
    }

    fn stop(&mut self, goal: GoalId, ctx: &mut Context<'_>) {
        self.server.canceled(ctx, goal, FibonacciResult { sequence: vec![-1] }).unwrap();
    }
}

impl Module for Counter {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        ActionServer::builder(|counter: &mut Self| &mut counter.server)
            .on_goal(|_, _, goal, _| match goal.order {
                ..0 => GoalResponse::Reject,
                _ => GoalResponse::AcceptAndExecute,
            })
            .on_cancel(|counter, id, _| match counter.server.goal(id).unwrap().goal().order {
                13 => CancelResponse::Reject,
                _ => CancelResponse::Accept,
            })
            .on_canceling(Self::stop)
            .result_timeout(Duration::from_secs(3))
            .declare(setup, "count", &mut self.server)?;
        setup.subscribe("work", Self::work)
    }
}

/// Uses `far/count` as it is asked on `ask`, and reports the outcome.
struct Caller {
    client: ActionClient<Fibonacci>,
    outcomes: Sender<String>,
    last: GoalId,
}

#[derive(Clone, Copy)]
enum Asked {
    Count(i32),
    Cancel,
}

impl Module for Caller {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        ActionClient::builder(|caller: &mut Self| &mut caller.client)
            .on_response(|caller, _, response, _| {
                caller.report(response.map_or_else(|error| error.to_string(), |_| "accepted".to_owned()));
            })
            .on_feedback(|caller, _, feedback, _| caller.report(format!("{:?}", feedback.sequence)))
            .on_result(|caller, _, end, _| {
                let end = end.unwrap();
                caller.report(format!("{} {:?}", end.status, end.result.sequence));
            })
            .on_cancel(|caller, answer, _| {
                let answer = answer.unwrap();
                caller.report(format!(
                    "cancel {}: {} goals",
                    answer.return_code,
                    answer.goals_canceling.len()
                ));
            })
            .declare(setup, "far/count", &mut self.client)?;
        setup.subscribe("ask", |caller: &mut Self, asked, ctx| match *asked {
            Asked::Count(order) => caller.last = caller.client.send(ctx, FibonacciGoal { order }),
            Asked::Cancel => caller.client.cancel(ctx, caller.last),
        })
    }
}

impl Caller {
    fn report(&self, line: String) {
        self.outcomes.send(line).unwrap();
    }
}

/// A core with both, its action `count` offered as `~/count`, and `/count` of ROS 2 behind `far/count`.
struct Running {
    _core: RunningCore,
    status: ServicesStatus,
    work: Inlet<Work>,
    ask: Inlet<Asked>,
    outcomes: Receiver<String>,
}

fn exposure(action: &str, ros_action: &str) -> ActionExposure {
    ActionExposure {
        action: action.into(),
        ros_action: Some(ros_action.into()),
        action_type: Interfaces::carried().action(FIBONACCI).unwrap(),
        timeout: Duration::from_secs(10),
        network: None,
    }
}

fn run(node: &Node) -> Running {
    let mut core = Core::new();
    let (sender, outcomes) = channel();
    core.add("counter", Counter::default()).unwrap();
    core.add("caller", Caller { client: ActionClient::default(), outcomes: sender, last: GoalId::default() })
        .unwrap();
    let (work, ask) = (core.inlet("work").unwrap(), core.inlet("ask").unwrap());
    let (served, used) = (exposure("count", "~/count"), exposure("far/count", "/count"));
    let topics = [served.topics(Direction::Out), used.topics(Direction::In)].concat();
    expose(&mut core, node, &topics).unwrap();
    let status = expose_services(&mut core, node, &served.services(), &used.services()).unwrap();
    let core = RunningCore::start(core);
    Running { _core: core, status, work, ask, outcomes }
}

impl Running {
    fn line(&self) -> String {
        self.outcomes.recv_timeout(WATCHDOG).unwrap()
    }

    /// Whether all services of the action of ROS 2 are found.
    fn has_found_the_action(&self) -> bool {
        let called = |name: &str| name.starts_with("/count/_action");
        self.status.services().iter().filter(|call| called(&call.service)).all(|call| call.is_matched)
    }
}

fn node(participant: Participant) -> Node {
    participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap()
}

/// A robot on loopback beside a node of rclpy, which has a client of the robot's action.
fn robot_and_rclpy(domain_id: u16) -> Option<(Running, Node, Peer)> {
    let mut rclpy = Peer::start(domain_id, "LOCALHOST")?;
    let node = node(Participant::join(&on_loopback(domain_id)).unwrap());
    let running = run(&node);
    rclpy.ask(json!({"do": "action_client", "action": "/robot/count", "type": FIBONACCI}));
    assert_eq!(rclpy.ask(json!({"do": "wait_for_action", "action": "/robot/count"})), true);
    Some((running, node, rclpy))
}

fn send(rclpy: &mut Peer, order: i32) -> Value {
    rclpy.ask(json!({"do": "send_goal", "action": "/robot/count", "goal": {"order": order}}))
}

fn result_of(rclpy: &mut Peer, goal: &Value) -> (GoalStatus, Value) {
    end(&rclpy.ask(json!({"do": "result_of", "goal": goal})))
}

fn result_asked_anew(rclpy: &mut Peer, goal: &Value) -> (GoalStatus, Value) {
    end(&rclpy.ask(json!({"do": "result_of", "goal": goal, "anew": true})))
}

fn end(answer: &Value) -> (GoalStatus, Value) {
    (GoalStatus::from_message(answer[0].as_i64().unwrap() as i8), answer[1].clone())
}

#[test]
fn a_module_uses_an_action_of_another_node() {
    let hub = Arc::new(Hub::new());
    let join = || Participant::on(Arc::new(hub.join())).unwrap();
    let server = join().create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let mut core = Core::new();
    core.add("counter", Counter::default()).unwrap();
    let work = core.inlet("work").unwrap();
    let served = exposure("count", "/count");
    expose(&mut core, &server, &served.topics(Direction::Out)).unwrap();
    expose_services(&mut core, &server, &served.services(), &[]).unwrap();
    let handle = core.handle();
    let thread = std::thread::spawn(move || core.run().unwrap());

    let running = run(&node(join()));
    running.ask.publish(Asked::Count(5)).unwrap();
    assert_eq!(running.line(), "accepted");
    work.publish(Work::Tell).unwrap();
    assert_eq!(running.line(), "[0, 1, 1, 2]");
    work.publish(Work::Succeed).unwrap();
    assert_eq!(running.line(), "succeeded [0, 1, 1, 2]");
    handle.stop();
    thread.join().unwrap();
}

fn rclpy_lists_the_action(rclpy: &mut Peer) {
    wait_until("the action is listed with its type", || {
        let actions = rclpy.ask(json!({"do": "actions"}));
        actions["/robot/count"] == json!([FIBONACCI]) && actions["/count"] == json!([FIBONACCI])
    });
    let mut of = |servers: bool| {
        rclpy.ask(json!({"do": "actions_of", "node": "robot", "namespace": "/", "servers": servers}))
    };
    wait_until("the node has its server", || of(true) == json!({"/robot/count": [FIBONACCI]}));
    wait_until("the node has its client", || of(false) == json!({"/count": [FIBONACCI]}));
}

#[test]
fn rclpy_lists_the_action_sends_a_goal_hears_of_it_and_has_its_result() {
    let Some((running, _node, mut rclpy)) = robot_and_rclpy(free_domain()) else { return };
    let list = check("Actions", "ros2 action list -t", With::Rclpy, Way::Out);
    let info = check("Actions", "ros2 action info: servers and clients by node", With::Rclpy, Way::Out);
    rclpy_lists_the_action(&mut rclpy);
    drop((list, info));
    let _goal = check("Actions", "goal with feedback and result", With::Rclpy, Way::In);
    let _reject = check("Actions", "goal that is rejected", With::Rclpy, Way::In);
    let _abort = check("Actions", "goal that is aborted", With::Rclpy, Way::In);
    let goal = send(&mut rclpy, 3);
    running.work.publish(Work::Tell).unwrap();
    wait_until("rclpy has the feedback", || {
        rclpy.ask(json!({"do": "feedback_to", "goal": goal})) == json!([[0, 1, 1, 2]])
    });
    running.work.publish(Work::Succeed).unwrap();
    assert_eq!(result_of(&mut rclpy, &goal), (GoalStatus::Succeeded, json!([0, 1, 1, 2])));
    wait_until("rclpy has the status at the end", || {
        rclpy.ask(json!({"do": "status_of", "goal": goal})) == GoalStatus::Succeeded.to_message()
    });
    assert_eq!(send(&mut rclpy, -1), Value::Null, "it is rejected");
    let goal = send(&mut rclpy, 3);
    running.work.publish(Work::Abort).unwrap();
    assert_eq!(result_of(&mut rclpy, &goal).0, GoalStatus::Aborted);
}

#[test]
fn rclpy_cancels_goals_unless_the_module_holds_on() {
    let Some((running, _node, mut rclpy)) = robot_and_rclpy(free_domain()) else { return };
    let _check =
        check("Actions", "cancel: accepted, refused, of a goal that has ended", With::Rclpy, Way::In);
    let (goal, held) = (send(&mut rclpy, 3), send(&mut rclpy, 13));
    let mut cancel = |goal: &Value| rclpy.ask(json!({"do": "cancel_goal", "goal": goal}));
    assert_eq!(cancel(&goal), json!([0, [goal]]));
    assert_eq!(cancel(&goal), json!([3, []]), "it has ended");
    assert_eq!(cancel(&held), json!([1, []]), "it is refused");
    assert_eq!(result_of(&mut rclpy, &goal), (GoalStatus::Canceled, json!([-1])));
    running.work.publish(Work::Succeed).unwrap();
    assert_eq!(result_of(&mut rclpy, &held).0, GoalStatus::Succeeded);
}

#[test]
fn results_are_there_for_those_that_ask_late_until_they_expire() {
    let Some((running, _node, mut rclpy)) = robot_and_rclpy(free_domain()) else { return };
    let _late = check("Actions", "result requested after the end", With::Rclpy, Way::In);
    let _expired = check("Actions", "result that has expired", With::Rclpy, Way::In);
    let _twice = check("Actions", "goal id that is already in use", With::Rclpy, Way::In);
    let goal = send(&mut rclpy, 3);
    let again = json!({"do": "send_goal", "action": "/robot/count", "goal": {"order": 3}, "id": goal});
    running.work.publish(Work::Succeed).unwrap();
    assert_eq!(result_of(&mut rclpy, &goal).0, GoalStatus::Succeeded);
    assert_eq!(result_asked_anew(&mut rclpy, &goal), (GoalStatus::Succeeded, json!([0, 1, 1, 2])));
    assert_eq!(rclpy.ask(again.clone()), Value::Null, "the id is taken");
    wait_until("the result has expired", || {
        result_asked_anew(&mut rclpy, &goal) == (GoalStatus::Unknown, json!([]))
    });
    assert_eq!(rclpy.ask(again), goal, "the id is free again");
}

#[test]
fn two_clients_have_goals_at_once_and_statuses_are_there_for_who_comes_late() {
    let domain = free_domain();
    let Some((running, _node, mut rclpy)) = robot_and_rclpy(domain) else { return };
    let _two = check("Actions", "two clients with goals at the same time", With::Rclpy, Way::In);
    let _status = check("Actions", "status for late joiners", With::Rclpy, Way::Out);
    let mut other = Peer::start(domain, "LOCALHOST").unwrap();
    other.ask(json!({"do": "action_client", "action": "/robot/count", "type": FIBONACCI}));
    assert_eq!(other.ask(json!({"do": "wait_for_action", "action": "/robot/count"})), true);
    let (goal, others) = (send(&mut rclpy, 3), send(&mut other, 4));
    assert_ne!(goal, others);

    let status = "/robot/count/_action/status";
    let latched = json!({"depth": 1, "durability": "transient_local"});
    other.ask(json!({"do": "subscribe", "topic": status, "type": "action_msgs/msg/GoalStatusArray", "qos": latched}));
    let list = other.take(status, 1)[0]["fields"]["status_list"].clone();
    assert_eq!(list.as_array().unwrap().len(), 2, "{list}");
    assert!(list.as_array().unwrap().iter().all(|goal| goal["status"] == 2), "{list}");

    running.work.publish(Work::Tell).unwrap();
    for (peer, goal) in [(&mut rclpy, &goal), (&mut other, &others)] {
        wait_until("each hears of its goal, once", || {
            peer.ask(json!({"do": "feedback_to", "goal": goal})) == json!([[0, 1, 1, 2]])
        });
    }
    running.work.publish(Work::Succeed).unwrap();
    assert_eq!(result_of(&mut rclpy, &goal).0, GoalStatus::Succeeded);
    assert_eq!(result_of(&mut other, &others).0, GoalStatus::Succeeded);
}

/// Has the module send a goal; returns its id when rclpy works on it.
fn begin(running: &Running, rclpy: &mut Peer, order: i32) -> Value {
    running.ask.publish(Asked::Count(order)).unwrap();
    assert_eq!(running.line(), "accepted");
    let mut goal = Value::Null;
    wait_until("rclpy works on it", || {
        goal = rclpy.ask(json!({"do": "working_on"}))[0].clone();
        goal != Value::Null
    });
    assert_eq!((&goal[1], &goal[2]), (&json!(order), &json!(false)));
    goal[0].clone()
}

#[test]
fn a_module_uses_an_action_of_rclpy() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _goal = check("Actions", "goal with feedback and result", With::Rclpy, Way::Out);
    let _cancel =
        check("Actions", "cancel: accepted, refused, of a goal that has ended", With::Rclpy, Way::Out);
    let _reject = check("Actions", "goal that is rejected", With::Rclpy, Way::Out);
    rclpy.ask(json!({"do": "action_server", "action": "/count", "type": FIBONACCI}));
    let running = run(&node(Participant::join(&on_loopback(domain)).unwrap()));
    wait_until("the action is found", || running.has_found_the_action());
    running.ask.publish(Asked::Count(-1)).unwrap();
    let line = running.line();
    assert!(line.ends_with("was rejected"), "{line}");

    let goal = begin(&running, &mut rclpy, 3);
    rclpy.ask(json!({"do": "tell", "goal": goal, "sequence": [0, 1]}));
    assert_eq!(running.line(), "[0, 1]");
    rclpy.ask(json!({"do": "end", "goal": goal, "how": "succeed", "sequence": [0, 1, 1]}));
    assert_eq!(running.line(), "succeeded [0, 1, 1]");
    running.ask.publish(Asked::Cancel).unwrap();
    assert_eq!(running.line(), "cancel 3: 0 goals");

    let goal = begin(&running, &mut rclpy, 4);
    running.ask.publish(Asked::Cancel).unwrap();
    assert_eq!(running.line(), "cancel 0: 1 goals");
    rclpy.ask(json!({"do": "end", "goal": goal, "how": "canceled", "sequence": [7]}));
    assert_eq!(running.line(), "canceled [7]");
    let goal = begin(&running, &mut rclpy, 13);
    running.ask.publish(Asked::Cancel).unwrap();
    // rclpy leaves the return code at 0 where its callback refuses.
    assert_eq!(running.line(), "cancel 0: 0 goals");
    rclpy.ask(json!({"do": "end", "goal": goal, "how": "abort", "sequence": []}));
    assert_eq!(running.line(), "aborted []");
}
