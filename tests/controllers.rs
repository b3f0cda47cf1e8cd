//! Controllers of an emulated Darwin OP with ROS 2 peers: rclpy publishes a trajectory, a participant of
//! Cyclone DDS reads the state (no wheel has `control_msgs`), and the action is served.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, WATCHDOG, wait_until};
use downbeat::bridge::middleware::{DiscoveryRange, ParticipantOptions};
use downbeat::bridge::ros::{Client, NodeName, Participant};
use downbeat::msgs::action_msgs::msg::GoalStatus;
use downbeat::msgs::builtin_interfaces::msg::Duration as DurationMessage;
use downbeat::msgs::control_msgs::action::{
    FollowJointTrajectoryGetResult, FollowJointTrajectoryGetResultRequest, FollowJointTrajectoryGoal,
    FollowJointTrajectorySendGoal, FollowJointTrajectorySendGoalRequest,
};
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::trajectory_msgs::msg::{JointTrajectory, JointTrajectoryPoint};
use downbeat::msgs::unique_identifier_msgs::msg::UUID;
use serde_json::{Value, json};
use test_machine::free_domain;

const ROBOT: &str = r#"
[robot]
name = "head"
[[module]]
name = "emulator"
kind = "darwin_op_emulator"
settings = { link = "LINK" }
[[module]]
name = "hardware"
kind = "darwin_op"
settings = { port = "LINK", hardware_id = "darwin_op (emulated)" }
[[module]]
name = "head_controller"
kind = "joint_trajectory"
settings = { joints = ["head_pan", "head_tilt"], "constraints.head_pan.goal" = 0.02, "constraints.goal_time" = 20.0 }
[expose]
out = ["joint_states", "head_controller/controller_state"]
in = [{ topic = "head_controller/joint_trajectory", type = "trajectory_msgs/msg/JointTrajectory" }]
actions = ["head_controller/follow_joint_trajectory"]
"#;

/// The block of the page that contains a text.
fn block(language: &str, text: &str) -> &'static str {
    let start = format!("```{language}\n");
    let page = include_str!("../docs/servos.md");
    let mut blocks = page.split(&start).skip(1).map(|rest| rest.split("```").next().unwrap());
    blocks.find(|block| block.contains(text)).unwrap()
}

#[test]
fn controllers_are_switched_and_chained_as_the_page_says() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let hardware = "[robot]\nname = \"head\"\n[[module]]\nkind = \"darwin_op_emulator\"\n\
                    settings = { link = \"memory:head\" }\n[[module]]\nname = \"hardware\"\nkind = \"darwin_op\"\n\
                    settings = { port = \"memory:head\", hardware_id = \"emulated\" }\n";
    std::fs::write(folder.join("robot.toml"), format!("{hardware}{}", block("toml", "head/reference")))
        .unwrap();
    let command = |line: &str| {
        let mut parts = line.split('"');
        let mut words: Vec<&str> = parts.next().unwrap().split_whitespace().collect();
        words.extend(parts.next());
        let mut command = common::downbeat(&words);
        command.current_dir(folder).env("ROS_DOMAIN_ID", &domain).env("XDG_RUNTIME_DIR", folder);
        command
    };
    let mut robot = Running::start_by(&mut command("run robot.toml"));
    robot.wait_for_output("exposed to ROS 2: /joint_states");
    assert!(!robot.output().contains("both command"), "{}", robot.output());
    let said = |line: &str| {
        let output = command(line).output().unwrap();
        [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat()
    };
    let lines = block("sh", "lifecycle set /head_by_hand").lines();
    let lines: Vec<&str> =
        lines.map(|line| line.split('#').next().unwrap().trim_start_matches("ros2 ")).collect();
    let refused = said(lines[0]);
    assert!(!refused.contains("successful"), "{refused}");
    robot.wait_for_output("\"head_controller\" commands the joint \"head_pan\" on \"head/reference\"");
    for line in &lines[1..3] {
        assert!(said(line).contains("successful"), "{line}\n{}", robot.output());
    }
    // A command sent before the publisher is matched is lost.
    wait_until("the head has reached the commanded position", || {
        let published = said(lines[3]);
        assert!(published.contains("publishing"), "{published}");
        let state = said("topic echo --once /joint_states --full-length");
        let items = |key: &str| {
            let lines = state.lines().skip_while(|line| *line != key).skip(1);
            lines.map_while(|line| line.strip_prefix("- ")).collect::<Vec<_>>()
        };
        let pan = items("name:").iter().position(|name| *name == "head_pan");
        let pan = pan.and_then(|pan| items("position:").get(pan)?.parse::<f64>().ok());
        pan.is_some_and(|pan| (pan - 0.2).abs() < 0.02)
    });
    robot.interrupt();
}

/// As the page says, with the calls of `ros2 control`, by a participant of Cyclone DDS.
#[test]
fn cyclone_lists_and_switches_controllers_as_ros2_control_does() {
    let domain = free_domain();
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let _check = check("Node services", "controller_manager: list, switch, hardware", With::Cyclone, Way::In);
    let row = "dynamic_joint_states of the joint_state_broadcaster";
    let _check2 = check("Topics", row, With::Cyclone, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("robot.toml");
    let hardware = "[robot]\nname = \"head\"\n[[module]]\nkind = \"darwin_op_emulator\"\n\
                    settings = { link = \"memory:head\" }\n[[module]]\nname = \"hardware\"\nkind = \"darwin_op\"\n\
                    settings = { port = \"memory:head\", hardware_id = \"emulated\" }\n";
    let expose = "[expose]\ncontroller_manager = true\n";
    let text = format!("{hardware}{}", block("toml", "head/reference").replace("[expose]\n", expose));
    std::fs::write(&robot, text).unwrap();
    let mut program = Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain.to_string()]);
    program.wait_for_output("exposed controllers: /controller_manager");
    let mut ask = |name: &str, service: &str, fields: Value| {
        let (service, kind) =
            (format!("/controller_manager/{service}"), format!("controller_manager_msgs/srv/{name}"));
        cyclone.ask(json!({"do": "request", "service": service, "type": kind, "fields": fields}))
    };
    let mut controllers = || {
        let listed = ask("ListControllers", "list_controllers", json!({}))["controller"].clone();
        let listed = listed
            .as_array()
            .unwrap()
            .iter()
            .map(|one| (one["name"].as_str().unwrap().to_owned(), one.clone()));
        listed.collect::<std::collections::BTreeMap<_, _>>()
    };
    let mut listed = controllers();
    wait_until("the robot has begun", || {
        listed = controllers();
        ["head_controller", "joint_state_broadcaster"].iter().all(|name| listed[*name]["state"] == "active")
    });
    let names: Vec<_> = listed.keys().map(String::as_str).collect();
    assert_eq!(names, ["head", "head_by_hand", "head_controller", "joint_state_broadcaster"]);
    let trajectory = &listed["head_controller"];
    assert_eq!(trajectory["type"], "joint_trajectory_controller/JointTrajectoryController");
    assert_eq!((&trajectory["state"], &trajectory["update_rate"]), (&json!("active"), &json!(125)));
    let claimed = json!(["head/head_pan/position", "head/head_tilt/position"]);
    assert_eq!(
        (&trajectory["claimed_interfaces"], &listed["head"]["reference_interfaces"]),
        (&claimed, &claimed)
    );
    assert_eq!(trajectory["chain_connections"][0]["name"], "head");
    assert_eq!(
        (&listed["head"]["is_chainable"], &listed["head"]["is_chained"]),
        (&json!(true), &json!(true))
    );
    assert_eq!(listed["head_by_hand"]["state"], "inactive");
    assert_eq!(listed["head_by_hand"]["claimed_interfaces"], json!([]));
    assert_eq!(listed["joint_state_broadcaster"]["state"], "active");

    let switch = |deactivate: &str, activate: &str, strictness: i32| {
        let [activate, deactivate] =
            [activate, deactivate].map(|names| json!(names.split_whitespace().collect::<Vec<_>>()));
        json!({
            "activate_controllers": activate, "deactivate_controllers": deactivate,
            "strictness": strictness, "activate_asap": false, "timeout": {"sec": 5, "nanosec": 0},
        })
    };
    const STRICT: i32 = 2;
    const FORCE_AUTO: i32 = 4;
    for (deactivate, activate, problem) in [
        ("", "head_by_hand", "\"head_by_hand\" commands joints that \"head_controller\" has"),
        ("", "hand", "there is no controller \"hand\""),
        ("joint_state_broadcaster", "", "is a part of the hardware \"hardware\""),
    ] {
        let refused = ask("SwitchController", "switch_controller", switch(deactivate, activate, STRICT));
        assert_eq!(refused["ok"], false);
        assert!(refused["message"].as_str().unwrap().contains(problem), "{refused}");
    }
    for (request, active) in [
        (switch("head_controller", "head_by_hand", STRICT), "head_by_hand"),
        (switch("", "head_controller", FORCE_AUTO), "head_controller"),
    ] {
        let done = ask("SwitchController", "switch_controller", request);
        assert_eq!(done["ok"], true, "{done}");
        let listed = ask("ListControllers", "list_controllers", json!({}))["controller"].clone();
        let is_active = |name: &str| {
            listed.as_array().unwrap().iter().any(|one| one["name"] == *name && one["state"] == "active")
        };
        assert_eq!(
            [is_active("head_by_hand"), is_active("head_controller")],
            [active == "head_by_hand", active == "head_controller"]
        );
    }
    let mut interfaces = Value::Null;
    wait_until("the hardware has measured its joints", || {
        interfaces = ask("ListHardwareInterfaces", "list_hardware_interfaces", json!({}));
        interfaces["state_interfaces"].as_array().is_some_and(|states| !states.is_empty())
    });
    let named = |list: &str, name: &str| {
        interfaces[list]
            .as_array()
            .unwrap()
            .iter()
            .find(|one| one["name"] == *name)
            .cloned()
            .unwrap_or_default()
    };
    assert_eq!(named("command_interfaces", "head_pan/position")["is_claimed"], true);
    assert_eq!(named("command_interfaces", "l_knee/position")["is_claimed"], false);
    assert_eq!(named("state_interfaces", "head_pan/position")["is_available"], true);

    let topic = "/dynamic_joint_states";
    cyclone.ask(json!({"do": "subscribe", "topic": topic, "type": "control_msgs/msg/DynamicJointState"}));
    let mut dynamic = Value::Null;
    wait_until("states by interfaces arrive", || {
        let heard = cyclone.ask(json!({"do": "take", "topic": topic}));
        dynamic = heard.as_array().unwrap().last().map(|heard| heard["fields"].clone()).unwrap_or_default();
        !dynamic.is_null()
    });
    let joints = dynamic["joint_names"].as_array().unwrap();
    let pan = joints.iter().position(|joint| *joint == "head_pan").unwrap();
    let measured = &dynamic["interface_values"][pan];
    let [names, values] = ["interface_names", "values"].map(|key| measured[key].as_array().unwrap());
    assert_eq!((joints.len(), names.len()), (20, values.len()), "{measured}");
    // Those that the hardware says it has.
    let available = |interface: &str| {
        let mut states = interfaces["state_interfaces"].as_array().unwrap().iter();
        states.any(|one| one["name"] == format!("head_pan/{interface}"))
    };
    assert!(names.iter().all(|name| available(name.as_str().unwrap())), "{names:?}");
    assert_eq!(names[0], "position");
    assert!(values[0].as_f64().unwrap().abs() < 0.5, "{values:?}");

    // The rest with our own calls.
    let call = |service: &str, request: &str| {
        let words = service.split('_').map(|word| word[..1].to_uppercase() + &word[1..]);
        let kind = format!("controller_manager_msgs/srv/{}", words.collect::<String>());
        let (name, domain) = (format!("/controller_manager/{service}"), domain.to_string());
        let printed = common::text_of(&["service", "call", &name, &kind, request, "--domain", &domain]);
        printed.split_once("response:").unwrap().1.to_lowercase()
    };
    let types = call("list_controller_types", "{}");
    assert!(types.contains("forward_command_controller/forwardcommandcontroller"), "{types}");
    assert!(call("unload_controller", "{name: head_controller}").contains("false"), "it is active");
    assert!(call("unload_controller", "{name: head_by_hand}").contains("true"));
    assert!(!call("list_controllers", "{}").contains("head_by_hand"));
    assert!(call("load_controller", "{name: head_by_hand}").contains("true"));
    assert!(call("load_controller", "{name: head_by_hand}").contains("false"), "it is loaded");
    assert!(call("configure_controller", "{name: head_by_hand}").contains("true"));
    let state =
        call("set_hardware_component_state", "{name: hardware, target_state: {id: 2, label: inactive}}");
    assert!(state.contains("true") && state.contains("inactive"), "{state}");
    assert!(call("list_hardware_components", "{}").contains("downbeat/darwin_op"));
    program.interrupt();
}

#[test]
fn a_head_follows_the_trajectory_of_rclpy_and_the_goal_of_an_action() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let _check = check("Topics", "a joint trajectory for a controller of ours", With::Rclpy, Way::In);
    let _check2 = check("Topics", "the state of a joint trajectory controller", With::Cyclone, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let (robot, link) = (folder.path().join("head.toml"), folder.path().join("head"));
    std::fs::write(&robot, ROBOT.replace("LINK", link.to_str().unwrap())).unwrap();
    let mut program = Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain.to_string()]);

    let state = "/head_controller/controller_state";
    cyclone.ask(
        json!({"do": "subscribe", "topic": state, "type": "control_msgs/msg/JointTrajectoryControllerState"}),
    );
    let mut position_of_pan = |bound: &dyn Fn(f64) -> bool| {
        let mut last = Value::Null;
        wait_until("the state shows the head at its goal", || {
            for heard in cyclone.ask(json!({"do": "take", "topic": state})).as_array().unwrap() {
                last = heard["fields"].clone();
            }
            last["feedback"]["positions"][0].as_f64().is_some_and(bound)
        });
        last
    };
    let known = position_of_pan(&|position| position.abs() < 3.0);
    assert_eq!(known["joint_names"], json!(["head_pan", "head_tilt"]));

    let topic = "/head_controller/joint_trajectory";
    rclpy.ask(json!({"do": "advertise", "topic": topic, "type": "trajectory_msgs/msg/JointTrajectory"}));
    wait_until("rclpy has found the controller", || {
        rclpy.ask(json!({"do": "matched", "topic": topic})).as_u64().is_some_and(|count| count > 0)
    });
    let point = |seconds: i32, pan: f64| json!({"positions": [pan, 0.0], "velocities": [0.0, 0.0], "time_from_start": {"sec": seconds, "nanosec": 0}});
    let fields = json!({"joint_names": ["head_pan", "head_tilt"], "points": [point(1, 0.25), point(2, 0.5)]});
    rclpy.ask(json!({"do": "publish", "topic": topic, "fields": fields}));
    let reached = position_of_pan(&|position| (position - 0.5).abs() < 0.02);
    let reference = reached["reference"]["positions"][0].as_f64().unwrap();
    assert!((reference - 0.5).abs() < 0.05, "{reference}");

    let options =
        ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain) };
    let participant = Participant::join(&options).unwrap();
    let node = participant.create_node(NodeName::new("/", "client").unwrap()).unwrap();
    let part = |name: &str| format!("/head_controller/follow_joint_trajectory/_action/{name}");
    let goals: Client<FollowJointTrajectorySendGoal> =
        node.client(&part("send_goal"), QosProfile::SERVICES).unwrap();
    let results: Client<FollowJointTrajectoryGetResult> =
        node.client(&part("get_result"), QosProfile::SERVICES).unwrap();
    assert!(goals.wait_for_service(WATCHDOG) && results.wait_for_service(WATCHDOG));
    let goal_id = UUID { uuid: [5; 16] };
    let point = JointTrajectoryPoint {
        positions: vec![-0.3, 0.1],
        time_from_start: DurationMessage { sec: 1, nanosec: 0 },
        ..JointTrajectoryPoint::default()
    };
    let joint_names = vec!["head_pan".into(), "head_tilt".into()];
    let trajectory = JointTrajectory { joint_names, points: vec![point], ..JointTrajectory::default() };
    let goal = FollowJointTrajectoryGoal { trajectory, ..FollowJointTrajectoryGoal::default() };
    let request = FollowJointTrajectorySendGoalRequest { goal_id, goal };
    assert!(goals.call_and_wait(&request, WATCHDOG).unwrap().accepted);
    let request = FollowJointTrajectoryGetResultRequest { goal_id };
    let response = results.call_and_wait(&request, WATCHDOG).unwrap();
    assert_eq!((response.status, response.result.error_code), (GoalStatus::STATUS_SUCCEEDED, 0));
    position_of_pan(&|position| (position + 0.3).abs() < 0.02);
    program.interrupt();
    cyclone.leave();
    rclpy.leave();
}

/// Types the page for users of ros2_control, in an empty folder.
#[test]
fn a_urdf_of_ros2_control_leads_to_a_trajectory() {
    let page = include_str!("../docs/ros2_control.md");
    let blocks = |language: &str| -> Vec<&str> {
        let start = format!("```{language}\n");
        page.split(&*start).skip(1).map(|block| block.split("```").next().unwrap()).collect()
    };
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("arm.urdf"), blocks("xml")[0]).unwrap();
    std::fs::write(folder.path().join("robot.toml"), blocks("toml")[0]).unwrap();
    let domain = free_domain().to_string();
    let [run, asked] = blocks("sh")[..] else { panic!("other commands") };
    let command = |line: &str| {
        let mut parts = line.split('"');
        let words = parts.next().unwrap().split_whitespace().skip(1).chain(parts.next());
        let mut command = common::downbeat(&words.collect::<Vec<_>>());
        command.current_dir(folder.path()).env("ROS_DOMAIN_ID", &domain);
        command
    };
    let types = |line: &str| {
        let output = command(line).output().unwrap();
        let printed = [output.stdout, output.stderr].map(|bytes| String::from_utf8(bytes).unwrap()).concat();
        assert!(output.status.success(), "{line}\n{printed}");
        printed
    };
    let mut robot = Running::start_by(&mut command(run.trim()));
    robot.wait_for_output("exposed controllers: /controller_manager");
    let are_at = |expected: [f64; 2]| {
        let state = types("ros2 topic echo --once --field position /joint_states sensor_msgs/msg/JointState");
        let angles: Vec<f64> = state
            .split(|letter: char| !(letter.is_ascii_digit() || "-.e".contains(letter)))
            .filter_map(|word| word.parse().ok())
            .collect();
        angles.len() == 2
            && angles.iter().zip(expected).all(|(angle, expected)| (angle - expected).abs() < 0.02)
    };
    wait_until("the joints are measured", || are_at([0.0, 0.0]));
    let [controllers, components, trajectory, switch, by_hand] = asked.lines().collect::<Vec<_>>()[..] else {
        panic!("{asked}")
    };
    let listed = types(controllers);
    for named in
        ["arm_controller", "joint_trajectory_controller/JointTrajectoryController", "position_controller"]
    {
        assert!(listed.contains(named), "{named}\n{listed}");
    }
    assert!(types(components).contains("hardware"));
    let done = types(trajectory);
    assert!(done.contains("SUCCEEDED"), "{done}");
    wait_until("the arm is at the end of the trajectory", || are_at([0.3, 0.2]));
    let switched = types(switch);
    assert!(switched.contains("ok=True") || switched.contains("ok: true"), "{switched}");
    types(by_hand);
    wait_until("the other controller moves it", || are_at([-0.2, 0.1]));
    robot.interrupt();
}
