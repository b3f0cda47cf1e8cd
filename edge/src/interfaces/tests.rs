//! What a registry answers.
#![allow(clippy::unwrap_used)]
use super::*;
use downbeat_msgs::sensor_msgs::msg::{Imu, JointState};

/// What another crate would generate of the same definition.
#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "std_msgs/msg/Bool")]
struct Bool {
    data: bool,
}

#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "std_msgs/msg/Int8")]
struct WideInt8 {
    data: i16,
}

#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "my_msgs/msg/Tilt")]
struct Tilt {
    angle: f64,
}

#[derive(Clone, Debug, Default, PartialEq, Message)]
#[message(name = "my_msgs/msg/Tilt")]
struct WideTilt {
    angle: [f64; 2],
}

#[test]
fn a_type_is_found_by_its_ros_name_and_by_its_rust_type() {
    let interfaces = Interfaces::carried();
    let imu = interfaces.message("sensor_msgs/msg/Imu").unwrap();
    assert_eq!(imu.rust_type(), TypeId::of::<Imu>());
    assert_eq!((imu.hash(), imu.definition()), (Imu::TYPE_HASH, Imu::DEFINITION));
    let joint_state = interfaces.message_of(TypeId::of::<JointState>()).unwrap();
    assert_eq!(joint_state.name(), "sensor_msgs/msg/JointState");
    assert_eq!(interfaces.message_of(TypeId::of::<String>()), None);
}

#[test]
fn every_type_that_is_carried_is_registered() {
    let names: Vec<_> = Interfaces::carried().messages().map(KnownType::name).collect();
    let mut carried = downbeat_msgs::TYPE_NAMES.to_vec();
    carried.sort_unstable();
    assert_eq!(names, carried);
}

#[test]
fn a_name_that_is_not_known_is_answered_with_the_nearest() {
    let interfaces = Interfaces::carried().with(Tilt::INTERFACES).unwrap();
    for (wrong, meant) in [
        ("sensor_msgs/Imu", "sensor_msgs/msg/Imu"),
        ("sensor_msgs/msg/JointStates", "sensor_msgs/msg/JointState"),
        ("std_msgs/msg/Strnig", "std_msgs/msg/String"),
        ("JointState", "sensor_msgs/msg/JointState"),
        ("geometry_msgs/msg/twist", "geometry_msgs/msg/Twist"),
        ("my_msgs/Tilt", "my_msgs/msg/Tilt"),
    ] {
        let error = interfaces.message(wrong).unwrap_err();
        assert_eq!(error.nearest, Some(meant));
        assert_eq!(error.to_string(), format!("unknown message type {wrong:?}, did you mean {meant:?}?"));
    }
    assert_eq!(interfaces.service("std_srvs/srv/SetBool").unwrap().name(), "std_srvs/srv/SetBool");
    let error = interfaces.service("std_srvs/SetBool").unwrap_err();
    assert_eq!(
        error.to_string(),
        "unknown service type \"std_srvs/SetBool\", did you mean \"std_srvs/srv/SetBool\"?"
    );
    let error = interfaces.action("tf2_msgs/LookupTransform").unwrap_err();
    assert_eq!(error.nearest, Some("tf2_msgs/action/LookupTransform"));
}

#[test]
fn the_same_definition_in_another_rust_type_is_the_same_type() {
    let interfaces = Interfaces::carried().with(Bool::INTERFACES).unwrap();
    let carried = interfaces.message("std_msgs/msg/Bool").unwrap();
    let other = interfaces.message_of(TypeId::of::<Bool>()).unwrap();
    assert_eq!(carried, other);
    assert_eq!(carried.rust_type(), TypeId::of::<downbeat_msgs::std_msgs::msg::Bool>());
    assert_eq!(other.rust_type(), TypeId::of::<Bool>());
    assert_eq!(interfaces.messages().count(), Interfaces::carried().messages().count());
}

#[test]
fn another_version_is_found_by_its_rust_type_and_its_hash_alone() {
    let interfaces = Interfaces::carried().with_other_version(WideInt8::INTERFACES);
    let known = interfaces.message("std_msgs/msg/Int8").unwrap();
    assert_eq!(known.hash(), downbeat_msgs::std_msgs::msg::Int8::TYPE_HASH);
    let other = interfaces.message_of(TypeId::of::<WideInt8>()).unwrap();
    assert_eq!(other.hash(), WideInt8::TYPE_HASH);
    assert_eq!(interfaces.described(WideInt8::TYPE_HASH).unwrap().type_name, "std_msgs/msg/Int8");
    assert_eq!(interfaces.registered().count(), 0, "the name stands for the carried one");
    let mine = Interfaces::carried().with(Tilt::INTERFACES).unwrap().with_other_version(WideTilt::INTERFACES);
    let registered: Vec<_> = mine.registered().map(|description| description.definition).collect();
    assert_eq!(registered, [Tilt::DEFINITION]);
    assert_eq!(interfaces.messages().count(), Interfaces::carried().messages().count());
}

#[test]
fn an_inlet_takes_the_rust_type_that_its_topic_carries() {
    let interfaces = Interfaces::carried().with(Bool::INTERFACES).unwrap();
    let carried = interfaces.message("std_msgs/msg/Bool").unwrap();
    let mut core = Core::new();
    core.inlet::<Bool>("theirs").unwrap();
    core.inlet::<Imu>("imu").unwrap();
    for topic in ["theirs", "/theirs", "ours"] {
        let inlet = interfaces.inlet(&mut core, topic, carried).unwrap();
        inlet.publish(&carried.default_cdr()).unwrap();
    }
    let error = interfaces.inlet(&mut core, "imu", carried).unwrap_err().to_string();
    assert!(error.contains("imu"), "the topic carries another message: {error}");
}

#[test]
fn another_definition_of_a_name_is_refused_with_both_hashes() {
    let conflict = Interfaces::carried().with((Tilt::INTERFACES, WideInt8::INTERFACES)).unwrap_err();
    let carried = downbeat_msgs::std_msgs::msg::Int8::TYPE_HASH;
    assert_eq!(
        conflict,
        InterfaceConflict { name: "std_msgs/msg/Int8", known: carried, other: WideInt8::TYPE_HASH }
    );
    let text = conflict.to_string();
    assert!(
        text.contains(carried) && text.contains(WideInt8::TYPE_HASH) && text.contains("rename"),
        "{text}"
    );
}

#[test]
fn a_set_that_is_registered_twice_is_registered_once() {
    let once = Interfaces::carried().with(Tilt::INTERFACES).unwrap();
    let twice = once.with((Tilt::INTERFACES, Tilt::INTERFACES)).unwrap();
    assert!(once.messages().eq(twice.messages()));
}
