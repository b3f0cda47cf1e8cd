#![allow(clippy::unwrap_used)]
use std::path::Path;

use downbeat_executor::Core;

use super::*;
use crate::Robot;
use crate::RosArgs;
use crate::file::Source;

/// Publishes joint_states, imu/data_raw, battery_state, buttons, diagnostics, motion/joint_commands,
/// joint_goals and some of no ROS message; receives joint_commands.
const ROBOT: &str = "[robot]\nname = \"r\"\n\
    [[module]]\nkind = \"darwin_op\"\nremap = { joint_commands = \"joint_goals\" }\n\
    [[module]]\nkind = \"stand_nod_wave\"\n[[module]]\nkind = \"joint_command_mux\"\n";

fn build(text: &str, ros: &str) -> Result<Robot> {
    let source = Source::new(Path::new("robot.toml"), text.to_owned());
    let mut file = RobotFile::parse(source, &crate::Catalog::built_in())?.0;
    let (_, arguments) = RosArgs::split(ros.split_whitespace().map(Into::into)).unwrap();
    file.apply_names(&arguments);
    file.apply_parameters(&arguments)?;
    file.build(Core::new())
}

/// The exposed topics and their names in ROS 2.
fn exposed(expose: &str) -> Vec<(String, String)> {
    exposed_with(expose, "").into_iter().map(|endpoint| (endpoint.topic, endpoint.ros_topic)).collect()
}

fn exposed_with(expose: &str, ros: &str) -> Vec<crate::ExposedEndpoint> {
    let robot = build(&format!("{ROBOT}[expose]\n{expose}"), ros).unwrap_or_else(|error| panic!("{error}"));
    robot.file.exposed(&robot.exposures().unwrap()).unwrap()
}

fn names(expose: &str) -> Vec<String> {
    exposed(expose).into_iter().map(|(topic, _)| topic).collect()
}

fn problem(expose: &str) -> String {
    build(&format!("{ROBOT}[expose]\n{expose}"), "").err().unwrap().to_string()
}

#[test]
fn what_a_pattern_does_not_expose_for_its_type_is_told() {
    struct Talker;
    impl downbeat_executor::Module for Talker {
        type Ports = ();

        fn setup(
            &mut self,
            setup: &mut downbeat_executor::Setup<'_, Self>,
        ) -> std::result::Result<(), downbeat_executor::SetupError> {
            setup.publish::<u32>("plain/count")?;
            setup.publish::<std::time::Duration>("plain/hidden")?;
            setup.publish::<downbeat_msgs::std_msgs::msg::String>("plain/said").map(drop)
        }
    }
    let mut catalog = crate::Catalog::default();
    catalog.add_kind(crate::Kind::new("talker", "talks", || Talker)).unwrap();
    let expose = "out = [{ topic = \"plain/*\", except = [\"plain/hidden\"] }]";
    let text = format!("[robot]\nname = \"r\"\n[[module]]\nkind = \"talker\"\n[expose]\n{expose}");
    let file = RobotFile::parse(Source::new(Path::new("robot.toml"), text), &catalog).unwrap().0;
    let robot = file.build(Core::new()).unwrap();
    let topics: Vec<_> = robot.core.topics().cloned().collect();
    assert_eq!(
        robot.file.passed_over(&topics),
        ["\"plain/*\" does not expose \"plain/count\": it carries u32, which is not a ROS message"]
    );
}

#[test]
fn a_pattern_means_what_modules_publish_as_ros_messages() {
    let all = names("out = [\"**\"]");
    for topic in ["joint_states", "imu/data_raw", "battery_state", "motion/joint_commands", "joint_goals"] {
        assert!(all.iter().any(|name| name == topic), "{topic} is in {all:?}");
    }
    let never = |name: &String| {
        name.starts_with("executor/")
            || [
                "module_steps",
                "module_settings",
                "module_events",
                "module_runs",
                "cycle_times",
                "cycle_messages",
                "joint_commands",
            ]
            .contains(&name.as_str())
    };
    assert!(!all.iter().any(never), "{all:?}");
    assert_eq!(names("out = [\"joint_*\"]"), ["joint_states", "joint_goals"]);
    assert_eq!(names("in = [\"joint_*\"]"), ["joint_torque", "joint_commands"]);
    assert_eq!(
        names("out = [{ topic = \"**\", type = \"sensor_msgs/msg/Imu\" }]"),
        ["imu/data_raw"],
        "a type says which"
    );
}

#[test]
fn what_is_named_is_not_exposed_again_by_a_pattern() {
    let out = "out = [\"*_states\", \"joint_*\", { topic = \"joint_goals\", as = \"goals\" }]";
    let pair = |topic: &str, name: &str| (topic.to_owned(), name.to_owned());
    assert_eq!(exposed(out), [pair("joint_states", "/joint_states"), pair("joint_goals", "/goals")]);
}

#[test]
fn a_pattern_renames_and_excepts() {
    let pair = |topic: &str, name: &str| (topic.to_owned(), name.to_owned());
    assert_eq!(
        exposed("out = [{ topic = \"*/joint_*\", as = \"~/*/j_*\" }]"),
        [pair("motion/joint_commands", "/r/motion/j_commands")]
    );
    assert_eq!(
        names(
            "out = [{ topic = \"**\", except = [\"imu/**\", \"battery_state\", \"bu*\", \"d*\", \"m*/**\", \"bus/*\"] }]"
        ),
        ["joint_states", "joint_goals"]
    );
    assert_eq!(exposed("out = [\"/joint_s*\"]"), [pair("joint_states", "/joint_states")]);
}

/// Recorder and viewers read the file again when the bridge has opened its inlets.
#[test]
fn a_pattern_under_in_still_means_its_topics_once_the_bridge_publishes_them() {
    let mut robot = build(&format!("{ROBOT}[expose]\nin = [\"joint_torqu*\"]"), "").unwrap();
    let before = robot.exposures().unwrap();
    let inlet = robot.core.inlet::<downbeat_msgs::sensor_msgs::msg::JointState>("joint_torque").unwrap();
    // An inlet of the program: no module receives its messages.
    let other = robot.core.inlet::<downbeat_msgs::sensor_msgs::msg::JointState>("joint_torques").unwrap();
    let after = robot.exposures().unwrap();
    assert_eq!((before.len(), after.len()), (1, 1));
    assert_eq!(before[0].topic, after[0].topic);
    drop((inlet, other));
}

#[test]
fn mistakes_are_told_with_line_and_nearest_name() {
    for (expose, expected) in [
        (
            "out = [\"joint_sates\"]",
            "no module has a topic \"joint_sates\" to expose, did you mean \"joint_states\"?",
        ),
        (
            "out = [\"jiont_*\"]",
            "\"jiont_*\" matches no topic that a module publishes, did you mean \"joint_",
        ),
        ("in = [\"joint_states/*\"]", "matches no topic that modules receive and none publishes"),
        (
            "out = [{ topic = \"joint_*\", except = [\"joint_stats\"] }]",
            "\"joint_stats\" is none of what \"joint_*\" matches, did you mean \"joint_states\"?",
        ),
        (
            "out = [{ topic = \"*\", type = \"sensor_msgs/msg/Image\" }]",
            "matches no topic of type \"sensor_msgs/msg/Image\"",
        ),
        (
            "out = [\"joint_states\", { topic = \"joint_goals\", as = \"/joint_states\" }]",
            "/joint_states is exposed twice",
        ),
        ("out = [{ topic = \"joint_states\", node = \"a b\" }]", "node name \"a b\" is not valid"),
        ("out = [{ topic = \"joint_states\", as = \"a b\" }]", "' ' is not allowed"),
        ("out = [\"joint_commands\"]", "does it belong under \"in\"?"),
    ] {
        let problem = problem(expose);
        assert!(problem.starts_with("robot.toml:11: ") && problem.contains(expected), "{problem}");
    }
}

#[test]
fn remapping_rules_change_nodes_and_topics_and_those_given_beside_the_file_win() {
    let with_rules = |text: &str, ros: &str| {
        let text = ROBOT.replacen("name = \"r\"\n", &format!("name = \"r\"\n{text}\n"), 1);
        let out =
            "out = [\"joint_states\", { topic = \"imu/data_raw\", as = \"~/imu\", node = \"sensors\" }]";
        let robot = build(&format!("{text}[expose]\n{out}"), ros).unwrap();
        let endpoints = robot.file.exposed(&robot.exposures().unwrap()).unwrap();
        endpoints
            .iter()
            .map(|endpoint| format!("{} {}", endpoint.node, endpoint.ros_topic))
            .collect::<Vec<_>>()
    };
    assert_eq!(with_rules("", ""), ["/r /joint_states", "/sensors /sensors/imu"]);
    assert_eq!(
        with_rules("", "--ros-args -r __ns:=/robot1 -r r:__node:=left -r joint_states:=/states"),
        ["/robot1/left /states", "/robot1/sensors /robot1/sensors/imu"]
    );
    let in_file =
        "namespace = \"/a\"\nnode = \"driver\"\nremap = { \"driver:__ns\" = \"/b\", joint_states = \"js\" }";
    assert_eq!(with_rules(in_file, ""), ["/b/driver /b/js", "/a/sensors /a/sensors/imu"]);
    assert_eq!(with_rules(in_file, "--ros-args -r __ns:=/c")[0], "/c/driver /c/js");
}

#[test]
fn a_parameter_may_be_for_one_node_only() {
    let hold = |ros: &str| {
        let robot = build(ROBOT, ros).unwrap();
        let settings = robot.core.settings("joint_command_mux").unwrap();
        settings.into_iter().find(|setting| setting.name == "hold_s").unwrap().value
    };
    let usual = hold("");
    assert_eq!(hold("--ros-args -p joint_command_mux.hold_s:=0.5"), 0.5.into());
    assert_eq!(hold("--ros-args -p r:joint_command_mux.hold_s:=0.5"), 0.5.into());
    assert_eq!(hold("--ros-args -p other:joint_command_mux.hold_s:=0.5"), usual);
    assert_eq!(hold("--ros-args -r __node:=n -p n:joint_command_mux.hold_s:=0.5"), 0.5.into());
    assert_eq!(
        hold("--ros-args -p joint_command_mux.hold_s:=0.5 -p joint_command_mux.hold_s:=0.25"),
        0.25.into()
    );
}

#[test]
fn what_ros_cannot_be_told_is_refused_with_the_line() {
    let in_robot = |line: &str| {
        let text = ROBOT.replacen("name = \"r\"\n", &format!("name = \"r\"\n{line}\n"), 1);
        build(&text, "").err().unwrap().to_string()
    };
    let problem = in_robot("remap = { \"a b\" = \"c\" }");
    assert!(problem.starts_with("robot.toml:3: \"a b:=c\" is no remapping rule"), "{problem}");
    assert!(in_robot("node = \"1\"").starts_with("robot.toml:3: \"1\" is not a valid name"));
    assert!(in_robot("remap = { \"__ns\" = \"/a/\" }").contains("namespace \"/a/\" is not valid"));
}

#[test]
fn the_namespace_of_the_environment_is_for_robots_without_one() {
    let of = |text: &str| {
        let mut file = RobotFile::parse(
            Source::new(Path::new("robot.toml"), text.to_owned()),
            &crate::Catalog::built_in(),
        )
        .unwrap()
        .0;
        let variables = |name: &str| (name == "ROS_NAMESPACE").then(|| "robot7".to_owned());
        file.apply_names(&RosArgs::default().with_variables(variables));
        file.node_name().unwrap().to_string()
    };
    assert_eq!(of(ROBOT), "/robot7/r");
    assert_eq!(of(&ROBOT.replacen("name = \"r\"\n", "name = \"r\"\nnamespace = \"/own\"\n", 1)), "/own/r");
}

#[test]
fn bytes_of_a_type_that_is_not_compiled_in_need_no_module() {
    let relay = "in = [{ topic = \"legs\", type = \"legs/msg/Leg\" }]\n\
                 out = [{ topic = \"legs\", as = \"/far/legs\", type = \"legs/msg/Leg\" }]";
    let endpoints = exposed_with(relay, "");
    let summary = |endpoint: &crate::ExposedEndpoint| {
        (endpoint.direction.name(), endpoint.ros_topic.clone(), endpoint.type_name.clone())
    };
    let expected = |direction: &'static str, topic: &str| (direction, topic.into(), "legs/msg/Leg".into());
    assert_eq!(
        endpoints.iter().map(summary).collect::<Vec<_>>(),
        [expected("out", "/far/legs"), expected("in", "/legs")]
    );
    assert_eq!(
        names("in = [{ topic = \"buffer\", type = \"sensor_msgs/msg/Imu\", raw = true }]"),
        ["buffer"],
        "asked for, of a type that is compiled in"
    );
    for (expose, expected) in [
        ("in = [{ topic = \"legs\", raw = true }]", "\"raw\" needs a \"type\""),
        ("in = [{ topic = \"legs/*\", type = \"legs/msg/Leg\" }]", "must be given by name"),
        (
            "in = [{ topic = \"x\", type = \"sensor_msgs/msg/Imuu\" }]",
            "did you mean \"sensor_msgs/msg/Imu\"?",
        ),
        ("out = [{ topic = \"legs\", type = \"legs/msg/Leg\" }]", "no module publishes \"legs\""),
        (
            "in = [{ topic = \"joint_commands\", type = \"legs/msg/Leg\" }]",
            "only what modules take or give as bytes can be raw",
        ),
    ] {
        let problem = problem(expose);
        assert!(problem.contains(expected), "{problem}");
    }
}

#[test]
fn each_network_has_its_own_selection() {
    let text = "out = [\"joint_states\", \"battery_state\"]\n[networks.fleet]\ndomain = 7\n\
        out = [{ topic = \"joint_states\", rate_hz = 1.0 }, \"b*\"]\nin = [\"joint_commands\"]";
    let endpoints = exposed_with(text, "");
    let of = |network: Option<&str>| -> Vec<_> {
        let its = endpoints.iter().filter(|endpoint| endpoint.network.as_deref() == network);
        its.map(|endpoint| (endpoint.topic.as_str(), endpoint.direction)).collect()
    };
    assert_eq!(of(None), [("joint_states", Direction::Out), ("battery_state", Direction::Out)]);
    let out = ["joint_states", "battery_state", "buttons"].map(|topic| (topic, Direction::Out));
    assert_eq!(of(Some("fleet")), [&out[..], &[("joint_commands", Direction::In)]].concat());
    let limited = endpoints.iter().find(|endpoint| endpoint.limits.period.is_some()).unwrap();
    assert!(limited.to_string().ends_with("at most 1 Hz, on fleet"), "{limited}");
}

#[test]
fn what_comes_in_from_one_network_goes_out_to_another_only_if_the_file_says_so() {
    let fleet = |relay: &str| {
        format!(
            "in = [\"joint_commands\"]\n[networks.fleet]\ndomain = 7\n\
             out = [{{ topic = \"joint_commands\"{relay}, as = \"/fleet/commands\" }}]"
        )
    };
    assert_eq!(exposed(&fleet(", relay = true")).len(), 2);
    let text = "[networks.fleet]\ndomain = 7\nout = [\"joint_states\"]\n\
        [networks.base]\ndomain = 8\nin = [{ topic = \"joint_states\", type = \"sensor_msgs/msg/JointState\" }]";
    assert!(problem(text).contains("add relay = true here"), "{}", problem(text));
}

#[test]
fn a_network_that_cannot_be_joined_is_refused_with_the_line() {
    for (network, words) in [
        ("domain = 233", "from 0 to 232"),
        ("domian = 1", "did you mean \"domain\"?"),
        ("engine = \"zenho\"", "\"zenho\" is no engine"),
        ("connect = \"tcp/base:7447\"", "\"connect\" needs a network with engine = \"zenoh\""),
        ("out = [{ topic = \"joint_states\", priority = \"data\" }]", "\"priority\" needs a network with"),
        ("parameters = [\"*\"]", "expected true or false"),
        ("lifecycle = [\"motion\"]", "has no \"lifecycle\""),
    ] {
        let text = problem(&format!("[networks.fleet]\n{network}"));
        assert!(text.starts_with("robot.toml:12: ") && text.contains(words), "{network}: {text}");
    }
}
