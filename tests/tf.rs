//! Transforms with a peer on Cyclone DDS (the wheels of rclpy have no `tf2_msgs`): transforms of the peer are
//! in the buffer of a module, those of a module arrive at the peer, and a robot answers lookups.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::time::Duration;

use common::matrix::{Way, With, check};
use common::rclpy::Peer;
use common::{Running, WATCHDOG, wait_until};
use downbeat::bridge::edge::Interfaces;
use downbeat::bridge::expose::{Exposure, expose};
use downbeat::bridge::middleware::{Direction, DiscoveryRange, ParticipantOptions};
use downbeat::bridge::ros::{Client, NodeName, Participant};
use downbeat::executor::{Context, Core, Module, ModuleOptions, Setup, SetupError, TransitionError};
use downbeat::modules::transforms::{At, TransformBroadcaster, TransformBuffer, listen};
use downbeat::msgs::Action;
use downbeat::msgs::action_msgs::msg::GoalStatus;
use downbeat::msgs::builtin_interfaces::msg::Duration as DurationMessage;
use downbeat::msgs::geometry_msgs::msg::TransformStamped;
use downbeat::msgs::qos::QosProfile;
use downbeat::msgs::tf2_msgs::action::{
    LookupTransform, LookupTransformGetResult, LookupTransformGetResultRequest, LookupTransformGoal,
    LookupTransformSendGoal, LookupTransformSendGoalRequest,
};
use downbeat::msgs::tf2_msgs::msg::TF2Error;
use downbeat::msgs::unique_identifier_msgs::msg::UUID;
use serde_json::{Value, json};
use test_machine::free_domain;

/// Looks up the pose of the camera in the map.
#[derive(Default)]
struct Finder {
    transforms: TransformBuffer,
}

/// Publishes the pose of the camera and of its parts.
struct Broadcaster;

fn transform(parent: &str, child: &str, x: f64) -> TransformStamped {
    let mut transform = TransformStamped { child_frame_id: child.into(), ..TransformStamped::default() };
    transform.header.frame_id = parent.into();
    transform.transform.translation.x = x;
    transform
}

impl Module for Finder {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        listen(setup, |finder| &mut finder.transforms)?;
        let seen = setup.publish("seen")?;
        setup.every(Duration::from_millis(20), move |finder: &mut Self, ctx| {
            let Ok(found) = finder.transforms.lookup("map", "camera", At::Latest) else { return };
            let mut transform = transform("map", "camera_seen", found.target_from_source.translation.x);
            transform.header.stamp.sec = i32::try_from(found.time.as_nanos() / 1_000_000_000).unwrap();
            ctx.publish(seen, transform);
        })
    }
}

impl Module for Broadcaster {
    type Ports = TransformBroadcaster;

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<Self::Ports, SetupError> {
        setup.subscribe::<TransformStamped, _>("seen", |_, seen, ctx| ctx.ports.send(ctx, [seen.clone()]))?;
        TransformBroadcaster::declare(setup)
    }

    fn activate(&mut self, ctx: &mut Context<'_, Self::Ports>) -> Result<(), TransitionError> {
        ctx.ports.send_static(ctx, [transform("camera", "lens", 0.02)]);
        ctx.ports.send_static(ctx, [transform("camera", "shutter", 0.01)]);
        Ok(())
    }
}

fn exposures() -> Vec<Exposure> {
    let kind = Interfaces::carried().message("tf2_msgs/msg/TFMessage").unwrap();
    let fixed = QosProfile::LATCHED.keep_last(100);
    let exposure = |topic: &str, ros_topic: &str, direction, qos: QosProfile| Exposure {
        ros_topic: Some(ros_topic.into()),
        qos: qos.into(),
        ..Exposure::new(topic, kind, direction)
    };
    vec![
        exposure("tf", "/tf", Direction::In, QosProfile::DEFAULT.keep_last(100)),
        exposure("tf_static", "/tf_static", Direction::In, fixed),
        exposure("own/tf", "/tf", Direction::Out, QosProfile::DEFAULT.keep_last(100)),
        exposure("own/tf_static", "/tf_static", Direction::Out, fixed),
    ]
}

fn message(parent: &str, child: &str, x: f64, seconds: i32) -> Value {
    json!({"transforms": [{
        "header": {"frame_id": parent, "stamp": {"sec": seconds}},
        "child_frame_id": child,
        "transform": {
            "translation": {"x": x, "y": 0.0, "z": 0.0},
            "rotation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
    }]})
}

#[test]
fn transforms_of_peer_are_looked_up_by_a_module_and_those_of_the_module_arrive() {
    let domain = free_domain();
    let Some(mut peer) = Peer::cyclonedds(domain) else { return };
    let _check = check("Topics", "/tf and /tf_static with the transform buffer", With::Cyclone, Way::In);
    let _check2 =
        check("Topics", "/tf and /tf_static of a broadcaster, for late joiners too", With::Cyclone, Way::Out);
    let kind = "tf2_msgs/msg/TFMessage";
    let fixed = json!({"depth": 100, "durability": "transient_local"});
    peer.ask(json!({"do": "advertise", "topic": "/tf_static", "type": kind, "qos": fixed}));
    // Before the robot starts, which receives it as a late joiner.
    peer.ask(
        json!({"do": "publish", "topic": "/tf_static", "fields": message("base_link", "camera", 0.25, 0)}),
    );
    peer.ask(json!({"do": "advertise", "topic": "/tf", "type": kind, "qos": {"depth": 100}}));
    peer.ask(json!({"do": "subscribe", "topic": "/tf", "type": kind, "qos": {"depth": 100}}));

    let mut core = Core::new();
    core.add("finder", Finder::default()).unwrap();
    let remaps = ["tf", "tf_static"].map(|topic| (topic.to_owned(), format!("own/{topic}")));
    let options = ModuleOptions { remaps: remaps.into(), ..ModuleOptions::default() };
    core.add_with("broadcaster", Broadcaster, options).unwrap();
    let options =
        ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain) };
    let participant = Participant::join(&options).unwrap();
    let node = participant.create_node(NodeName::new("/", "robot").unwrap()).unwrap();
    let _status = expose(&mut core, &node, &exposures()).unwrap();
    let handle = core.handle();
    let running = std::thread::spawn(move || core.run().unwrap());

    let mut seconds = 100;
    let mut seen = Value::Null;
    wait_until("the module has found the camera in the map", || {
        seconds += 1;
        let moving = message("map", "base_link", f64::from(seconds), seconds);
        peer.ask(json!({"do": "publish", "topic": "/tf", "fields": moving}));
        for heard in peer.ask(json!({"do": "take", "topic": "/tf"})).as_array().unwrap() {
            let transform = &heard["fields"]["transforms"][0];
            if transform["child_frame_id"] == "camera_seen" {
                seen = transform.clone();
            }
        }
        !seen.is_null()
    });
    let x = seen["transform"]["translation"]["x"].as_f64().unwrap();
    let at = seen["header"]["stamp"]["sec"].as_f64().unwrap();
    assert!(
        (x - (at + 0.25)).abs() < 1e-9,
        "the camera is 0.25 m in front of the base, whose pose is from the peer: {seen}"
    );

    peer.ask(json!({"do": "subscribe", "topic": "/tf_static", "type": kind, "qos": fixed}));
    let mut children = Vec::new();
    wait_until("the peer, a late joiner, has all static transforms", || {
        for heard in peer.ask(json!({"do": "take", "topic": "/tf_static"})).as_array().unwrap() {
            let transforms = heard["fields"]["transforms"].as_array().unwrap().clone();
            children.extend(transforms.into_iter().map(|transform| transform["child_frame_id"].clone()));
        }
        ["lens", "shutter"].iter().all(|child| children.contains(&json!(child)))
    });
    handle.stop();
    running.join().unwrap();
    peer.leave();
}

const LOOKUPS: &str = r#"
[robot]
name = "lookups"
[[module]]
kind = "transform_server"
[expose]
in = ["tf", { topic = "tf_static", qos = { preset = "latched", depth = 100 } }]
actions = ["tf2_buffer_server"]
"#;

#[test]
fn a_robot_serves_an_action_that_looks_up_transforms() {
    let domain = free_domain();
    let Some(mut rclpy) = Peer::start(domain, "LOCALHOST") else { return };
    let Some(mut cyclone) = Peer::cyclonedds(domain) else { return };
    let _check = check("Actions", "actions in the robot file", With::Rclpy, Way::Out);
    let folder = tempfile::tempdir().unwrap();
    let robot = folder.path().join("lookups.toml");
    std::fs::write(&robot, LOOKUPS).unwrap();
    let mut program = Running::start(&["run", robot.to_str().unwrap(), "--domain", &domain.to_string()]);
    wait_until("rclpy lists the action", || {
        rclpy.ask(json!({"do": "actions"}))["/tf2_buffer_server"] == json!([LookupTransform::TYPE_NAME])
    });
    let kind = "tf2_msgs/msg/TFMessage";
    let fixed = json!({"depth": 100, "durability": "transient_local"});
    cyclone.ask(json!({"do": "advertise", "topic": "/tf_static", "type": kind, "qos": fixed}));
    let camera = message("base_link", "camera", 0.25, 0);
    cyclone.ask(json!({"do": "publish", "topic": "/tf_static", "fields": camera}));

    // The wheels of rclpy cannot send this goal.
    let options =
        ParticipantOptions { discovery_range: DiscoveryRange::Localhost, ..ParticipantOptions::new(domain) };
    let participant = Participant::join(&options).unwrap();
    let node = participant.create_node(NodeName::new("/", "client").unwrap()).unwrap();
    let part = |name: &str| format!("/tf2_buffer_server/_action/{name}");
    let goals: Client<LookupTransformSendGoal> =
        node.client(&part("send_goal"), QosProfile::SERVICES).unwrap();
    let results: Client<LookupTransformGetResult> =
        node.client(&part("get_result"), QosProfile::SERVICES).unwrap();
    assert!(goals.wait_for_service(WATCHDOG) && results.wait_for_service(WATCHDOG));
    let ask = |number: u8, source: &str, timeout_s| {
        let goal_id = UUID { uuid: [number; 16] };
        let goal = LookupTransformGoal {
            target_frame: "base_link".into(),
            source_frame: source.into(),
            timeout: DurationMessage { sec: timeout_s, nanosec: 0 },
            ..LookupTransformGoal::default()
        };
        let request = LookupTransformSendGoalRequest { goal_id, goal };
        assert!(goals.call_and_wait(&request, WATCHDOG).unwrap().accepted);
        let request = LookupTransformGetResultRequest { goal_id };
        results.call_and_wait(&request, WATCHDOG).unwrap()
    };
    let found = ask(1, "camera", 50);
    assert_eq!((found.status, found.result.error.error), (GoalStatus::STATUS_SUCCEEDED, TF2Error::NO_ERROR));
    assert_eq!(found.result.transform.transform.translation.x, 0.25);
    let missing = ask(2, "hand", 0);
    assert_eq!(missing.status, GoalStatus::STATUS_SUCCEEDED);
    let missing = missing.result.error;
    assert_eq!(missing.error, TF2Error::LOOKUP_ERROR);
    assert!(missing.error_string.contains("hand"), "{}", missing.error_string);
    program.interrupt();
    cyclone.leave();
    rclpy.leave();
}
