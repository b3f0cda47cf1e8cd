//! Settings of modules as parameters, seen by rclpy's parameter client, which is what `ros2 param` uses.
#![allow(clippy::unwrap_used)]

mod common;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{RunningCore, WATCHDOG, on_loopback, wait_until};
use downbeat_bridge::clock::{NodeClock, SimTime};
use downbeat_bridge::expose::{ParameterExposure, ParameterServer, ParameterServices, TopicPattern};
use downbeat_bridge::ros::{NodeName, Participant};
use downbeat_executor::{Core, Inbox, Module, ModuleOptions, Setup, SetupError, Synchrony};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::{Parameter, ParameterValue};
use downbeat_msgs::rcl_interfaces::srv::{
    GetParameters, GetParametersRequest, SetParameters, SetParametersRequest,
};
use serde_json::{Value, json};
use test_machine::free_domain;

struct Arm;

impl Module for Arm {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.setting_in("gain", 1.0, 0.0..=4.0, "of the joint controller, 1/s")?;
        setup.setting("hard", false, "does not give way")?;
        setup.setting_in("count", 3_i64, 1.0..=9.0, "of joints")?;
        setup.setting("name", "left".to_owned(), "of the side")?;
        setup.setting("limits", vec![-1.0, 1.0], "of a joint, rad")?;
        setup.setting("ids", vec![1_i64, 2], "on the bus")?;
        setup.setting("joints", vec!["a".to_owned()], "by name")?;
        setup.setting("mask", vec![true, false], "which joints give way")?;
        setup.setting("key", vec![0_u8, 255], "of the bus")?;
        Ok(())
    }
}

struct Robot {
    handle: RunningCore,
    sim_time: SimTime,
    _parameters: [ParameterServices; 2],
    _participant: Participant,
}

/// Modules `arm`, `camera` (detached) and `secret`, of which the last is not selected; a node `/robot`, and
/// `/arm` of that module alone.
fn robot(domain_id: u16) -> Robot {
    let clock = NodeClock::default();
    let mut core = Core::new().with_clock(clock.clone());
    core.add("arm", Arm).unwrap();
    let detached =
        ModuleOptions { synchrony: Synchrony::Detached(Inbox::KeepAll), ..ModuleOptions::default() };
    core.add_with("camera", Arm, detached).unwrap();
    core.add("secret", Arm).unwrap();
    let participant = Participant::join(&on_loopback(domain_id)).unwrap();
    let node = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let arm = participant.create_node(NodeName::new("/", "arm").unwrap()).unwrap();
    let settings: Vec<_> = ["arm.*", "camera.gain"].map(|pattern| TopicPattern::new(pattern).unwrap()).into();
    let handle = core.handle();
    let sim_time = clock.sim_time(&node, &handle);
    let server = ParameterServer::new(&core, Some(sim_time.clone()));
    let of_robot = ParameterExposure { settings: settings.clone(), of_module: None };
    let of_arm = ParameterExposure { settings, of_module: Some("arm".into()) };
    let parameters = [(&node, of_robot), (&arm, of_arm)];
    let parameters = parameters.map(|(node, exposure)| server.serve(node, exposure).unwrap());
    Robot { handle: RunningCore::start(core), sim_time, _parameters: parameters, _participant: participant }
}

const NAMES: [&str; 16] = [
    "arm.count",
    "arm.gain",
    "arm.hard",
    "arm.ids",
    "arm.joints",
    "arm.key",
    "arm.limits",
    "arm.mask",
    "arm.name",
    "camera.gain",
    "qos_overrides./parameter_events.publisher.depth",
    "qos_overrides./parameter_events.publisher.durability",
    "qos_overrides./parameter_events.publisher.history",
    "qos_overrides./parameter_events.publisher.reliability",
    "start_type_description_service",
    "use_sim_time",
];

fn ask(rclpy: &mut Peer, call: &str, argument: Value) -> Value {
    rclpy.ask(json!({"do": "parameters", "node": "/robot", "call": call, "argument": argument}))
}

#[test]
fn rclpy_lists_gets_and_describes_what_is_selected() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Parameters", "list, get, get types, describe", With::Rclpy, Way::In);
    let _robot = robot(domain);
    let listed = ask(&mut rclpy, "list_parameters", json!([]));
    assert_eq!(
        listed["result"],
        json!({"names": NAMES, "prefixes": ["arm", "camera", "qos_overrides./parameter_events.publisher"]})
    );
    let listed = ask(&mut rclpy, "list_parameters", json!(["camera"]));
    assert_eq!(listed["result"]["names"], json!(["camera.gain"]));

    let got = ask(&mut rclpy, "get_parameters", json!(NAMES));
    let values = got["values"].as_array().unwrap();
    let types = [2, 3, 1, 7, 9, 5, 8, 6, 4, 3, 2, 4, 4, 4, 1, 1];
    assert_eq!(values.iter().map(|value| value["type"].clone()).collect::<Vec<_>>(), types);
    assert_eq!(
        (&values[0]["integer_value"], &values[1]["double_value"], &values[2]["bool_value"]),
        (&json!(3), &json!(1.0), &json!(false))
    );
    assert_eq!(values[3]["integer_array_value"], json!([1, 2]));
    assert_eq!(values[4]["string_array_value"], json!(["a"]));
    // A byte is a list of one number to rclpy's fields.
    assert_eq!(values[5]["byte_array_value"], json!([[0], [255]]));
    assert_eq!(values[6]["double_array_value"], json!([-1.0, 1.0]));
    assert_eq!(values[7]["bool_array_value"], json!([true, false]));
    assert_eq!(values[8]["string_value"], "left");
    assert_eq!(
        (&values[10]["integer_value"], &values[13]["string_value"]),
        (&json!(1000), &json!("reliable"))
    );
    assert_eq!(ask(&mut rclpy, "get_parameter_types", json!(NAMES))["types"], json!(types));
    assert_eq!(ask(&mut rclpy, "get_parameters", json!(["secret.gain"]))["values"], json!([]));

    let described = ask(&mut rclpy, "describe_parameters", json!(["arm.gain", "arm.count", "use_sim_time"]));
    let described = described["descriptors"].as_array().unwrap();
    assert_eq!(described[0]["description"], "of the joint controller, 1/s");
    assert_eq!(
        described[0]["floating_point_range"],
        json!([{"from_value": 0.0, "to_value": 4.0, "step": 0.0}])
    );
    assert_eq!(described[1]["integer_range"], json!([{"from_value": 1, "to_value": 9, "step": 0}]));
    assert_eq!((&described[2]["type"], &described[2]["read_only"]), (&json!(1), &json!(false)));
}

#[test]
fn rclpy_sets_values_and_is_told_why_one_is_refused() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check =
        check("Parameters", "set and set atomically, refusals with their reason", With::Rclpy, Way::In);
    let robot = robot(domain);
    let set = |rclpy: &mut Peer, name: &str, value: Value| {
        let answer = ask(rclpy, "set_parameters", json!({name: value}));
        let result = &answer["results"][0];
        (result["successful"] == true, result["reason"].as_str().unwrap().to_owned())
    };
    let accepted = (true, String::new());
    for (name, value) in [
        ("arm.gain", json!(2.5)),
        ("camera.gain", json!(0.5)),
        ("arm.hard", json!(true)),
        ("arm.count", json!(9)),
        ("arm.name", json!("right")),
        ("arm.limits", json!([-0.5, 0.5])),
        ("arm.ids", json!([7, 8, 9])),
        ("arm.joints", json!(["x", "y"])),
        ("arm.mask", json!([false, true, true])),
        ("arm.key", json!([1, 2, 3])),
        ("arm.gain", json!(2)),
        ("use_sim_time", json!(false)),
    ] {
        assert_eq!(set(&mut rclpy, name, value), accepted, "{name}");
    }
    let value = |module: &str, setting: &str| {
        let settings = robot.handle.settings(module).wait(WATCHDOG).unwrap().unwrap();
        settings.into_iter().find(|info| info.name == setting).unwrap().value
    };
    assert_eq!((value("arm", "gain"), value("camera", "gain")), (2.0.into(), 0.5.into()));
    assert_eq!(value("arm", "joints"), vec!["x".to_owned(), "y".to_owned()].into());

    for (name, wrong, word) in [
        ("arm.gain", json!(4.5), "out of range"),
        ("camera.gain", json!(-1.0), "out of range"),
        ("arm.gain", json!("fast"), "is of type {double}, setting it to {string} is not allowed"),
        ("arm.hard", json!(1), "is of type {bool}, setting it to {integer} is not allowed"),
        ("secret.gain", json!(1.0), "was not declared"),
        ("start_type_description_service", json!(false), "read-only"),
        ("use_sim_time", json!("yes"), "is not allowed"),
        ("qos_overrides./parameter_events.publisher.depth", json!(1), "read-only"),
    ] {
        let (is_accepted, reason) = set(&mut rclpy, name, wrong);
        assert!(!is_accepted && reason.contains(word), "{name}: {reason}");
    }
    assert_eq!(value("arm", "gain"), 2.0.into());

    assert_eq!(value("arm", "key"), vec![1_u8, 2, 3].into());

    let atomically = json!({"arm.gain": 3.0, "camera.gain": 3.0, "use_sim_time": true, "arm.count": 99});
    let refused = ask(&mut rclpy, "set_parameters_atomically", atomically);
    assert_eq!(refused["result"]["successful"], false);
    assert!(refused["result"]["reason"].as_str().unwrap().contains("99"), "{refused}");
    assert_eq!((value("arm", "gain"), value("camera", "gain")), (2.0.into(), 0.5.into()));
    assert!(!robot.sim_time.is_on());
    let accepted = ask(&mut rclpy, "set_parameters_atomically", json!({"arm.gain": 3.0, "arm.count": 1}));
    assert_eq!(accepted["result"]["successful"], true);
    assert_eq!((value("arm", "gain"), value("arm", "count")), (3.0.into(), 1_i64.into()));
}

#[test]
fn changes_are_told_on_parameter_events_whoever_made_them() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Parameters", "/parameter_events", With::Rclpy, Way::Out);
    let topic = "/parameter_events";
    let (kind, qos) = ("rcl_interfaces/msg/ParameterEvent", json!({"depth": 1000}));
    rclpy.ask(json!({"do": "subscribe", "topic": topic, "type": kind, "qos": qos}));
    let robot = robot(domain);
    wait_until("rclpy hears the robot", || {
        let publishers = rclpy.ask(json!({"do": "publishers_of", "topic": topic}));
        publishers.as_array().unwrap().iter().any(|publisher| publisher["node"] == "/robot")
    });
    let mut changes = Vec::new();
    let mut wait_for = |rclpy: &mut Peer, gain: f64| {
        wait_until("the change is published", || {
            changes.extend(rclpy.ask(json!({"do": "take", "topic": topic})).as_array().unwrap().clone());
            changes.iter().any(|event: &Value| {
                let changed = &event["fields"]["changed_parameters"];
                event["fields"]["node"] == "/robot"
                    && changed[0]["name"] == "arm.gain"
                    && changed[0]["value"]["double_value"] == gain
            })
        });
    };
    ask(&mut rclpy, "set_parameters", json!({"arm.gain": 2.0}));
    wait_for(&mut rclpy, 2.0);
    robot.handle.set("arm", "gain", 0.25).wait(WATCHDOG).unwrap().unwrap();
    wait_for(&mut rclpy, 0.25);
}

#[test]
fn a_node_of_one_module_has_its_settings_by_their_own_names() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Parameters", "of each node of a process", With::Rclpy, Way::In);
    let robot = robot(domain);
    let mut ask = |call: &str, argument: Value| {
        rclpy.ask(json!({"do": "parameters", "node": "/arm", "call": call, "argument": argument}))
    };
    let listed = ask("list_parameters", json!([]));
    let names = listed["result"]["names"].as_array().unwrap();
    assert!(names.contains(&json!("gain")) && names.contains(&json!("use_sim_time")), "{names:?}");
    assert!(names.iter().all(|name| !name.as_str().unwrap().contains("arm.")), "{names:?}");
    assert_eq!(ask("set_parameters", json!({"gain": 1.5}))["results"][0]["successful"], true);
    let settings = robot.handle.settings("arm").wait(WATCHDOG).unwrap().unwrap();
    assert_eq!(settings[0].value, 1.5.into());
}

#[test]
fn a_node_that_is_told_to_use_sim_time_follows_the_clock_of_rclpy_until_it_is_told_not_to() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let _check = check("Parameters", "use_sim_time while it runs", With::Rclpy, Way::In);
    let robot = robot(domain);
    let own = robot.handle.snapshot().wait(WATCHDOG).unwrap().time;
    let set = |rclpy: &mut Peer, is_on: bool| {
        let answer = ask(rclpy, "set_parameters", json!({"use_sim_time": is_on}));
        assert_eq!(answer["results"][0], json!({"successful": true, "reason": ""}));
        assert_eq!(ask(rclpy, "get_parameters", json!(["use_sim_time"]))["values"][0]["bool_value"], is_on);
    };
    set(&mut rclpy, true);
    let overrides = ask(&mut rclpy, "list_parameters", json!(["qos_overrides./clock"]));
    assert_eq!(overrides["result"]["names"].as_array().unwrap().len(), 4);
    rclpy.ask(json!({"do": "advertise", "topic": "/clock", "type": "rosgraph_msgs/msg/Clock"}));
    let mut seconds = 0;
    wait_until("the core has the time of rclpy", || {
        seconds += 1;
        let fields = json!({"clock": {"sec": 5_000 + seconds, "nanosec": 0}});
        rclpy.ask(json!({"do": "publish", "topic": "/clock", "fields": fields}));
        let now = robot.handle.snapshot().wait(WATCHDOG).unwrap().time;
        (5_000..6_000).contains(&(now.as_nanos() / 1_000_000_000))
    });
    set(&mut rclpy, false);
    wait_until("the core has its own time again", || {
        robot.handle.snapshot().wait(WATCHDOG).unwrap().time >= own
    });
    let subscriptions = rclpy.ask(json!({"do": "subscriptions_of", "topic": "/clock"}));
    let of_robot = |info: &Value| info["node"] == "/robot";
    assert!(!subscriptions.as_array().unwrap().iter().any(of_robot), "{subscriptions}");
}

#[test]
fn a_refusal_does_not_repeat_the_whole_request() {
    let domain = free_domain();
    let _robot = robot(domain);
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let node = participant.create_node(NodeName::new("/", "asking").unwrap()).unwrap();
    let client = node.client::<SetParameters>("/robot/set_parameters", QosProfile::PARAMETERS).unwrap();
    assert!(client.wait_for_service(WATCHDOG));
    let set = |parameters: Vec<Parameter>| {
        client.call_and_wait(&SetParametersRequest { parameters }, WATCHDOG).unwrap().results
    };
    let value = |text: String| ParameterValue { r#type: 4, string_value: text, ..ParameterValue::default() };
    let long = || "n".repeat(50_000);
    let refused = set(vec![Parameter { name: long(), value: value("x".into()) }]);
    assert!(refused[0].reason.starts_with("parameter 'nnnn") && refused[0].reason.ends_with('…'));
    assert!(refused[0].reason.len() <= 500, "{}", refused[0].reason.len());
    let refused = set(vec![Parameter { name: "use_sim_time".into(), value: value(long()) }]);
    assert!(refused[0].reason.len() <= 500, "{}", refused[0].reason.len());
    let many = (0..1000).map(|n| Parameter { name: format!("unknown_{n:030}"), value: value(String::new()) });
    let refused = set(many.collect());
    assert!(refused.len() == 1000 && refused.iter().all(|result| !result.successful));
    assert!(refused.iter().map(|result| result.reason.len()).sum::<usize>() <= 50_000);
}

#[test]
fn a_value_too_long_to_be_given_back_is_refused_and_said_to_be() {
    let domain = free_domain();
    let robot = robot(domain);
    let participant = Participant::join(&on_loopback(domain)).unwrap();
    let node = participant.create_node(NodeName::new("/", "asking").unwrap()).unwrap();
    let set = node.client::<SetParameters>("/robot/set_parameters", QosProfile::PARAMETERS).unwrap();
    let get = node.client::<GetParameters>("/robot/get_parameters", QosProfile::PARAMETERS).unwrap();
    assert!(set.wait_for_service(WATCHDOG) && get.wait_for_service(WATCHDOG));
    let value =
        ParameterValue { r#type: 4, string_value: "y".repeat(3_000_000), ..ParameterValue::default() };
    let parameters = vec![Parameter { name: "arm.name".into(), value }];
    let refused = set.call_and_wait(&SetParametersRequest { parameters }, WATCHDOG).unwrap().results;
    assert!(refused[0].reason.contains("at most 1000000"), "{}", refused[0].reason);
    let given = |name: &str| {
        let request = GetParametersRequest { names: vec![name.to_owned()] };
        get.call_and_wait(&request, WATCHDOG).unwrap().values
    };
    assert_eq!(given("arm.name")[0].string_value, "left");
    // A program may set what it likes.
    robot.handle.set("arm", "name", "y".repeat(3_000_000)).wait(WATCHDOG).unwrap().unwrap();
    assert!(given("arm.name").is_empty());
    assert_eq!(given("arm.count")[0].integer_value, 3);
}
