//! Compiled messages and dynamic messages agree.

use downbeat_msgs::dynamic::{ConvertError, DynamicMessage, DynamicType};
use downbeat_msgs::std_msgs::msg::Header;
use downbeat_msgs::{Message, cdr, geometry_msgs, sensor_msgs};
use proptest::prelude::*;
use serde::de::DeserializeOwned;

use crate::random::Random;

/// Random values of each type.
const VALUES: usize = 40;

fn random_value<T: Message + DeserializeOwned>(random: &mut Random) -> (T, Vec<u8>) {
    // Serde does not check the bounds of sequences, but our reader does.
    let values = std::iter::repeat_with(|| random.value::<T>());
    let mut values = values.map(|value| (cdr::to_vec(&value), value)).take(1000);
    let (bytes, value) = values.find(|(bytes, _)| cdr::from_slice::<T>(bytes).is_ok()).unwrap();
    (value, bytes)
}

fn check<T: Message + DeserializeOwned>(random: &mut Random) {
    let of = DynamicType::of::<T>().unwrap_or_else(|error| panic!("{}: {error}", T::TYPE_NAME));
    assert_eq!(of.name().to_string(), T::TYPE_NAME);
    assert_eq!(DynamicMessage::new(&of).to_cdr(), cdr::to_vec(&T::default()), "{}", T::TYPE_NAME);
    let mut buffer = vec![7; 3];
    for _ in 0..VALUES {
        let (value, bytes) = random_value::<T>(random);
        let message = DynamicMessage::from_cdr(&of, &bytes).unwrap();
        message.to_cdr_buffer(&mut buffer);
        assert_eq!(buffer, bytes, "{value:?}");
        let typed: T = message.to_typed().unwrap();
        assert_eq!(cdr::to_vec(&typed), bytes, "{value:?}");
        // Both report truncated input at the same field.
        for length in [0, 3, 4, bytes.len() / 2, bytes.len() - 1] {
            let (ours, theirs) =
                (DynamicMessage::from_cdr(&of, &bytes[..length]), cdr::from_slice::<T>(&bytes[..length]));
            match (ours, theirs) {
                (Ok(ours), Ok(theirs)) => assert_eq!(ours.to_cdr(), cdr::to_vec(&theirs)),
                // One of them may also name the element.
                (Err(ours), Err(theirs)) => assert!(theirs.path.starts_with(&ours.path), "{ours} {theirs}"),
                different => panic!("{different:?}"),
            }
        }
    }
}

#[test]
fn every_dynamic_message_has_the_bytes_of_its_struct() {
    let mut random = Random::new(0xd1a);
    let mut count = 0;
    macro_rules! check_each {
        ($($message:ty),* $(,)?) => { $(check::<$message>(&mut random); count += 1;)* };
    }
    downbeat_msgs::for_each_message!(check_each);
    assert!(count > 100);
}

#[test]
fn a_message_is_formatted_like_the_struct() {
    let mut joints = sensor_msgs::msg::JointState { name: vec!["a".into()], ..Default::default() };
    joints.header.frame_id = "body".into();
    joints.position = vec![0.5];
    let of = DynamicType::of::<sensor_msgs::msg::JointState>().unwrap();
    let dynamic = DynamicMessage::from_typed(&of, &joints).unwrap();
    assert_eq!(
        format!("{dynamic:?}"),
        "sensor_msgs/msg/JointState { header: std_msgs/msg/Header { stamp: builtin_interfaces/msg/Time \
         { sec: 0, nanosec: 0 }, frame_id: \"body\" }, name: [\"a\"], position: [0.5], velocity: [], effort: [] }"
    );
}

#[test]
fn messages_are_equal_if_types_and_values_are() {
    let of = DynamicType::of::<Header>().unwrap();
    let again = DynamicType::of::<Header>().unwrap();
    assert_eq!(of, again);
    let mut header = DynamicMessage::new(&of);
    assert_eq!(header, DynamicMessage::new(&again));
    header.set("stamp.sec", 1).unwrap();
    assert_ne!(header, DynamicMessage::new(&again));
    let other = DynamicType::from_definition_text("std_msgs/msg/Header", "ros2msg", "int32 a\n").unwrap();
    assert_ne!(of, other);
}

#[test]
fn a_struct_of_another_type_is_refused() {
    let of = DynamicType::of::<Header>().unwrap();
    let error = DynamicMessage::from_typed(&of, &geometry_msgs::msg::Twist::default()).unwrap_err();
    assert_eq!(error.to_string(), "cannot convert between std_msgs/msg/Header and geometry_msgs/msg/Twist");
    let other = DynamicType::from_definition_text("std_msgs/msg/Header", "ros2msg", "int8 a\n").unwrap();
    let error = DynamicMessage::new(&other).to_typed::<Header>().unwrap_err();
    assert!(matches!(error, ConvertError::Cdr { .. }), "{error}");
}

/// Reads bytes in both ways, which must agree on the value, or on the invalid field.
fn read_both_ways<T: Message>(of: &DynamicType, bytes: &[u8]) {
    match (DynamicMessage::from_cdr(of, bytes), cdr::from_slice::<T>(bytes)) {
        (Ok(ours), Ok(theirs)) => assert_eq!(ours.to_cdr(), cdr::to_vec(&theirs)),
        (Err(ours), Err(theirs)) => {
            assert!(
                theirs.path.starts_with(&ours.path) || ours.path.starts_with(&theirs.path),
                "{ours} {theirs}"
            );
        }
        different => panic!("{} {bytes:?}: {different:?}", T::TYPE_NAME),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    /// In both byte orders and all representations of XCDR.
    #[test]
    fn arbitrary_bytes_are_read_alike(
        representation in proptest::sample::select(vec![0, 1, 6, 7, 8, 9_u8]),
        body in proptest::collection::vec(prop_oneof![8 => Just(0_u8), 3 => 1_u8..6, 1 => any::<u8>()], 0..400),
    ) {
        use downbeat_msgs::{diagnostic_msgs, std_srvs, test_msgs};
        let bytes = [&[0, representation, 0, 0], body.as_slice()].concat();
        macro_rules! read {
            ($($message:ty),*) => { $(read_both_ways::<$message>(&DynamicType::of::<$message>().unwrap(), &bytes);)* };
        }
        read!(
            Header, sensor_msgs::msg::JointState, sensor_msgs::msg::Imu, geometry_msgs::msg::PolygonStamped,
            diagnostic_msgs::msg::DiagnosticArray, std_srvs::srv::SetBoolEvent, std_srvs::srv::EmptyResponse,
            test_msgs::msg::Arrays, test_msgs::msg::BoundedSequences, test_msgs::msg::WStrings,
            test_msgs::msg::MultiNested
        );
    }
}
