//! Robots that are commanded while they are recorded, by services, actions, transitions and results of jobs,
//! from within the process and from ROS 2. They replay bit for bit.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeMap;
use std::future::poll_fn;
use std::path::{Path, PathBuf};
use std::sync::mpsc::channel;
use std::sync::{Arc, Condvar, Mutex};
use std::task::{Poll, Waker};
use std::time::Duration;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{WATCHDOG, open_with_stock_readers, wait_until};
use downbeat::App;
use downbeat::bags::{Reader, Recording, Selection, WriterOptions};
use downbeat::bridge::middleware::{DiscoveryRange, ParticipantOptions};
use downbeat::bridge::ros::{Client, Node, NodeName, Participant};
use downbeat::executor::{
    CallError, Caller, Context, Core, CoreHandle, Job, ManualClock, Module, Publication, Setting, Setup,
    SetupError, TopicInfo, Transition, TransitionError,
};
use downbeat::modules::actions::{ActionServer, GoalId};
use downbeat::msgs::downbeat_interfaces::msg::{ModuleEvent, ModuleSettings};
use downbeat::msgs::lifecycle_msgs::srv::{ChangeState, ChangeStateRequest};
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::rcl_interfaces::msg::{Parameter, ParameterType, ParameterValue};
use downbeat::msgs::rcl_interfaces::srv::{SetParameters, SetParametersRequest};
use downbeat::msgs::std_msgs::msg::{Float64, String as Text};
use downbeat::msgs::std_srvs::srv::{
    SetBool, SetBoolRequest, SetBoolResponse, TriggerRequest, TriggerResponse,
};
use downbeat::msgs::test_msgs::action::{
    Fibonacci, FibonacciFeedback, FibonacciGetResult, FibonacciGetResultRequest, FibonacciGetResultResponse,
    FibonacciGoal, FibonacciResult, FibonacciSendGoal, FibonacciSendGoalRequest, FibonacciSendGoalResponse,
};
use downbeat::msgs::unique_identifier_msgs::msg::UUID;
use downbeat::msgs::{Message, Service, cdr};
use downbeat::playback::{play_into, start_time};
use downbeat::recorder::{WhenFull, record};
use downbeat::replay::{ReplayOptions, ReplayReport, Strictness, replay};
use downbeat::robot::Kind;
use downbeat::running::{PreparedRobot, RecordPlan};
use serde_json::json;
use test_machine::free_domain;

/// Rises on request, and requests a plan each time. Its messages depend on its ticks between requests.
#[derive(Default)]
struct Arm {
    height: f64,
    ticks: f64,
}

#[derive(Clone, Copy)]
struct ArmPorts {
    angle: Publication<Float64>,
}

impl Module for Arm {
    type Ports = ArmPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<ArmPorts, SetupError> {
        let angle = setup.publish("angle")?;
        let plans = setup.publish("plans")?;
        let plan = setup.client::<TriggerRequest, TriggerResponse, _>(
            "plan",
            Duration::from_secs(30),
            move |arm: &mut Self, reply, ctx| {
                arm.height *= 1.01;
                let data = match reply.result {
                    Ok(answer) => answer.message,
                    Err(error) => error.to_string(),
                };
                ctx.publish(plans, Text { data });
            },
        )?;
        setup.serve::<SetBoolRequest, SetBoolResponse, _>("raise", move |arm: &mut Self, request, ctx| {
            if arm.height > 40.0 {
                arm.height = 0.0;
                return Err("too high".to_owned());
            }
            arm.height += if request.data { 1.0 + arm.ticks } else { -0.5 };
            ctx.publish(angle, Float64 { data: arm.height });
            ctx.call(plan, TriggerRequest::default());
            Ok(SetBoolResponse { success: true, message: format!("{}", arm.height) })
        })?;
        setup.every(Duration::from_millis(2), move |arm: &mut Self, ctx| {
            arm.ticks += 0.001;
            ctx.publish(angle, Float64 { data: arm.height * arm.ticks });
        })?;
        Ok(ArmPorts { angle })
    }

    fn deactivate(&mut self, ctx: &mut Context<'_, ArmPorts>) -> Result<(), TransitionError> {
        ctx.publish(ctx.ports.angle, Float64 { data: -self.ticks });
        self.ticks = 0.0;
        Ok(())
    }
}

/// A detached module that makes plans, occasionally requests the arm to rise, and changes its own settings.
#[derive(Default)]
struct Planner {
    runs: u32,
    plans: u32,
}

impl Module for Planner {
    type Ports = Publication<Text>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Publication<Text>, SetupError> {
        let said = setup.publish("said")?;
        let gain: Setting<i64> = setup.setting("gain", 0_i64, "changed by the module itself")?;
        let raise = setup.client::<SetBoolRequest, SetBoolResponse, _>(
            "raise",
            Duration::from_secs(30),
            move |planner: &mut Self, reply, ctx| {
                let (runs, gain) = (planner.runs, *ctx.get(gain));
                let data = reply.result.map_or_else(|error| error.to_string(), |answer| answer.message);
                ctx.publish(said, Text { data: format!("{data} in run {runs} with {gain}") });
            },
        )?;
        setup.serve::<TriggerRequest, TriggerResponse, _>("plan", |planner: &mut Self, _, _| {
            planner.plans += 1;
            let message = format!("plan {} of run {}", planner.plans, planner.runs);
            Ok(TriggerResponse { success: true, message })
        })?;
        setup.every(Duration::from_millis(3), move |planner: &mut Self, ctx| {
            planner.runs += 1;
            if planner.runs.is_multiple_of(4) {
                ctx.call(raise, SetBoolRequest { data: true });
            }
            if planner.runs.is_multiple_of(5) {
                ctx.set("planner", "gain", i64::from(planner.runs));
            }
            let data = format!("run {} with {}", planner.runs, ctx.get(gain));
            ctx.publish(said, Text { data });
        })?;
        Ok(said)
    }
}

/// Blocks the work of a job.
#[derive(Default)]
struct Gate {
    is_open: Mutex<bool>,
    opened: Condvar,
    waker: Mutex<Option<Waker>>,
}

impl Gate {
    fn open(&self) {
        *self.is_open.lock().unwrap() = true;
        self.opened.notify_all();
        if let Some(waker) = self.waker.lock().unwrap().take() {
            waker.wake();
        }
    }

    fn wait(&self) {
        drop(self.opened.wait_while(self.is_open.lock().unwrap(), |is_open| !*is_open).unwrap());
    }

    async fn pass(&self) {
        poll_fn(|context| {
            *self.waker.lock().unwrap() = Some(context.waker().clone());
            if *self.is_open.lock().unwrap() { Poll::Ready(()) } else { Poll::Pending }
        })
        .await;
    }
}

/// A module with jobs that end when their gates open; the last one is async.
struct Worker {
    gates: Arc<[Gate]>,
    jobs: usize,
    ticks: f64,
}

impl Module for Worker {
    type Ports = Job<f64>;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Job<f64>, SetupError> {
        let results = setup.publish("results")?;
        let job = setup.job::<f64, _>(move |worker: &mut Self, result, ctx| {
            ctx.publish(results, Float64 { data: result.unwrap() + worker.ticks });
        });
        setup.serve::<TriggerRequest, TriggerResponse, _>(
            "work",
            |worker: &mut Self, _, ctx: &mut Context<'_, Job<f64>>| {
                let (number, gates) = (worker.jobs, Arc::clone(&worker.gates));
                worker.jobs += 1;
                let result = 1000.0 * f64::from(u32::try_from(number).unwrap());
                if number + 1 < gates.len() {
                    ctx.spawn(*ctx.ports, move || {
                        gates[number].wait();
                        result
                    });
                } else {
                    ctx.spawn_async(*ctx.ports, async move {
                        gates[number].pass().await;
                        result
                    });
                }
                Ok(TriggerResponse::default())
            },
        )?;
        setup.every(Duration::from_millis(2), |worker: &mut Self, _| worker.ticks += 0.5)?;
        Ok(job)
    }
}

/// Serves the action `count`, which counts as many ticks as the order of the goal.
#[derive(Default)]
struct Counter {
    server: ActionServer<Fibonacci>,
    goals: Vec<(GoalId, i32)>,
    ticks: i32,
}

impl Module for Counter {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        ActionServer::builder(|counter: &mut Self| &mut counter.server)
            .on_accepted(|counter, id, _| counter.goals.push((id, 0)))
            .declare(setup, "count", &mut self.server)?;
        setup.every(Duration::from_millis(2), |counter: &mut Self, ctx| {
            counter.ticks += 1;
            for (id, count) in &mut counter.goals {
                *count += 1;
                let wanted = counter.server.goal(*id).unwrap().goal().order;
                if *count < wanted {
                    let feedback = FibonacciFeedback { sequence: vec![*count] };
                    counter.server.publish_feedback(ctx, *id, feedback).unwrap();
                } else if *count == wanted {
                    let result = FibonacciResult { sequence: vec![counter.ticks] };
                    counter.server.succeed(ctx, *id, result).unwrap();
                }
            }
            counter.goals.retain(|(id, _)| counter.server.goal(*id).is_some_and(|goal| goal.is_active()));
        })
    }
}

const ROBOT: &str = "[robot]\nname = \"commanded\"\n\
    [[module]]\nkind = \"arm\"\nname = \"arm\"\n\
    [[module]]\nkind = \"planner\"\nname = \"planner\"\n\
    [[module]]\nkind = \"worker\"\nname = \"worker\"\n\
    [[module]]\nkind = \"counter\"\nname = \"counter\"\n";

fn app(gates: &Arc<[Gate]>) -> App {
    let gates = Arc::clone(gates);
    App::new()
        .kind("arm", "rises", Arm::default)
        .add_kind(Kind::new("planner", "plans", Planner::default).detached())
        .kind("worker", "works", move || Worker { gates: Arc::clone(&gates), jobs: 0, ticks: 0.0 })
        .kind("counter", "counts", Counter::default)
}

/// A recorded robot with what is needed to replay it.
struct Recorded {
    app: App,
    robot: PathBuf,
    bag: PathBuf,
    _folder: tempfile::TempDir,
}

impl Recorded {
    fn replay(&self, modules: &[&str]) -> ReplayReport {
        let file = self.app.robot_file(&self.robot).unwrap();
        let modules = modules.iter().map(|&name| name.to_owned()).collect();
        let options = ReplayOptions { modules, ..ReplayOptions::of(&file) };
        replay(file, &Reader::open(&self.bag).unwrap(), &options).unwrap()
    }

    fn messages<T: Message>(&self, topic: &str) -> Vec<T> {
        let reader = Reader::open(&self.bag).unwrap();
        let messages = reader.messages(Selection::all().topics(reader.topic(topic))).unwrap();
        messages.map(|message| cdr::from_slice(&message.unwrap().data).unwrap()).collect()
    }

    fn events(&self) -> Vec<ModuleEvent> {
        self.messages("/module_events")
    }

    fn commands(&self) -> Vec<String> {
        let commands = self.events().into_iter().filter(|event| event.kind == ModuleEvent::COMMAND);
        commands.map(|event| format!("{} {}", event.command, event.module)).collect()
    }

    fn assert_same(&self, modules: &[&str]) -> BTreeMap<String, u64> {
        let report = self.replay(modules);
        let compared = report.topics.iter().map(|topic| (topic.topic.clone(), topic.compared)).collect();
        report.check(Strictness::EveryTopic).unwrap();
        compared
    }
}

/// Sends commands to a robot.
struct Commander {
    core: CoreHandle,
    raise: Caller<SetBoolRequest, SetBoolResponse>,
    work: Caller<TriggerRequest, TriggerResponse>,
    send_goal: Caller<FibonacciSendGoalRequest, FibonacciSendGoalResponse>,
    get_result: Caller<FibonacciGetResultRequest, FibonacciGetResultResponse>,
    topics: Vec<TopicInfo>,
}

impl Commander {
    fn messages(&self, topic: &str) -> u64 {
        self.topics.iter().find(|info| *info.name == *topic).unwrap().counter.messages()
    }

    fn wait_for(&self, topic: &str, more: u64) {
        let before = self.messages(topic);
        wait_until(topic, || self.messages(topic) >= before + more);
    }
}

fn ask<Q: Send + 'static, R: Send + 'static>(caller: &Caller<Q, R>, request: Q) -> Result<R, CallError> {
    let (sender, answer) = channel();
    caller.call(request, WATCHDOG, move |result| drop(sender.send(result))).unwrap();
    answer.recv_timeout(WATCHDOG).unwrap()
}

fn recorded(gates: &Arc<[Gate]>, command: impl FnOnce(&Commander)) -> Recorded {
    recorded_robot(ROBOT, gates, command)
}

fn recorded_robot(text: &str, gates: &Arc<[Gate]>, command: impl FnOnce(&Commander)) -> Recorded {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = (folder.path().join("robot.toml"), folder.path().join("bag"));
    std::fs::write(&robot, text).unwrap();
    let app = app(gates);
    let mut built = app.robot_file(&robot).unwrap().build(Core::new()).unwrap();
    let core = &mut built.core;
    let recording = start_recording(core, &bag, &app);
    let commander = Commander {
        core: core.handle(),
        raise: core.caller("raise").unwrap(),
        work: core.caller("work").unwrap(),
        send_goal: core.caller("count/_action/send_goal").unwrap(),
        get_result: core.caller("count/_action/get_result").unwrap(),
        topics: core.topics().cloned().collect(),
    };
    std::thread::scope(|scope| {
        let core = scope.spawn(|| built.core.run());
        commander.wait_for("angle", 3);
        command(&commander);
        commander.wait_for("angle", 10);
        commander.core.stop();
        core.join().unwrap().unwrap();
    });
    drop(built);
    recording.finish().unwrap();
    open_with_stock_readers(&bag);
    Recorded { app, robot, bag, _folder: folder }
}

fn start_recording(core: &mut Core, bag: &Path, app: &App) -> Recording {
    let writer = WriterOptions::new().custom_data("robot", "commanded").create(bag).unwrap();
    let recording = Recording::start(writer, Recording::DEFAULT_QUEUE_BYTES).unwrap();
    let topics: Vec<TopicInfo> = core.topics().cloned().collect();
    let interfaces = &app.catalog().unwrap().interfaces;
    record(core, &recording, &topics, WhenFull::Lose, Default::default(), interfaces, |_| {
        QosProfile::DEFAULT
    })
    .unwrap();
    recording
}

fn gates(count: usize) -> Arc<[Gate]> {
    (0..count).map(|_| Gate::default()).collect()
}

/// All modules, each module separately, and pairs.
const SUBSETS: &[&[&str]] =
    &[&[], &["arm"], &["planner"], &["worker"], &["counter"], &["arm", "planner"], &["planner", "worker"]];

#[test]
fn a_robot_with_requests_from_outside_and_from_a_detached_module_repeats() {
    let recorded = recorded(&gates(0), |robot| {
        for number in 0..40 {
            let answer = ask(&robot.raise, SetBoolRequest { data: number % 3 > 0 });
            assert!(answer.is_ok() || number > 10, "{answer:?}");
            robot.wait_for("angle", number % 3);
        }
        robot.wait_for("said", 30);
    });
    let compared = recorded.assert_same(&[]);
    assert!(compared["/raise answers"] >= 40 && compared["/plan answers"] > 20, "{compared:?}");
    assert!(compared["/raise requests of planner"] > 5, "{compared:?}");
    for modules in SUBSETS {
        if !modules.contains(&"counter") && !modules.contains(&"worker") {
            recorded.assert_same(modules);
        }
    }
    assert_eq!(recorded.assert_same(&["planner"]).keys().find(|name| name.contains("raise answers")), None);
}

#[test]
fn a_robot_that_serves_an_action_repeats() {
    let recorded = recorded(&gates(0), |robot| {
        for ticks in [3, 9, 5] {
            let goal_id = UUID { uuid: [u8::try_from(ticks).unwrap(); 16] };
            let goal = FibonacciSendGoalRequest { goal_id, goal: FibonacciGoal { order: ticks } };
            assert!(ask(&robot.send_goal, goal).unwrap().accepted);
            let result = ask(&robot.get_result, FibonacciGetResultRequest { goal_id }).unwrap();
            assert!(result.result.sequence[0] >= ticks);
        }
    });
    for modules in [&[][..], &["counter"]] {
        let compared = recorded.assert_same(modules);
        assert_eq!(compared["/count/_action/send_goal answers"], 3, "{compared:?}");
        assert_eq!(compared["/count/_action/get_result answers"], 3, "{compared:?}");
        assert!(compared["/count/_action/feedback"] > 5, "{compared:?}");
    }
}

#[test]
fn a_robot_whose_modules_make_transitions_and_pause_repeats() {
    let recorded = recorded(&gates(0), |robot| {
        for _ in 0..5 {
            for (module, topic) in [("arm", "said"), ("planner", "angle")] {
                let made = robot.core.transition(module, Transition::Deactivate).wait(WATCHDOG).unwrap();
                made.unwrap();
                robot.wait_for(topic, 3);
                let made = robot.core.transition(module, Transition::Activate).wait(WATCHDOG).unwrap();
                made.unwrap();
                robot.core.pause_module(module).wait(WATCHDOG).unwrap().unwrap();
                robot.wait_for(topic, 2);
                robot.core.resume_module(module).wait(WATCHDOG).unwrap().unwrap();
                robot.wait_for("angle", 2);
                robot.wait_for("said", 2);
            }
        }
    });
    let commands = recorded.commands();
    assert_eq!(commands.len(), 40, "{commands:?}");
    for modules in [&[][..], &["arm"], &["planner"]] {
        recorded.assert_same(modules);
    }
}

#[test]
fn results_of_jobs_join_in_the_recorded_cycles_and_order() {
    let gates = gates(4);
    let recorded = recorded(&gates, |robot| {
        for _ in 0..gates.len() {
            ask(&robot.work, TriggerRequest::default()).unwrap();
        }
        for (before, number) in (0..).zip([2, 0, 3, 1]) {
            robot.wait_for("angle", 3);
            gates[number].open();
            wait_until("the result", || robot.messages("results") > before);
        }
    });
    let results: Vec<_> = recorded
        .events()
        .iter()
        .filter(|event| event.kind == ModuleEvent::RESULT)
        .map(|event| event.number)
        .collect();
    assert_eq!(results, [2, 0, 3, 1]);
    for modules in [&[][..], &["worker"], &["worker", "arm"]] {
        assert_eq!(recorded.assert_same(modules)["/results"], 4);
    }
}

#[test]
fn a_bag_played_into_a_robot_repeats_the_commands() {
    let without_planner = ROBOT.replace("[[module]]\nkind = \"planner\"\nname = \"planner\"\n", "");
    let recorded = recorded_robot(&without_planner, &gates(0), |robot| {
        for number in 0..10 {
            ask(&robot.raise, SetBoolRequest { data: number % 3 > 0 }).unwrap();
            robot.wait_for("angle", number % 3);
        }
        for transition in [Transition::Deactivate, Transition::Activate] {
            robot.core.transition("arm", transition).wait(WATCHDOG).unwrap().unwrap();
        }
    });
    let reader = Reader::open(&recorded.bag).unwrap();
    let clock = ManualClock::new(start_time(&reader).unwrap());
    let file = recorded.app.robot_file(&recorded.robot).unwrap();
    let interfaces = recorded.app.catalog().unwrap().interfaces.clone();
    let mut core = file.build(Core::new().with_clock(clock.clone())).unwrap().core;
    let played = recorded.bag.with_file_name("played");
    let recording = start_recording(&mut core, &played, &recorded.app);
    play_into(&mut core, &clock, &reader, &[], &interfaces).unwrap();
    recording.finish().unwrap();
    let angles: Vec<Float64> = recorded.messages("/angle");
    let played: Vec<Float64> = Recorded { bag: played, ..recorded }.messages("/angle");
    // Messages that are published while the robot stops are not compared.
    let before_the_end = angles.len() - 3;
    assert_eq!(played[..before_the_end], angles[..before_the_end]);
}

const EXPOSED: &str = "[expose]\nservices = [\"raise\"]\nactions = [\"count\"]\nlifecycle = [\"arm\"]\nparameters = [\"planner.*\"]\n";

fn on_loopback(domain_id: u16) -> ParticipantOptions {
    ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain_id) }
}

/// Runs and records the robot with its node in a domain, until `command`, which sends commands from another
/// node, returns.
fn recorded_in_domain(domain: u16, command: impl FnOnce()) -> Recorded {
    let folder = tempfile::tempdir().unwrap();
    let (robot, bag) = (folder.path().join("robot.toml"), folder.path().join("bag"));
    std::fs::write(&robot, format!("{ROBOT}{EXPOSED}")).unwrap();
    let app = app(&gates(0));
    let mut prepared = PreparedRobot::new(app.robot_file(&robot).unwrap()).unwrap();
    prepared.expose(&on_loopback(domain), None).unwrap();
    let plan = RecordPlan::of_robot(&bag, prepared.file(), None);
    prepared.record(plan).unwrap();
    let running = prepared.start().unwrap();
    command();
    running.stop().unwrap();
    open_with_stock_readers(&bag);
    Recorded { app, robot, bag, _folder: folder }
}

/// Checks the commands from ROS 2: five requests, two goals, two transitions and a parameter.
fn assert_commanded_from_ros_2(recorded: &Recorded) {
    assert_eq!(recorded.commands(), ["deactivate arm", "activate arm"]);
    let settings: Vec<ModuleSettings> = recorded.messages("/module_settings");
    let gains = settings.iter().flat_map(|change| &change.settings).map(|gain| gain.value.integer_value);
    assert_eq!(gains.filter(|gain| *gain == -7).count(), 1, "{settings:?}");
    let report = recorded.app.replay(&recorded.robot, &recorded.bag).unwrap();
    let not_compared: Vec<_> = report.not_compared.iter().map(|topic| &*topic.topic).collect();
    let process = ["/bridge/qos_events", "/cycle_messages", "/cycle_times", "/diagnostics"];
    let journals = ["/module_events", "/module_runs", "/module_settings", "/module_steps"];
    // The worker was not called.
    assert_eq!(not_compared, [&process[..], &journals, &["/results"]].concat());
    report.assert_same().unwrap();
    let compared = recorded.assert_same(&[]);
    assert!(compared["/raise answers"] >= 5 && compared["/said"] > 0, "{compared:?}");
    assert_eq!(compared["/count/_action/send_goal answers"], 2, "{compared:?}");
    assert_eq!(compared["/count/_action/get_result answers"], 2, "{compared:?}");
    assert!(compared["/count/_action/feedback"] >= 6, "{compared:?}");
    for modules in [["arm"], ["planner"], ["counter"]] {
        recorded.assert_same(&modules);
    }
}

fn client<S: Service>(node: &Node, service: &str, qos: QosProfile) -> Client<S> {
    let client = node.client(service, qos).unwrap();
    assert!(client.wait_for_service(WATCHDOG), "{service}");
    client
}

#[test]
fn a_robot_that_is_commanded_over_dds_repeats() {
    let domain = free_domain();
    let recorded = recorded_in_domain(domain, || {
        let participant = Participant::join(&on_loopback(domain)).unwrap();
        let node = participant.create_node(NodeName::new("/", "commander").unwrap()).unwrap();
        let raise = client::<SetBool>(&node, "/raise", QosProfile::SERVICES);
        let send_goal = client::<FibonacciSendGoal>(&node, "/count/_action/send_goal", QosProfile::SERVICES);
        let get_result =
            client::<FibonacciGetResult>(&node, "/count/_action/get_result", QosProfile::SERVICES);
        let change_state = client::<ChangeState>(&node, "/arm/change_state", QosProfile::SERVICES);
        let parameters = client::<SetParameters>(&node, "/commanded/set_parameters", QosProfile::PARAMETERS);
        let raise = |data| raise.call_and_wait(&SetBoolRequest { data }, WATCHDOG).unwrap();
        let change_state = |label: &str| {
            let mut request = ChangeStateRequest::default();
            request.transition.label = label.to_owned();
            assert!(change_state.call_and_wait(&request, WATCHDOG).unwrap().success, "{label}");
        };
        for order in [4_u8, 5] {
            let (goal_id, goal) = (UUID { uuid: [order; 16] }, FibonacciGoal { order: order.into() });
            let goal = FibonacciSendGoalRequest { goal_id, goal };
            assert!(send_goal.call_and_wait(&goal, WATCHDOG).unwrap().accepted);
            raise(true);
            let result = FibonacciGetResultRequest { goal_id };
            let result = get_result.call_and_wait(&result, WATCHDOG).unwrap().result;
            assert!(result.sequence[0] >= i32::from(order));
        }
        change_state("deactivate");
        change_state("activate");
        let value = ParameterValue {
            r#type: ParameterType::PARAMETER_INTEGER,
            integer_value: -7,
            ..ParameterValue::default()
        };
        let gain = Parameter { name: "planner.gain".to_owned(), value };
        let set = SetParametersRequest { parameters: vec![gain] };
        let set = parameters.call_and_wait(&set, WATCHDOG).unwrap();
        assert!(set.results[0].successful, "{set:?}");
        for _ in 0..3 {
            raise(false);
        }
    });
    assert_commanded_from_ros_2(&recorded);
}

#[test]
fn a_robot_that_is_commanded_by_rclpy_repeats() {
    let domain = free_domain();
    let Some(mut peer) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Bags", "replay of a robot that received commands", With::Rclpy, Way::In);
    let call = |peer: &mut Peer, service: &str, requests: serde_json::Value| {
        let answers = peer.ask(json!({"do": "call", "service": service, "requests": requests}));
        for answer in answers.as_array().unwrap() {
            assert_eq!(answer["success"], true, "{service}: {answer}");
        }
    };
    let recorded = recorded_in_domain(domain, || {
        let services =
            [("/raise", "std_srvs/srv/SetBool"), ("/arm/change_state", "lifecycle_msgs/srv/ChangeState")];
        for (service, type_name) in services {
            peer.ask(json!({"do": "client", "service": service, "type": type_name}));
            assert_eq!(peer.ask(json!({"do": "wait_for_service", "service": service})), true);
        }
        peer.ask(json!({"do": "action_client", "action": "/count", "type": "test_msgs/action/Fibonacci"}));
        assert_eq!(peer.ask(json!({"do": "wait_for_action", "action": "/count"})), true);
        call(&mut peer, "/raise", json!([{"data": true}, {"data": true}]));
        for label in ["deactivate", "activate"] {
            call(&mut peer, "/arm/change_state", json!([{"transition": {"label": label}}]));
        }
        call(&mut peer, "/raise", json!([{"data": false}, {"data": false}, {"data": false}]));
        for order in [4, 5] {
            let goal = peer.ask(json!({"do": "send_goal", "action": "/count", "goal": {"order": order}}));
            let result = peer.ask(json!({"do": "result_of", "goal": goal}));
            assert_eq!(result[0], 4, "succeeded: {result}");
        }
        let gain = json!({"do": "parameters", "node": "/commanded", "call": "set_parameters", "argument": {"planner.gain": -7}});
        let set = peer.ask(gain);
        assert_eq!(set["results"][0]["successful"], true, "{set}");
        call(&mut peer, "/raise", json!([{"data": true}]));
    });
    peer.leave();
    assert_commanded_from_ros_2(&recorded);
}

#[test]
fn a_different_response_is_reported_with_its_service_and_field() {
    let recorded = recorded(&gates(0), |robot| {
        (0..5).for_each(|_| drop(ask(&robot.raise, SetBoolRequest { data: true }).unwrap()));
    });
    let reader = Reader::open(&recorded.bag).unwrap();
    let altered = recorded.bag.with_file_name("altered");
    let mut writer = WriterOptions::new().custom_data("robot", "commanded").create(&altered).unwrap();
    let topics: Vec<_> =
        reader.topics().iter().map(|topic| writer.add_topic(topic.info.clone()).unwrap()).collect();
    let mut is_altered = false;
    for message in reader.messages(Selection::all()).unwrap() {
        let message = message.unwrap();
        let mut data = message.data.to_vec();
        if Some(message.topic) == reader.topic("/module_events") {
            let mut event: ModuleEvent = cdr::from_slice(&data).unwrap();
            if event.kind == ModuleEvent::ANSWER && event.service == "raise" && !is_altered {
                let answer: SetBoolResponse = cdr::from_slice(&event.data).unwrap();
                event.data = cdr::to_vec(&SetBoolResponse { message: "another".to_owned(), ..answer });
                is_altered = true;
                data = cdr::to_vec(&event);
            }
        }
        let id = topics[message.topic.index()];
        writer.write(id, message.log_time, message.publish_time, &data).unwrap();
    }
    writer.finish().unwrap();
    let report = Recorded { bag: altered, ..recorded }.replay(&["arm"]);
    let printed = format!("{:?}", report.assert_same().unwrap_err());
    for expected in
        ["1 messages on 1 topics", "/raise answers message 0", "  message\n    recorded \"another\""]
    {
        assert!(printed.contains(expected), "{expected:?} in {printed}");
    }
}
