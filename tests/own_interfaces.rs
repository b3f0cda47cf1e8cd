//! Messages, services and actions of a user's package have all features of the built-in ones.
#![allow(clippy::unwrap_used)]

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;

use downbeat::App;
use downbeat::bags::{Reader, Recording, Selection, WriterOptions};
use downbeat::bridge::edge::Interfaces;
use downbeat::bridge::expose::{expose, expose_services};
use downbeat::bridge::middleware::Sample;
use downbeat::bridge::middleware::in_process::Hub;
use downbeat::bridge::ros::{MessageType, Node, NodeName, Participant, RemapRules};
use downbeat::encoding::RecordedType;
use downbeat::executor::{
    Client, Context, Core, CoreHandle, Inlet, Module, Publication, Received, Reply, Setup, SetupError,
};
use downbeat::modules::actions::{ActionServer, GoalResponse};
use downbeat::msgs::encoding::Encoding;
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::{Action, Message, cdr};
use downbeat::recorder::{Unrecorded, UnrecordedTopic, WhenFull, record};
use downbeat::replay::ReplayOptions;
use downbeat::running::{PreparedRobot, RecordPlan};
use downbeat::table::Decoder;
use user_msgs::my_msgs::action::{Lean, LeanGoal, LeanResult};
use user_msgs::my_msgs::msg::Tilt;
use user_msgs::my_msgs::srv::{Level, LevelRequest, LevelResponse};
use user_msgs::{OtherBool, Reach};

const WATCHDOG: Duration = Duration::from_secs(60);

/// Leans as requested on `wanted`, and calls `far/level` for help to lean backwards.
#[derive(Default)]
struct Leaner {
    lean: ActionServer<Lean>,
}

#[derive(Clone, Copy)]
struct Ports {
    tilt: Publication<Tilt>,
    reach: Publication<Reach>,
    upright: Publication<OtherBool>,
    /// A plain Rust type.
    count: Publication<u32>,
    help: Client<LevelRequest, LevelResponse>,
}

impl Module for Leaner {
    type Ports = Ports;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Ports, SetupError> {
        setup.subscribe("wanted", Self::wanted)?;
        setup.serve("level", |_: &mut Self, request: &LevelRequest, _: &mut Context<'_, Ports>| {
            Ok(LevelResponse { is_level: request.speed > 0.0, tilt: Tilt::default() })
        })?;
        ActionServer::builder(|leaner: &mut Self| &mut leaner.lean)
            .on_goal(|_, _, _, _| GoalResponse::AcceptAndExecute)
            .on_accepted(|leaner, goal, ctx| {
                let reached = leaner.lean.goal(goal).unwrap().goal().goal.clone();
                leaner.lean.succeed(ctx, goal, LeanResult { reached }).unwrap();
            })
            .declare(setup, "lean", &mut self.lean)?;
        Ok(Ports {
            tilt: setup.publish("tilt")?,
            reach: setup.publish("reach")?,
            upright: setup.publish("upright")?,
            count: setup.publish("count")?,
            help: setup.client("far/level", WATCHDOG, Self::helped)?,
        })
    }
}

impl Leaner {
    fn wanted(&mut self, wanted: Received<'_, Tilt>, ctx: &mut Context<'_, Ports>) {
        ctx.publish(ctx.ports.tilt, (*wanted).clone());
        ctx.publish(ctx.ports.upright, OtherBool { data: wanted.angle == 0.0 });
        ctx.publish(ctx.ports.count, 1);
        if wanted.angle < 0.0 {
            ctx.call(ctx.ports.help, LevelRequest { speed: 2.0 });
        }
    }

    fn helped(&mut self, reply: Reply<LevelResponse>, ctx: &mut Context<'_, Ports>) {
        let distance = reply.result.unwrap().tilt.angle;
        ctx.publish(ctx.ports.reach, Reach { distance, ..Reach::default() });
    }
}

fn app() -> App {
    App::new().interfaces(user_msgs::INTERFACES).interfaces(user_msgs::DERIVED).kind(
        "leaner",
        "leans as requested",
        Leaner::default,
    )
}

const ROBOT: &str = r#"[robot]
name = "leaner"
[[module]]
kind = "leaner"
[expose]
out = ["tilt", "reach", "upright"]
in = [{ topic = "wanted", type = "my_msgs/msg/Tilt" }]
services = ["level"]
calls = [{ service = "far/level", as = "/helper/level", type = "my_msgs/srv/Level" }]
actions = ["lean"]
"#;

fn robot_file(folder: &Path, text: &str) -> PathBuf {
    let path = folder.join("robot.toml");
    std::fs::write(&path, text).unwrap();
    path
}

fn problem(app: &App, text: &str) -> String {
    let folder = tempfile::tempdir().unwrap();
    let file = app.robot_file(robot_file(folder.path(), text));
    let built = file
        .map_err(|error| error.to_string())
        .and_then(|file| file.build(Core::new()).map_err(|error| error.to_string()));
    built.err().unwrap()
}

fn tilt(angle: f64) -> Tilt {
    Tilt { angle, ..Tilt::default() }
}

fn join(hub: &Hub, interfaces: &Interfaces, name: &str) -> Node {
    let participant =
        Participant::on_with(Arc::new(hub.join()), RemapRules::default(), interfaces.clone()).unwrap();
    participant.create_node(NodeName::new("/", name).unwrap()).unwrap()
}

/// The messages of a topic.
fn listen<T: Message>(node: &Node, topic: &str) -> (downbeat::bridge::ros::Subscription, Receiver<T>) {
    let (sender, received) = channel();
    let take = move |sample: Sample| sender.send(cdr::from_slice(&sample.cdr).unwrap()).unwrap();
    let message_type = MessageType::new(T::TYPE_NAME).unwrap();
    (node.subscribe(topic, &message_type, QosProfile::DEFAULT, Box::new(take)).unwrap(), received)
}

struct Running {
    core: CoreHandle,
    wanted: Inlet<Tilt>,
    thread: std::thread::JoinHandle<()>,
    recording: Recording,
}

/// Exposes the robot on `node` and records all its topics into `bag`.
fn run(node: &Node, folder: &Path, bag: &Path, encoding: Encoding) -> Running {
    let mut robot = app().robot_file(robot_file(folder, ROBOT)).unwrap().build(Core::new()).unwrap();
    let exposed = robot.exposed().unwrap();
    let topics = robot.recorded_topics().unwrap();
    let interfaces = robot.file.catalog.interfaces.clone();
    let writer = Unrecorded::of(&topics, &interfaces).note(WriterOptions::new()).create(bag).unwrap();
    let recording = Recording::start(writer, Recording::DEFAULT_QUEUE_BYTES).unwrap();
    let core = &mut robot.core;
    record(core, &recording, &topics, WhenFull::Wait, encoding, &interfaces, |_| QosProfile::DEFAULT)
        .unwrap();
    expose(core, node, &exposed.topics).unwrap();
    expose_services(core, node, &exposed.services, &exposed.calls).unwrap();
    let wanted = core.inlet("wanted").unwrap();
    let (handle, mut core) = (robot.core.handle(), robot.core);
    let thread = std::thread::spawn(move || core.run().unwrap());
    Running { core: handle, wanted, thread, recording }
}

impl Running {
    fn stop(self) {
        self.core.stop();
        self.thread.join().unwrap();
        self.recording.finish().unwrap();
    }
}

#[test]
fn topics_services_and_actions_of_a_users_package_pass_in_both_directions() {
    let (hub, folder) = (Hub::new(), tempfile::tempdir().unwrap());
    let interfaces = app().catalog().unwrap().interfaces.clone();
    let (robot, script) = (join(&hub, &interfaces, "leaner"), join(&hub, &interfaces, "script"));
    let running = run(&robot, folder.path(), &folder.path().join("bag"), Encoding::Cdr);

    // Out and in, with the type hashes of the definitions.
    let (_tilts, tilts) = listen::<Tilt>(&script, "/tilt");
    let (_reaches, reaches) = listen::<Reach>(&script, "/reach");
    let (_uprights, uprights) = listen::<downbeat::msgs::std_msgs::msg::Bool>(&script, "/upright");
    let tilt_type = MessageType::new(Tilt::TYPE_NAME).unwrap();
    let wanted = script.publish("/wanted", &tilt_type, QosProfile::DEFAULT).unwrap();
    wanted.publish(cdr::to_vec(&tilt(0.0)).into()).unwrap();
    assert_eq!(tilts.recv_timeout(WATCHDOG).unwrap(), tilt(0.0));
    assert!(uprights.recv_timeout(WATCHDOG).unwrap().data, "two Rust types of one definition are one type");
    let endpoints = script.participant().remote_endpoints();
    for (topic, hash) in [("tilt", Tilt::TYPE_HASH), ("wanted", Tilt::TYPE_HASH), ("reach", Reach::TYPE_HASH)]
    {
        let endpoint = endpoints.iter().find(|endpoint| endpoint.topic_name == format!("rt/{topic}"));
        assert_eq!(endpoint.unwrap().type_hash.as_deref(), Some(hash), "{topic}");
    }

    // A service of the module, and a service that it calls.
    let level = script.client::<Level>("/level", QosProfile::SERVICES).unwrap();
    assert!(level.wait_for_service(WATCHDOG));
    assert!(level.call_and_wait(&LevelRequest::default(), WATCHDOG).unwrap().is_level);
    let help =
        |request: LevelRequest| LevelResponse { tilt: tilt(request.speed), ..LevelResponse::default() };
    let _helper = script.serve::<Level>("/helper/level", QosProfile::SERVICES, help).unwrap();
    wanted.publish(cdr::to_vec(&tilt(-0.5)).into()).unwrap();
    assert_eq!(reaches.recv_timeout(WATCHDOG).unwrap().distance, 2.0);

    // An action of the module.
    type SendGoal = <Lean as Action>::SendGoal;
    type GetResult = <Lean as Action>::GetResult;
    let send = script.client::<SendGoal>("/lean/_action/send_goal", QosProfile::SERVICES).unwrap();
    let result = script.client::<GetResult>("/lean/_action/get_result", QosProfile::SERVICES).unwrap();
    assert!(send.wait_for_service(WATCHDOG) && result.wait_for_service(WATCHDOG));
    let goal = Lean::send_goal_request(Default::default(), LeanGoal { goal: tilt(0.75) });
    let accepted = send.call_and_wait(&goal, WATCHDOG).unwrap();
    assert!(Lean::acceptance_of(accepted).0);
    let asked = Lean::get_result_request(Default::default());
    let (status, result) = Lean::result_of(result.call_and_wait(&asked, WATCHDOG).unwrap());
    assert_eq!((status, result.reached), (4, tilt(0.75)), "succeeded");

    // The answers of the robot's node about its types.
    let topic = script.topic_name("/tilt").unwrap();
    let described = script.describe(&topic, &tilt_type, WATCHDOG).unwrap();
    assert_eq!(described.hash, Tilt::TYPE_HASH);
    running.stop();
}

#[test]
fn a_recording_has_their_definitions_and_reports_missing_topics_in_any_encoding() {
    let interfaces = app().catalog().unwrap().interfaces.clone();
    for encoding in [Encoding::Cdr, Encoding::Json, Encoding::Protobuf] {
        let (hub, folder) = (Hub::new(), tempfile::tempdir().unwrap());
        let bag = folder.path().join("bag");
        let robot = join(&hub, &interfaces, "leaner");
        let running = run(&robot, folder.path(), &bag, encoding);
        let (_tilts, tilts) = listen::<Tilt>(&join(&hub, &interfaces, "script"), "/tilt");
        running.wanted.publish(tilt(0.125)).unwrap();
        assert_eq!(tilts.recv_timeout(WATCHDOG).unwrap(), tilt(0.125));
        running.stop();

        let reader = Reader::open(&bag).unwrap();
        let topic = &reader.topics()[reader.topic("/tilt").unwrap().index()];
        let info = &topic.info;
        assert_eq!((&*info.type_name, &*info.type_hash), (Tilt::TYPE_NAME, Tilt::TYPE_HASH));
        if encoding == Encoding::Cdr {
            assert_eq!(info.definition, Tilt::DEFINITION);
        }
        let recorded = RecordedType::of(topic, &interfaces).unwrap();
        let decoder = Decoder::of(topic, &interfaces).unwrap();
        let selection = Selection::all().topics([reader.topic("/tilt").unwrap()]);
        let messages: Vec<_> =
            reader.messages(selection).unwrap().map(|message| message.unwrap().data).collect();
        assert_eq!(messages.len(), 1, "{encoding}");
        let message: Tilt = cdr::from_slice(&recorded.to_cdr(messages[0].clone()).unwrap()).unwrap();
        assert_eq!(message, tilt(0.125), "{encoding}");
        let json: serde_json::Value =
            serde_json::from_slice(&decoder.to_json(messages[0].clone()).unwrap()).unwrap();
        assert_eq!(json["angle"], 0.125, "{encoding}");
        let upright = &reader.topics()[reader.topic("/upright").unwrap().index()].info;
        assert_eq!(upright.type_name, "std_msgs/msg/Bool");
        assert_eq!(
            Unrecorded::in_bag(reader.metadata().unwrap()),
            [UnrecordedTopic { topic: "/count".into(), rust_type: "u32".into(), messages: 1 }]
        );
    }
}

#[test]
fn a_robot_with_them_replays() {
    let folder = tempfile::tempdir().unwrap();
    let path = robot_file(
        folder.path(),
        &format!("{}[record]\ntopics = \"all\"\n", &ROBOT[..ROBOT.find("[expose]").unwrap()]),
    );
    let bag = folder.path().join("bag");
    let mut robot = PreparedRobot::new(app().robot_file(&path).unwrap()).unwrap();
    let plan = RecordPlan::of_robot(&bag, robot.file(), None);
    robot.record(plan).unwrap();
    let inlet = robot.core().inlet::<Tilt>("wanted").unwrap();
    let running = robot.start().unwrap();
    for step in 0..3 {
        inlet.publish(tilt(f64::from(step))).unwrap();
    }
    // This request comes after those messages in the queue of the core.
    running.core().topics().wait(WATCHDOG).unwrap();
    running.stop().unwrap();

    let file = app().robot_file(&path).unwrap();
    let reader = Reader::open(&bag).unwrap();
    let report = downbeat::replay::replay(file, &reader, &ReplayOptions::default()).unwrap();
    let tilt = report.topics.iter().find(|topic| topic.topic == "/tilt").unwrap();
    assert_eq!((tilt.compared, tilt.different), (3, 0));
}

#[test]
fn unregistered_types_are_refused_with_the_line_to_add() {
    let unregistered = App::new().kind("leaner", "leans as requested", Leaner::default);
    let robot = "[robot]\nname = \"leaner\"\n[[module]]\nkind = \"leaner\"\n";
    let generated = "add `.interfaces(user_msgs::INTERFACES)` to the app";
    let derived = "add `.interfaces(user_msgs::Reach::INTERFACES)` to the app";
    for (section, what, add) in [
        ("[expose]\nout = [\"tilt\"]\n", "\"tilt\" carries user_msgs::my_msgs::msg::Tilt", generated),
        ("[expose]\nin = [\"wanted\"]\n", "\"wanted\" carries", generated),
        (
            "[expose]\nin = [{ topic = \"wanted\", type = \"my_msgs/msg/Tilt\" }]\n",
            "\"wanted\" carries",
            generated,
        ),
        ("[expose]\nout = [\"reach\"]\n", "\"reach\" carries user_msgs::Reach", derived),
        ("[expose]\nservices = [\"level\"]\n", "\"level\" is user_msgs::", generated),
        ("[expose]\nactions = [\"lean\"]\n", "\"lean\" takes user_msgs::", generated),
        ("[record]\ntopics = [\"tilt\"]\n", "\"tilt\" carries", generated),
        ("[record]\ntopics = [\"count\"]\n", "\"count\" carries u32, which is not a ROS message", ""),
    ] {
        let problem = problem(&unregistered, &format!("{robot}{section}"));
        assert!(problem.contains("robot.toml:6: "), "{problem}");
        assert!(problem.contains(what) && problem.contains(add), "{problem}");
    }
    let calls = format!("{robot}[expose]\ncalls = [{{ service = \"x\", type = \"my_msgs/srv/Levl\" }}]\n");
    let error = problem(&app(), &calls);
    assert!(
        error.contains("robot.toml:6: ") && error.contains("did you mean \"my_msgs/srv/Level\"?"),
        "{error}"
    );
    // Inside a core any Rust type is allowed, and a recording of all topics continues without it.
    let folder = tempfile::tempdir().unwrap();
    let file = unregistered.robot_file(robot_file(folder.path(), robot)).unwrap();
    let robot = file.build(Core::new()).unwrap();
    let unrecorded = Unrecorded::of(&robot.recorded_topics().unwrap(), &robot.file.catalog.interfaces);
    let problem = unrecorded.problem_of("/tilt").unwrap();
    assert!(problem.contains(generated), "as `bag record --robot --topics` says: {problem}");
    let topics = unrecorded.topics();
    let names: Vec<_> = topics.iter().map(|topic| topic.topic.as_str()).collect();
    for topic in ["/tilt", "/reach", "/upright", "/count", "/wanted"] {
        assert!(names.contains(&topic), "{names:?}");
    }
}

#[test]
fn two_definitions_with_one_name_are_refused_when_the_app_is_used() {
    #[derive(Clone, Debug, Default, PartialEq, Message)]
    #[message(name = "my_msgs/msg/Tilt", crate = "downbeat::msgs")]
    struct OtherTilt {
        angle: f32,
    }
    let error = app().interfaces(OtherTilt::INTERFACES).catalog().err().unwrap().to_string();
    assert!(error.contains("my_msgs/msg/Tilt is registered with two definitions"), "{error}");
    assert!(error.contains(Tilt::TYPE_HASH) && error.contains(OtherTilt::TYPE_HASH), "{error}");
}

#[test]
fn a_built_in_robot_is_recorded_without_a_warning() {
    let robots = Path::new(env!("CARGO_MANIFEST_DIR")).join("robots");
    for name in ["darwin_op.toml", "darwin_op_serial.toml"] {
        let path = robots.join(name);
        let file = App::with_built_in_kinds().robot_file(path).unwrap().on_any_machine();
        let robot = file.build(Core::new()).unwrap();
        let topics = robot.recorded_topics().unwrap();
        assert_eq!(Unrecorded::of(&topics, &robot.file.catalog.interfaces).topics(), []);
    }
}

#[test]
fn the_page_about_messages_shows_a_package_that_is_built() {
    let page = include_str!("../docs/messages.md");
    let main = |file: &'static str| &file[file.find("fn main").unwrap()..];
    for shown in [
        include_str!("user_msgs/my_msgs/msg/Tilt.msg"),
        main(include_str!("user_msgs/build.rs")),
        "downbeat_msgs::include_interfaces!();\n",
    ] {
        assert!(page.contains(shown), "{shown}");
    }
    assert!(include_str!("user_msgs/src/lib.rs").contains("\ndownbeat_msgs::include_interfaces!();\n"));
}
