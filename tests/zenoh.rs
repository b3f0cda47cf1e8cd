//! Robots and commands on Zenoh, with the router of the program.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::downbeat;
use std::process::{Command, Output};

/// The output of a command and its error output.
fn run(mut command: Command) -> (bool, String) {
    let Output { status, stdout, stderr } = command.output().unwrap();
    let text = [stdout, stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned()).concat();
    (status.success(), text)
}

#[test]
fn an_unknown_implementation_is_refused_with_those_that_are_known() {
    let mut command = downbeat(&["topic", "list"]);
    command.env("RMW_IMPLEMENTATION", "rmw_zenoh");
    let (is_done, text) = run(command);
    assert!(!is_done && text.contains("\"rmw_zenoh\"") && text.contains("rmw_cyclonedds_cpp"), "{text}");
}

#[cfg(not(feature = "zenoh"))]
#[test]
fn a_program_without_zenoh_says_how_to_get_it() {
    let mut list = downbeat(&["topic", "list"]);
    list.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
    let connect = downbeat(&["topic", "list", "--connect", "tcp/localhost:7447"]);
    for command in [list, connect, downbeat(&["router"])] {
        let (is_done, text) = run(command);
        assert!(!is_done && text.contains("--features zenoh"), "{text}");
    }
}

#[cfg(feature = "zenoh")]
mod with_zenoh {
    use super::common::program::{Program, Way};
    use super::common::{downbeat, recorded_messages, wait_until};
    use super::run;
    use rustix::process::Signal;
    use std::net::TcpListener;
    use test_machine::free_domain;

    const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/robots/darwin_op.toml");

    /// A head whose controller serves an action.
    const HEAD: &str = r#"
        [robot]
        name = "head"
        [[module]]
        kind = "darwin_op_emulator"
        settings = { link = "memory:head" }
        [[module]]
        name = "hardware"
        kind = "darwin_op"
        settings = { port = "memory:head", hardware_id = "emulated" }
        [[module]]
        name = "head_controller"
        kind = "joint_trajectory"
        settings = { joints = ["head_pan", "head_tilt"], "constraints.goal_time" = 20.0 }
        [expose]
        engine = "zenoh"
        out = ["joint_states"]
        actions = ["head_controller/follow_joint_trajectory"]
        lifecycle = ["head_controller"]
    "#;

    fn free_port() -> u16 {
        TcpListener::bind(("127.0.0.1", 0)).unwrap().local_addr().unwrap().port()
    }

    /// The network of a test: a router on a port, and a domain.
    struct Network {
        port: u16,
        domain: u16,
    }

    impl Network {
        fn command(&self, line: &[&str]) -> std::process::Command {
            let Self { port, domain } = self;
            let mut command = downbeat(line);
            command.env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp").env("ROS_DOMAIN_ID", domain.to_string());
            let sessions = format!(
                "connect/endpoints=[\"tcp/127.0.0.1:{port}\"];listen/endpoints=[\"tcp/127.0.0.1:0\"]"
            );
            command.env("ZENOH_CONFIG_OVERRIDE", sessions);
            command
        }

        fn router(&self) -> Program {
            let mut command = downbeat(&["router"]);
            let listen = format!("listen/endpoints=[\"tcp/127.0.0.1:{}\"]", self.port);
            command.env("ZENOH_CONFIG_OVERRIDE", listen);
            let router = Program::start(command);
            router.wait_for_output("listens on");
            router
        }

        /// What a command shows. It looks for as long as `--spin-time` says, which on a busy machine may be
        /// too short.
        fn shown(&self, line: &[&str]) -> String {
            let mut text = String::new();
            wait_until("the command finds what it looks for", || {
                let (is_done, shown) = run(self.command(line));
                text = shown;
                is_done
            });
            text
        }
    }

    #[test]
    fn a_robot_is_seen_and_used_by_a_second_process() {
        let network = Network { port: free_port(), domain: free_domain() };
        let mut router = network.router();
        let mut robot = Program::start(network.command(&["run", ROBOT]));
        wait_until("the node is listed", || network.shown(&["node", "list"]).contains("/darwin_op"));
        let topics = network.shown(&["topic", "list", "-t"]);
        assert!(topics.contains("/joint_states [sensor_msgs/msg/JointState]"), "{topics}");
        assert!(topics.contains("/rosout [rcl_interfaces/msg/Log]"), "{topics}");
        // A node is listed before all of its endpoints are.
        wait_until("the endpoints of the node are shown", || {
            let node = network.shown(&["node", "info", "/darwin_op"]);
            ["/imu/data_raw: sensor_msgs/msg/Imu", "/darwin_op/get_parameters", "Action Servers:"]
                .iter()
                .all(|expected| node.contains(expected))
        });
        wait_until("the topic is described", || {
            let info = network.shown(&["topic", "info", "-v", "/joint_states"]);
            info.contains("Node name: darwin_op") && info.contains("RIHS01_")
        });
        let states = network.shown(&["topic", "echo", "--once", "/joint_states"]);
        assert!(states.contains("head_tilt"), "{states}");
        let parameters = network.shown(&["param", "list", "/darwin_op"]);
        let parameter = parameters.split_whitespace().find(|word| word.contains('.')).unwrap();
        network.shown(&["param", "get", "/darwin_op", parameter]);
        let service = ["service", "call", "/darwin_op/list_parameters", "rcl_interfaces/srv/ListParameters"];
        assert!(network.shown(&service).contains(parameter), "{parameter}");
        let line = network.shown(&["topic", "echo", "--once", "/rosout"]);
        assert!(line.contains("name: darwin_op"), "{line}");
        assert!(network.shown(&["graph"]).contains("/darwin_op"));

        // As a client of the router, without the variables.
        let (port, domain) = (network.port, network.domain.to_string());
        let connect = format!("tcp/127.0.0.1:{port}");
        let mut command = downbeat(&["node", "list", "--connect", &connect]);
        command.env("ROS_DOMAIN_ID", &domain);
        let (is_done, nodes) = run(command);
        assert!(is_done && nodes.contains("/darwin_op"), "{nodes}");
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let record =
            ["bag", "record", "--topics", "/joint_states", "--duration", "2s", "--connect", &connect];
        let mut command = downbeat(&record);
        let (is_done, text) = run({
            command.arg("-o").arg(&bag).env("ROS_DOMAIN_ID", &domain);
            command
        });
        assert!(is_done && recorded_messages(&bag, "/joint_states") > 0, "{text}");
        let nobody = downbeat(&["node", "list", "--connect", &format!("tcp/127.0.0.1:{}", free_port())]);
        let (is_done, text) = run(nobody);
        assert!(!is_done && text.contains("no Zenoh router answers at tcp/127.0.0.1:"), "{text}");
        assert!(!text.contains(".rs:"), "{text}");
        let apart = Network { domain: free_domain(), ..network };
        assert!(!apart.shown(&["node", "list", "--spin-time", "1"]).contains("/darwin_op"), "another domain");

        robot.ask(Way::Signal(Signal::INT));
        assert!(robot.wait().success(), "{}", robot.output());
        let network = Network { port, domain: domain.parse().unwrap() };
        assert!(!network.shown(&["node", "list", "--spin-time", "1"]).contains("/darwin_op"));
        router.ask(Way::Signal(Signal::INT));
        assert!(router.wait().success(), "{}", router.output());
    }

    #[test]
    fn an_action_and_a_lifecycle_are_used_by_a_second_process() {
        const CONTROLLER: &str = "/head_controller";
        const ACTION: &str = "/head_controller/follow_joint_trajectory";
        const TYPE: &str = "control_msgs/action/FollowJointTrajectory";
        let network = Network { port: free_port(), domain: free_domain() };
        let _router = network.router();
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("robot.toml");
        std::fs::write(&file, HEAD).unwrap();
        // The robot file names the engine.
        let mut command = network.command(&["run", file.to_str().unwrap()]);
        let _robot = Program::start({
            command.env_remove("RMW_IMPLEMENTATION");
            command
        });
        wait_until("the action is listed", || {
            network.shown(&["action", "list", "-t"]).contains(&format!("{ACTION} [{TYPE}]"))
        });
        assert!(network.shown(&["lifecycle", "get", CONTROLLER]).contains("active [3]"));
        let goal = "{trajectory: {joint_names: [head_pan, head_tilt], points: [{positions: [0.1, 0.0], time_from_start: {sec: 1}}]}}";
        let reached = network.shown(&["action", "send_goal", "-f", ACTION, TYPE, goal]);
        assert!(reached.contains("Goal finished with status: SUCCEEDED"), "{reached}");
        assert!(reached.contains("Feedback:"), "{reached}");
        network.shown(&["lifecycle", "set", CONTROLLER, "deactivate"]);
        assert!(network.shown(&["lifecycle", "get", CONTROLLER]).contains("inactive [2]"));
    }

    #[test]
    fn without_a_router_a_robot_says_what_to_start_and_joins_when_one_comes() {
        let network = Network { port: free_port(), domain: free_domain() };
        let robot = Program::start(network.command(&["run", ROBOT]));
        robot.wait_for_output("Start it with `downbeat router`");
        let _router = network.router();
        wait_until("the robot has joined", || network.shown(&["node", "list"]).contains("/darwin_op"));
    }

    #[test]
    fn a_second_router_on_a_port_says_that_one_runs() {
        let network = Network { port: free_port(), domain: 0 };
        let _router = network.router();
        let mut command = downbeat(&["router"]);
        let listen = format!("listen/endpoints=[\"tcp/127.0.0.1:{}\"]", network.port);
        command.env("ZENOH_CONFIG_OVERRIDE", listen);
        let (is_done, text) = run(command);
        assert!(!is_done && text.contains("another router runs already"), "{text}");
    }
}
