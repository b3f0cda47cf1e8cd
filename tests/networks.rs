//! Robots in two networks, each with its own selection of topics, services and actions.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Running, WATCHDOG, downbeat, robot_file, text_of, wait_until};
use downbeat::App;
use downbeat::bridge::middleware::{DiscoveryRange, ParticipantOptions, Sample};
use downbeat::bridge::ros::{MessageType, Node, NodeName, Participant, Subscription};
use downbeat::executor::{Client, Context, Module, Publication, Received, Setup, SetupError};
use downbeat::modules::actions::{ActionClient, ActionServer};
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::std_msgs::msg::String as Text;
use downbeat::msgs::std_srvs::srv::{SetBool, SetBoolRequest, SetBoolResponse};
use downbeat::msgs::test_msgs::action::{Fibonacci, FibonacciGoal, FibonacciResult};
use downbeat::msgs::{Message, cdr};
use downbeat::running::{PreparedRobot, RecordPlan, RunningRobot};
use std::path::Path;
use std::sync::mpsc::{Receiver, channel};
use std::time::Duration;
use test_machine::free_domain;

/// Sends two topics to a fleet and takes one from there, which is not sent to the robot's own network.
const FLEET: &str = "\
out = [{ topic = \"battery_state\", rate_hz = 2.0 }, { topic = \"joint_states\", as = \"/fleet/joints\" }]
in = [{ topic = \"plan\", as = \"/fleet/plan\", type = \"std_msgs/msg/String\", raw = true }]
";

/// The output of a command that looks at a domain.
fn shown(domain: u16, line: &[&str]) -> String {
    let output = downbeat(line).env("ROS_DOMAIN_ID", domain.to_string()).output().unwrap();
    String::from_utf8([output.stdout, output.stderr].concat()).unwrap()
}

/// Runs the demo in its own domain and in a fleet, with `line` to look at the fleet; records it, and replays
/// it.
fn run_in_two_networks(folder: &Path, fleet: &str, look_at_fleet: impl Fn(&[&str]) -> String) {
    let robot = robot_file(folder, |text| format!("{text}\n[networks.fleet]\n{fleet}{FLEET}"));
    let (robot, bag, own) = (robot.to_str().unwrap(), folder.join("bag"), free_domain());
    let mut running = Running::start_by(
        downbeat(&["run", robot, "--record", bag.to_str().unwrap()]).env("ROS_DOMAIN_ID", own.to_string()),
    );
    running.wait_for_output("joined network fleet");
    wait_until("the fleet sees the robot", || look_at_fleet(&["topic", "list"]).contains("/fleet/joints"));
    let of_fleet = look_at_fleet(&["topic", "list", "-t"]);
    for expected in ["/battery_state [sensor_msgs/msg/BatteryState]", "/fleet/plan [std_msgs/msg/String]"] {
        assert!(of_fleet.contains(expected), "{expected}: {of_fleet}");
    }
    assert!(!of_fleet.contains("/imu/data_raw") && !of_fleet.contains("/joint_commands"), "{of_fleet}");
    let of_robot = shown(own, &["topic", "list"]);
    assert!(of_robot.contains("/imu/data_raw") && !of_robot.contains("/fleet/"), "{of_robot}");
    let states = look_at_fleet(&["topic", "echo", "--once", "/fleet/joints"]);
    assert!(states.contains("head_tilt"), "{states}");
    let said = look_at_fleet(&[
        "topic",
        "pub",
        "--once",
        "-w",
        "1",
        "/fleet/plan",
        "std_msgs/msg/String",
        "{data: go}",
    ]);
    assert!(said.contains("go"), "{said}");
    std::thread::sleep(Duration::from_millis(300));
    running.interrupt();
    assert_eq!(common::recorded_messages(&bag, "/plan"), 1, "{}", running.output());
    // A difference would be a failure.
    let replay = text_of(&["bag", "replay", robot, bag.to_str().unwrap()]);
    assert!(replay.contains("/joint_states"), "{replay}");
}

#[test]
fn a_robot_in_two_domains_shows_each_its_own_selection_and_replays_bit_for_bit() {
    let (folder, fleet) = (tempfile::tempdir().unwrap(), free_domain());
    let domain = format!("domain = {fleet}\n");
    run_in_two_networks(folder.path(), &domain, |line| shown(fleet, line));
}

/// A router of Zenoh, and where it listens.
#[cfg(feature = "zenoh")]
fn router() -> (String, Running) {
    let port = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let mut router = downbeat(&["router"]);
    let router =
        Running::start_by(router.env("ZENOH_CONFIG_OVERRIDE", format!("listen/endpoints=[\"{endpoint}\"]")));
    router.wait_for_output("listens on");
    (endpoint, router)
}

#[cfg(feature = "zenoh")]
#[test]
fn a_robot_on_dds_is_in_a_fleet_on_zenoh_and_replays_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let (endpoint, _router) = router();
    let (fleet, domain) = (format!("engine = \"zenoh\"\nconnect = \"{endpoint}\"\ndomain = 5\n"), 5);
    run_in_two_networks(folder.path(), &fleet, |line| {
        shown(domain, &[line, &["--connect", &endpoint]].concat())
    });
}

#[cfg(feature = "zenoh")]
#[test]
fn a_robot_runs_without_the_router_of_its_fleet_and_joins_when_it_comes() {
    let (folder, own) = (tempfile::tempdir().unwrap(), free_domain());
    let port = std::net::TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().port();
    let endpoint = format!("tcp/127.0.0.1:{port}");
    let fleet = format!(
        "[networks.fleet]\nengine = \"zenoh\"\nconnect = \"{endpoint}\"\nout = [\"battery_state\"]\n"
    );
    let robot = robot_file(folder.path(), |text| format!("{text}\n{fleet}"));
    let running =
        Running::start_by(downbeat(&["run", robot.to_str().unwrap()]).env("ROS_DOMAIN_ID", own.to_string()));
    running.wait_for_output("no Zenoh router is there");
    wait_until("the robot runs", || shown(own, &["topic", "list"]).contains("/battery_state"));
    let mut router = downbeat(&["router"]);
    let _router =
        Running::start_by(router.env("ZENOH_CONFIG_OVERRIDE", format!("listen/endpoints=[\"{endpoint}\"]")));
    let look = ["topic", "list", "--connect", &endpoint];
    wait_until("the fleet sees the robot", || shown(own, &look).contains("/battery_state"));
}

#[test]
fn a_network_that_the_robot_is_in_already_is_refused_with_its_line() {
    let (folder, domain) = (tempfile::tempdir().unwrap(), free_domain());
    let robot =
        robot_file(folder.path(), |text| format!("{text}\n[networks.fleet]\nout = [\"battery_state\"]\n"));
    let text = shown(domain, &["run", robot.to_str().unwrap(), "--duration", "1s"]);
    assert!(text.contains("network \"fleet\" is one that the robot is in already"), "{text}");
}

/// Serves the service `ask` and the action `count`. For each message on `go` it uses `far/ask` and
/// `far/count`. Publishes on `log` what comes of all that.
#[derive(Default)]
struct Post {
    server: ActionServer<Fibonacci>,
    client: ActionClient<Fibonacci>,
}

struct PostPorts {
    log: Publication<Text>,
    ask: Client<SetBoolRequest, SetBoolResponse>,
}

impl Module for Post {
    type Ports = PostPorts;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<PostPorts, SetupError> {
        setup.serve("ask", |_: &mut Self, request: &SetBoolRequest, ctx| {
            say(ctx, format!("was asked {}", request.data));
            Ok(SetBoolResponse { success: request.data, message: "answered".into() })
        })?;
        ActionServer::builder(|post: &mut Self| &mut post.server)
            .on_accepted(|post, id, ctx| {
                let order = post.server.goal(id).unwrap().goal().order;
                post.server.succeed(ctx, id, FibonacciResult { sequence: vec![order] }).unwrap();
                say(ctx, format!("counted to {order}"));
            })
            .declare(setup, "count", &mut self.server)?;
        ActionClient::builder(|post: &mut Self| &mut post.client)
            .on_result(|_, _, end, ctx| {
                let end = end.unwrap();
                say(ctx, format!("far count: {} {:?}", end.status, end.result.sequence));
            })
            .declare(setup, "far/count", &mut self.client)?;
        setup.subscribe("go", |post: &mut Self, _: Received<'_, Text>, ctx| {
            ctx.call(ctx.ports.ask, SetBoolRequest { data: true });
            post.client.send(ctx, FibonacciGoal { order: 3 });
        })?;
        let ask = setup.client("far/ask", WATCHDOG, |_: &mut Self, reply, ctx| {
            let answer: Result<SetBoolResponse, _> = reply.result;
            say(ctx, format!("far answer: {}", answer.unwrap().success));
        })?;
        Ok(PostPorts { log: setup.publish("log")?, ask })
    }
}

fn say(ctx: &mut Context<'_, PostPorts>, line: String) {
    ctx.publish(ctx.ports.log, Text { data: line });
}

fn posts() -> App {
    App::new().kind("post", "asks and answers", Post::default)
}

/// One side of the conversation of two posts in one network.
fn post(name: &str, far: &str) -> String {
    format!(
        "out = [{{ topic = \"log\", as = \"/{name}/log\" }}]\nin = [{{ topic = \"go\", as = \"/{name}/go\" }}]\n\
         services = [{{ service = \"ask\", as = \"/{name}/ask\" }}]\n\
         calls = [{{ service = \"far/ask\", as = \"/{far}/ask\", timeout = \"60s\" }}]\n\
         actions = [{{ action = \"count\", as = \"/{name}/count\" }}]\n\
         action_calls = [{{ action = \"far/count\", as = \"/{far}/count\", timeout = \"60s\" }}]\n"
    )
}

/// Starts a post, and records it if there is a bag.
fn start(file: &Path, text: &str, options: &ParticipantOptions, bag: Option<&Path>) -> RunningRobot {
    let name = file.file_stem().unwrap().to_str().unwrap();
    let robot = format!("[robot]\nname = \"{name}\"\n[[module]]\nkind = \"post\"\nname = \"post\"\n{text}");
    std::fs::write(file, robot).unwrap();
    let mut prepared = PreparedRobot::new(posts().robot_file(file).unwrap()).unwrap();
    prepared.expose(options, None).unwrap();
    if let Some(bag) = bag {
        prepared.record(RecordPlan::of_robot(bag, prepared.file(), None)).unwrap();
    }
    prepared.start().unwrap()
}

fn node(options: &ParticipantOptions) -> Node {
    let participant = Participant::join(options).unwrap();
    participant.create_node(NodeName::new("/", "script").unwrap()).unwrap()
}

fn lines(node: &Node, topic: &str) -> (Subscription, Receiver<String>) {
    let (sender, received) = channel();
    let take = move |sample: Sample| drop(sender.send(cdr::from_slice::<Text>(&sample.cdr).unwrap().data));
    let message_type = MessageType::new(Text::TYPE_NAME).unwrap();
    (node.subscribe(topic, &message_type, QosProfile::DEFAULT, Box::new(take)).unwrap(), received)
}

/// The services that a node of others sees, without those of every node.
fn services(node: &Node) -> Vec<String> {
    let found = node.participant().found().endpoints;
    let mut names: Vec<_> = found.into_iter().map(|endpoint| endpoint.name).collect();
    names.retain(|name| name.ends_with("/ask") || name.ends_with("/send_goal"));
    names.sort();
    names.dedup();
    names
}

/// A robot with a service in its own network and everything in a fleet, where a base has the other half; both
/// use each other. Records the robot and replays it.
fn talk_between_networks(folder: &Path, fleet: &str, in_fleet: &ParticipantOptions) {
    let (own, bag) = (options(free_domain()), folder.join("bag"));
    let text = format!(
        "[expose]\nservices = [\"ask\"]\ndiagnostics = false\n[networks.fleet]\n{fleet}{}",
        post("robot", "base")
    );
    let _base =
        start(&folder.join("base.toml"), &format!("[expose]\n{}", post("base", "robot")), in_fleet, None);
    let robot = start(&folder.join("robot.toml"), &text, &own, Some(&bag));
    let (in_own, in_fleet) = (node(&own), node(in_fleet));
    wait_until("the services are found", || {
        services(&in_own) == ["/ask"]
            && services(&in_fleet)
                .starts_with(&["/base/ask".to_owned(), "/base/count/_action/send_goal".to_owned()])
            && services(&in_fleet)
                .ends_with(&["/robot/ask".to_owned(), "/robot/count/_action/send_goal".to_owned()])
    });

    // The same service in two networks.
    for (node, name) in [(&in_own, "/ask"), (&in_fleet, "/robot/ask")] {
        let client = node.client::<SetBool>(name, QosProfile::SERVICES).unwrap();
        assert!(client.wait_for_service(WATCHDOG));
        assert!(client.call_and_wait(&SetBoolRequest { data: true }, WATCHDOG).unwrap().success);
    }
    // Each uses what the other has in the fleet.
    for (name, far) in [("robot", "base"), ("base", "robot")] {
        let (subscription, log) = lines(&in_fleet, &format!("/{name}/log"));
        let (far_subscription, far_log) = lines(&in_fleet, &format!("/{far}/log"));
        let go = MessageType::new(Text::TYPE_NAME).unwrap();
        let go = in_fleet.publish(&format!("/{name}/go"), &go, QosProfile::DEFAULT).unwrap();
        wait_until("the topics are matched", || {
            let found = |subscription: &Subscription| subscription.matched_publishers() > 0;
            found(&subscription) && found(&far_subscription) && go.matched_subscriptions() > 0
        });
        go.publish(cdr::to_vec(&Text::default()).into()).unwrap();
        let two = |log: &Receiver<String>| {
            let mut lines = [(); 2].map(|()| log.recv_timeout(WATCHDOG).unwrap());
            lines.sort();
            lines
        };
        assert_eq!(two(&log), ["far answer: true", "far count: succeeded [3]"]);
        assert_eq!(two(&far_log), ["counted to 3", "was asked true"]);
    }
    robot.stop().unwrap();
    assert_eq!(common::recorded_messages(&bag, "/log"), 6);
    posts().replay(folder.join("robot.toml"), &bag).unwrap().assert_same().unwrap();
}

fn options(domain: u16) -> ParticipantOptions {
    ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain) }
}

#[test]
fn services_and_actions_of_a_fleet_go_both_ways_and_replay_bit_for_bit() {
    let (folder, fleet) = (tempfile::tempdir().unwrap(), free_domain());
    talk_between_networks(folder.path(), &format!("domain = {fleet}\n"), &options(fleet));
}

#[cfg(feature = "zenoh")]
#[test]
fn services_and_actions_of_a_fleet_on_zenoh_go_both_ways_and_replay_bit_for_bit() {
    let (folder, domain) = (tempfile::tempdir().unwrap(), free_domain());
    let (endpoint, _router) = router();
    let mut in_fleet = options(domain);
    in_fleet.engine = downbeat::bridge::middleware::Engine::Zenoh;
    in_fleet.zenoh.connect = Some(endpoint.clone());
    let fleet = format!("engine = \"zenoh\"\nconnect = \"{endpoint}\"\ndomain = {domain}\n");
    talk_between_networks(folder.path(), &fleet, &in_fleet);
}

#[test]
fn parameters_and_the_log_are_in_a_further_network_only_if_the_file_says_so() {
    let (folder, own, fleet, base) =
        (tempfile::tempdir().unwrap(), free_domain(), free_domain(), free_domain());
    let networks = format!(
        "[networks.fleet]\ndomain = {fleet}\nparameters = true\nrosout = true\n\
         [networks.base]\ndomain = {base}\nout = [\"battery_state\"]\n"
    );
    let robot = robot_file(folder.path(), |text| format!("{text}\n{networks}"));
    let checked = text_of(&["check", robot.to_str().unwrap()]);
    assert!(checked.contains("  log -> /rosout, on fleet\n  parameters, on fleet\n"), "{checked}");
    let _running =
        Running::start_by(downbeat(&["run", robot.to_str().unwrap()]).env("ROS_DOMAIN_ID", own.to_string()));
    for domain in [own, fleet] {
        wait_until("the parameters are there", || shown(domain, &["param", "list"]).contains("use_sim_time"));
        let value = shown(domain, &["param", "get", "/darwin_op", "use_sim_time"]);
        assert!(value.contains("False"), "{value}");
        let line = shown(domain, &["topic", "echo", "--once", "/rosout"]);
        assert!(line.contains("name: darwin_op"), "{line}");
    }
    wait_until("the node is in the other network", || shown(base, &["node", "list"]).contains("/darwin_op"));
    let (topics, services) = (shown(base, &["topic", "list"]), shown(base, &["service", "list"]));
    assert!(topics.contains("/battery_state") && !topics.contains("/rosout"), "{topics}");
    assert!(services.contains("/darwin_op/get_type_description"), "{services}");
    assert!(!services.contains("parameters"), "{services}");
}
