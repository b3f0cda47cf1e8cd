#![allow(clippy::unwrap_used)]

use proptest::prelude::*;

use super::{
    Cdr, EncodeError, Error, Problem, Viewed, encoded_size, from_slice, to_buffer, to_vec, try_to_vec,
};
use crate::std_msgs::msg::{Bool, Empty, Header, String as StringMessage};
use crate::{Message, WString, geometry_msgs, rcl_interfaces, rmw_dds_common, sensor_msgs};

fn problem<T: Cdr + std::fmt::Debug>(bytes: &[u8]) -> Problem {
    from_slice::<T>(bytes).unwrap_err().problem
}

fn header() -> Header {
    Header { stamp: crate::builtin_interfaces::msg::Time { sec: 1, nanosec: 2 }, frame_id: "map".into() }
}

#[test]
fn a_header_has_these_bytes() {
    let bytes = [0, 1, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 4, 0, 0, 0, b'm', b'a', b'p', 0];
    assert_eq!(to_vec(&header()), bytes);
    assert_eq!(from_slice::<Header>(&bytes).unwrap(), header());
}

#[test]
fn big_endian_is_read() {
    let bytes = [0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 2, 0, 0, 0, 4, b'm', b'a', b'p', 0];
    assert_eq!(from_slice::<Header>(&bytes).unwrap(), header());
}

#[test]
fn padding_is_relative_to_the_end_of_the_header_and_absent_before_an_empty_run() {
    let state = sensor_msgs::msg::JointState { position: vec![1.0], ..Default::default() };
    let mut bytes = vec![0, 1, 0, 0];
    bytes.extend([0; 8]); // stamp
    bytes.extend([1, 0, 0, 0, 0]); // frame_id
    bytes.extend([0; 3]); // padding
    bytes.extend([0; 4]); // no names
    bytes.extend([1, 0, 0, 0]); // one position
    bytes.extend(1_f64.to_le_bytes());
    bytes.extend([0; 8]); // no velocity, no effort
    assert_eq!(to_vec(&state), bytes);
    assert_eq!(from_slice::<sensor_msgs::msg::JointState>(&bytes).unwrap(), state);
}

#[test]
fn an_empty_message_is_one_byte() {
    assert_eq!(to_vec(&Empty {}), [0, 1, 0, 0, 0]);
    assert_eq!(from_slice::<Empty>(&[0, 1, 0, 0, 7]).unwrap(), Empty {});
    assert_eq!(problem::<Empty>(&[0, 1, 0, 0]), Problem::TooShort { needed: 1, left: 0 });
}

#[test]
fn a_buffer_is_reused() {
    let mut buffer = vec![9; 100];
    let memory = buffer.as_ptr();
    to_buffer(&header(), &mut buffer);
    assert_eq!(buffer, to_vec(&header()));
    assert_eq!(buffer.as_ptr(), memory);
}

#[test]
fn other_representations_are_named_in_the_error() {
    assert_eq!(problem::<Bool>(&[0, 3, 0, 0, 1]), Problem::Representation(3));
    assert_eq!(
        from_slice::<Bool>(&[0, 11, 0, 0, 1]).unwrap_err().to_string(),
        "cannot decode CDR at byte 0: the header names the representation 0x000b \
         (PL_CDR2, a parameter list of XCDR version 2), which ROS 2 does not use; \
         CDR (0x0000, 0x0001), CDR2 (0x0006, 0x0007) and D_CDR2 (0x0008, 0x0009) are supported"
    );
    assert_eq!(problem::<Bool>(&[0, 1]), Problem::TooShort { needed: 4, left: 2 });
}

#[test]
fn an_error_names_the_field_and_the_byte() {
    let mut path = geometry_msgs::msg::PolygonStamped::default();
    path.polygon.points = vec![Default::default(); 2];
    let bytes = to_vec(&path);
    assert_eq!(
        from_slice::<geometry_msgs::msg::PolygonStamped>(&bytes[..bytes.len() - 5]).unwrap_err(),
        Error {
            problem: Problem::Length { count: 2, least_size: 12, left: 19 },
            offset: 24,
            path: "polygon.points".into()
        }
    );
    let mut state = sensor_msgs::msg::JointState { name: vec!["a".into(), "b".into()], ..Default::default() };
    state.header.frame_id = "abc".into();
    let mut bytes = to_vec(&state);
    let second = bytes.iter().position(|byte| *byte == b'b' && bytes.len() > 40).unwrap();
    let second = bytes[second + 1..].iter().position(|byte| *byte == b'b').unwrap() + second + 1;
    bytes[second + 1] = b'!';
    let error = from_slice::<sensor_msgs::msg::JointState>(&bytes).unwrap_err();
    assert_eq!((error.path.as_str(), error.problem), ("name[1]", Problem::Terminator(b'!')));
}

#[test]
fn a_length_is_checked_before_memory_is_allocated() {
    let bytes = [0, 1, 0, 0, 255, 255, 255, 255, 1];
    assert_eq!(problem::<Vec<f64>>(&bytes), Problem::Length { count: 0xffff_ffff, least_size: 8, left: 1 });
    assert!(matches!(problem::<String>(&bytes), Problem::Length { .. }));
    assert!(matches!(problem::<Vec<geometry_msgs::msg::PoseWithCovariance>>(&bytes), Problem::Length { .. }));
}

#[test]
fn strings_and_booleans_are_validated() {
    assert_eq!(problem::<Bool>(&[0, 1, 0, 0, 2]), Problem::Bool(2));
    assert_eq!(problem::<StringMessage>(&[0, 1, 0, 0, 2, 0, 0, 0, b'a', b'b']), Problem::Terminator(b'b'));
    assert_eq!(
        problem::<StringMessage>(&[0, 1, 0, 0, 3, 0, 0, 0, b'a', 0xff, 0]),
        Problem::Utf8 { valid: 1 }
    );
    assert_eq!(from_slice::<StringMessage>(&[0, 1, 0, 0, 0, 0, 0, 0]).unwrap().data, "");
}

#[test]
fn wide_strings_take_32_bits_per_unit() {
    let text = WString::from("a\u{1f600}");
    let bytes = [0, 1, 0, 0, 3, 0, 0, 0, b'a', 0, 0, 0, 0x3d, 0xd8, 0, 0, 0x00, 0xde, 0, 0];
    assert_eq!(to_vec(&text), bytes);
    assert_eq!(from_slice::<WString>(&bytes).unwrap(), text);
    assert_eq!(
        problem::<WString>(
            &bytes[..16]
                .iter()
                .copied()
                .enumerate()
                .map(|(at, byte)| if at == 4 { 2 } else { byte })
                .collect::<Vec<_>>()
        ),
        Problem::Utf16(0xd83d)
    );
    assert_eq!(problem::<WString>(&[0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0]), Problem::Utf16(0x1_0000));
}

#[test]
fn bounds_are_enforced_when_reading() {
    let node = rmw_dds_common::msg::NodeEntitiesInfo { node_name: "n".repeat(257), ..Default::default() };
    let error = from_slice::<rmw_dds_common::msg::NodeEntitiesInfo>(&to_vec(&node)).unwrap_err();
    assert_eq!(
        (error.path.as_str(), error.problem),
        ("node_name", Problem::Bound { found: 257, bound: 256 })
    );
    let two = vec![rcl_interfaces::msg::IntegerRange::default(); 2];
    let descriptor = rcl_interfaces::msg::ParameterDescriptor { integer_range: two, ..Default::default() };
    let error = from_slice::<rcl_interfaces::msg::ParameterDescriptor>(&to_vec(&descriptor)).unwrap_err();
    assert_eq!(
        (error.path.as_str(), error.problem),
        ("integer_range", Problem::Bound { found: 2, bound: 1 })
    );
}

#[test]
fn bounds_are_checked_when_writing_on_request() {
    let info = |name_size| rmw_dds_common::msg::ParticipantEntitiesInfo {
        node_entities_info_seq: vec![
            Default::default(),
            rmw_dds_common::msg::NodeEntitiesInfo { node_name: "n".repeat(name_size), ..Default::default() },
        ],
        ..Default::default()
    };
    assert_eq!(try_to_vec(&info(256)).unwrap(), to_vec(&info(256)));
    let path = "node_entities_info_seq[1].node_name".into();
    assert_eq!(try_to_vec(&info(257)), Err(EncodeError::Bound { path, found: 257, bound: 256 }));
}

#[test]
fn memory_is_allocated_once() {
    let transform = geometry_msgs::msg::TransformStamped { header: header(), ..Default::default() };
    let bytes = to_vec(&vec![transform; 50]);
    assert_eq!(bytes.capacity(), bytes.len());
}

#[test]
fn version_2_aligns_to_four_bytes_and_writes_the_size_of_non_primitive_sequences() {
    let point = [1_f64, 2.0, 3.0].map(f64::to_le_bytes).concat();
    let points = |header: &[u8]| [header, &point, &point].concat();
    let expected = vec![geometry_msgs::msg::Point { x: 1.0, y: 2.0, z: 3.0 }; 2];
    let read = |bytes: &[u8]| from_slice::<Vec<geometry_msgs::msg::Point>>(bytes).unwrap();
    assert_eq!(read(&points(&[0, 1, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0])), expected);
    assert_eq!(read(&points(&[0, 7, 0, 0, 52, 0, 0, 0, 2, 0, 0, 0])), expected);
    let delimited: &[&[u8]] =
        &[&[0, 9, 0, 0, 60, 0, 0, 0, 2, 0, 0, 0, 24, 0, 0, 0], &point, &[24, 0, 0, 0], &point];
    assert_eq!(read(&delimited.concat()), expected);
}

#[test]
fn fields_appended_by_a_sender_in_version_2_are_skipped_and_missing_ones_are_an_error() {
    let longer = [0, 9, 0, 0, 5, 0, 0, 0, 1, 9, 9, 9, 9];
    assert_eq!(from_slice::<Bool>(&longer).unwrap(), Bool { data: true });
    let error = from_slice::<Bool>(&[0, 9, 0, 0, 0, 0, 0, 0, 1]).unwrap_err();
    assert_eq!((error.path.as_str(), error.problem), ("data", Problem::TooShort { needed: 1, left: 0 }));
    let longer_than_there_is = [0, 9, 0, 0, 6, 0, 0, 0, 1, 9, 9, 9, 9];
    assert!(matches!(problem::<Bool>(&longer_than_there_is), Problem::Length { count: 6, .. }));
}

#[test]
fn wide_strings_of_version_2_take_16_bits_per_unit() {
    let bytes = [0, 6, 0, 0, 0, 0, 0, 6, 0, b'a', 0xd8, 0x3d, 0xde, 0x00];
    assert_eq!(from_slice::<WString>(&bytes).unwrap(), WString::from("a\u{1f600}"));
    assert_eq!(problem::<WString>(&[0, 6, 0, 0, 0, 0, 0, 1, 0]), Problem::Utf16Size(1));
}

#[test]
fn booleans_in_a_sequence_are_validated() {
    let error = from_slice::<Vec<bool>>(&[0, 1, 0, 0, 3, 0, 0, 0, 1, 0, 2]).unwrap_err();
    assert_eq!((error.offset, error.path.as_str(), error.problem), (10, "[2]", Problem::Bool(2)));
}

/// Reads the bytes as every message type; accepted values must round-trip.
fn read_as_everything(bytes: &[u8]) {
    fn read<T: Message + Viewed>(bytes: &[u8]) {
        let view = from_slice::<T::View<'_>>(bytes);
        match from_slice::<T>(bytes) {
            Ok(message) => {
                let written = try_to_vec(&message).unwrap();
                assert_eq!(encoded_size(&message), written.len(), "{}", T::TYPE_NAME);
                assert_eq!(format!("{:?}", view.unwrap()), format!("{message:?}"), "{}", T::TYPE_NAME);
                // Compares bytes, not messages: NaN is not equal to itself.
                assert_eq!(to_vec(&from_slice::<T>(&written).unwrap()), written, "{}", T::TYPE_NAME);
            }
            Err(error) => {
                assert!(error.offset <= bytes.len());
                assert_eq!(error, view.unwrap_err(), "{}", T::TYPE_NAME);
            }
        }
    }
    macro_rules! read_each {
        ($($message:ty),* $(,)?) => { $(read::<$message>(bytes);)* };
    }
    for_each_message!(read_each);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn no_bytes_make_reading_panic(
        representation in prop_oneof![4 => 0_u8..2, 4 => 6_u8..10, 1 => any::<u8>()],
        // Mostly zeros and small numbers: lengths that are plausible lead deeper into a message.
        body in proptest::collection::vec(prop_oneof![8 => Just(0_u8), 3 => 1_u8..6, 1 => any::<u8>()], 0..400),
    ) {
        read_as_everything(&[&[0, representation, 0, 0], body.as_slice()].concat());
        read_as_everything(&body);
    }

    #[test]
    fn numbers_and_texts_come_back(
        numbers in proptest::collection::vec(any::<u64>(), 0..20),
        floats in proptest::collection::vec(any::<f64>(), 0..20),
        text: String,
        byte: u8,
    ) {
        let value = sensor_msgs::msg::JointState {
            header: Header { frame_id: text.clone(), ..Default::default() },
            name: numbers.iter().map(u64::to_string).collect(),
            position: floats.clone(),
            effort: floats,
            ..Default::default()
        };
        prop_assert_eq!(from_slice::<sensor_msgs::msg::JointState>(&to_vec(&value)).unwrap(), value);
        prop_assert_eq!(from_slice::<Vec<u64>>(&to_vec(&numbers)).unwrap(), numbers);
        let array = [byte; 16];
        prop_assert_eq!(from_slice::<[u8; 16]>(&to_vec(&array)).unwrap(), array);
        let wide = WString(text);
        prop_assert_eq!(from_slice::<WString>(&to_vec(&wide)).unwrap(), wide);
    }
}
