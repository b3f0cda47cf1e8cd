//! What viewers see.

use crate::support::{Frame, Viewer, joint_state, open, robot, until};
use downbeat_edge::{Interfaces, KnownType};
use downbeat_executor::{Core, ManualClock, Module, ModuleOptions, Setup, SetupError, Time};
use downbeat_msgs::cdr;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType};
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_view::{Access, ViewOptions, ViewServer, ViewTime};
use serde_json::json;
use std::time::Duration;

#[test]
fn a_viewer_sees_the_topics_with_their_definitions() {
    let robot = robot(|_| ());
    let viewer = robot.spectator();
    assert_eq!(viewer.info["op"], "serverInfo");
    assert_eq!(viewer.info["name"], "test robot");
    assert_eq!(viewer.info["metadata"]["ROS_DISTRO"], "jazzy");
    let channel = viewer.channel("/joint_states");
    assert_eq!(channel["encoding"], "cdr");
    assert_eq!(channel["schemaEncoding"], "ros2msg");
    assert_eq!(channel["schemaName"], "sensor_msgs/msg/JointState");
    assert_eq!(channel["schema"], KnownType::of::<JointState>().definition());
}

#[test]
fn both_names_of_the_protocol_are_accepted_and_others_are_not() {
    let robot = robot(|_| ());
    for protocol in ["foxglove.websocket.v1", "foxglove.sdk.v1"] {
        open(robot.address(), "/", protocol).unwrap();
    }
    assert!(open(robot.address(), "/", "chat").unwrap_err().contains("400"));
}

#[test]
fn messages_leave_the_core_only_while_somebody_subscribes() {
    let robot = robot(|options| options.latched.clear());
    let mut viewer = robot.spectator();
    assert_eq!(robot.outlets(), 0);
    viewer.subscribe(5, "/joint_states");
    viewer.subscribe(6, "/joint_states");
    assert_eq!(robot.outlets(), 1);
    robot.move_to(0.25);
    for id in [5, 6] {
        let (subscription, time, bytes) = viewer.message();
        assert_eq!(subscription, id);
        assert!(time > 0);
        assert_eq!(bytes, cdr::to_vec(&joint_state(0.25)));
    }
    viewer.send(json!({ "op": "unsubscribe", "subscriptionIds": [5] }));
    viewer.settle();
    robot.move_to(0.5);
    assert_eq!(viewer.message().0, 6);
    viewer.send(json!({ "op": "unsubscribe", "subscriptionIds": [6] }));
    viewer.settle();
    until(|| (robot.outlets() == 0).then_some(()));
    viewer.subscribe(7, "/joint_states");
    assert_eq!(robot.outlets(), 1);
    drop(viewer);
    until(|| (robot.outlets() == 0).then_some(()));
}

#[test]
fn a_message_is_decoded_with_the_schema_that_was_sent() {
    let robot = robot(|_| ());
    let mut viewer = robot.spectator();
    let channel = viewer.channel("/joint_states");
    let text = |key: &str| channel[key].as_str().unwrap();
    let schema =
        DynamicType::from_definition_text(text("schemaName"), text("schemaEncoding"), text("schema"))
            .unwrap();
    viewer.subscribe(1, "/joint_states");
    robot.move_to(0.75);
    let message = DynamicMessage::from_cdr(&schema, &viewer.message().2).unwrap();
    assert_eq!(message.get("position[0]").unwrap().as_f64(), Some(0.75));
}

#[test]
fn a_late_viewer_receives_the_last_message_of_a_latched_topic() {
    let robot = robot(|_| ());
    for urdf in ["<old/>", "<robot/>"] {
        robot.description.publish(Text { data: urdf.into() }).unwrap();
    }
    let mut first = robot.spectator();
    first.subscribe(1, "/robot_description");
    let robot_text = cdr::to_vec(&Text { data: "<robot/>".into() });
    while first.message().2 != robot_text {}
    let mut second = robot.spectator();
    second.subscribe(1, "/robot_description");
    assert_eq!(second.message().2, robot_text);
}

/// Publishes `imu`.
struct Gyroscope;

impl Module for Gyroscope {
    type Ports = ();

    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        setup.publish::<Imu>("imu").map(drop)
    }
}

#[test]
fn topics_that_come_and_go_are_announced() {
    let robot = robot(|_| ());
    let mut viewer = robot.spectator();
    drop(robot.core.add("gyroscope", Gyroscope, ModuleOptions::default()));
    let added = viewer.json("advertise");
    assert_eq!(added["channels"][0]["topic"], "/imu");
    // A second viewer sees it from the start.
    assert_eq!(robot.spectator().channel("/imu")["id"], added["channels"][0]["id"]);
}

#[test]
fn topics_that_are_not_chosen_are_not_shown() {
    let robot = robot(|options| options.topics = std::sync::Arc::new(|topic| topic != "joint_states"));
    let viewer = robot.spectator();
    assert!(viewer.channels.iter().all(|channel| channel["topic"] != "/joint_states"));
    assert!(viewer.channels.iter().any(|channel| channel["topic"] == "/cmd_vel"));
}

#[test]
fn a_viewer_sees_the_graph_of_modules_and_its_changes() {
    let robot = robot(|_| ());
    let mut viewer = robot.spectator();
    viewer.send(json!({ "op": "subscribeConnectionGraph" }));
    let graph = viewer.json("connectionGraphUpdate");
    let entry = json!({ "name": "/cmd_vel", "subscriberIds": ["legs"] });
    assert!(graph["subscribedTopics"].as_array().unwrap().contains(&entry), "{graph}");
    assert_eq!(graph["advertisedServices"], json!([{ "name": "/stand", "providerIds": ["legs"] }]));
    drop(robot.core.add("gyroscope", Gyroscope, ModuleOptions::default()));
    let graph = viewer.json("connectionGraphUpdate");
    assert_eq!(graph["publishedTopics"], json!([{ "name": "/imu", "publisherIds": ["gyroscope"] }]));
}

#[test]
fn files_of_known_packages_are_sent_and_others_are_not() {
    let robot = robot(|_| ());
    std::fs::write(robot.folder.path().join("large.stl"), vec![7; 300_000]).unwrap();
    let mut viewer = robot.spectator();
    let mut fetch = |uri: &str| {
        viewer.send(json!({ "op": "fetchAsset", "uri": uri, "requestId": 3 }));
        viewer.binary(4)
    };
    assert_eq!(fetch("package://robot/arm.stl"), b"\x03\0\0\0\0\0\0\0\0solid arm");
    assert_eq!(fetch("package://robot/large.stl").len(), 9 + 300_000);
    for wrong in [
        "package://robot/../../etc/passwd",
        "package://robot/notes.txt",
        "file:///etc/passwd",
        "package://robot/no.stl",
    ] {
        let answer = fetch(wrong);
        assert_eq!(answer[..5], [3, 0, 0, 0, 1]);
        assert!(String::from_utf8_lossy(&answer[9..]).contains(wrong));
    }
}

#[test]
fn the_time_of_a_simulated_robot_is_the_time_of_its_viewers() {
    let clock = ManualClock::new(Time::from_nanos(1_000_000_000));
    let mut core = Core::new().with_clock(clock.clone());
    let mut options = ViewOptions::new("simulated").unwrap();
    (options.foxglove, options.time) = (Some(0), ViewTime::Core);
    let server = ViewServer::start(&mut core, &Interfaces::carried(), options).unwrap();
    let mut viewer = Viewer::connect(server.foxglove_address().unwrap(), "/").unwrap();
    assert!(viewer.info["capabilities"].as_array().unwrap().contains(&json!("time")));
    let time = |viewer: &mut Viewer| u64::from_le_bytes(viewer.binary(2).try_into().unwrap());
    assert_eq!(time(&mut viewer), 1_000_000_000);
    clock.advance(Duration::from_secs(2));
    assert_eq!(time(&mut viewer), 3_000_000_000);
}

#[test]
fn viewers_are_told_when_the_robot_stops() {
    let mut robot = robot(|options| options.access = Access::Open);
    let mut viewer = robot.spectator();
    viewer.subscribe(1, "/joint_states");
    robot.move_to(1.0);
    let is_message = |frame: &Frame| matches!(frame, Frame::Binary(_));
    viewer.wait_for(is_message);
    robot.server = None;
    assert_eq!(viewer.ended(), Some(1001));
}
