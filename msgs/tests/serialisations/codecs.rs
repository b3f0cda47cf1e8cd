//! Every type through every encoding.

use std::time::{Duration, Instant};

use downbeat_msgs::cdr;
use downbeat_msgs::encoding::Encoding;
use downbeat_msgs::geometry_msgs::msg::Quaternion;
use downbeat_msgs::sensor_msgs::msg::{Image, JointState};
use downbeat_msgs::service_msgs::msg::ServiceEventInfo;
use downbeat_msgs::std_srvs::srv::{SetBoolEvent, SetBoolRequest};

use crate::random::Random;
use crate::types::{Type, catalog, every_type, name};

const VALUES_PER_TYPE: usize = 20;

fn each_value(encoding: Encoding, mut check: impl FnMut(&Type, &[u8], &[u8], &[u8])) {
    let mut random = Random::new(0xc0de);
    for of in every_type() {
        let codec = encoding.codec(catalog(), &name(of.name)).unwrap();
        for _ in 0..VALUES_PER_TYPE {
            let value = (of.random)(&mut random);
            let encoded = codec.encode(&value).unwrap_or_else(|error| panic!("{error}"));
            let decoded = codec.decode(&encoded).unwrap_or_else(|error| panic!("{error}"));
            check(&of, &value, &encoded, &decoded);
        }
    }
}

#[test]
fn every_type_round_trips_exactly_through_every_lossless_encoding() {
    for encoding in [Encoding::Cdr, Encoding::Cbor, Encoding::Protobuf, Encoding::FlatBuffers] {
        each_value(encoding, |of, value, _, decoded| assert_eq!(decoded, value, "{encoding} {}", of.name));
    }
}

#[test]
fn the_json_equals_that_of_the_structs_and_round_trips_finite_numbers() {
    let mut compared = 0;
    each_value(Encoding::Json, |of, value, encoded, decoded| {
        let text = std::str::from_utf8(encoded).unwrap();
        assert_eq!(text, (of.to_json)(value), "{}", of.name);
        if text.contains("null") {
            assert_eq!((of.to_json)(decoded), text, "{}", of.name);
        } else {
            assert_eq!(decoded, value, "{}", of.name);
            compared += 1;
        }
    });
    assert!(compared > 1000, "only {compared} values were finite");
}

#[test]
fn the_cbor_is_read_by_ciborium_and_that_of_ciborium_by_us() {
    let mut random = Random::new(0xc1b0);
    for of in every_type() {
        let codec = Encoding::Cbor.codec(catalog(), &name(of.name)).unwrap();
        for _ in 0..VALUES_PER_TYPE {
            let value = (of.random)(&mut random);
            assert_eq!((of.from_cbor)(&codec.encode(&value).unwrap()), value, "{}", of.name);
            assert_eq!(codec.decode(&(of.to_cbor)(&value)).unwrap(), value, "{}", of.name);
        }
    }
}

#[test]
fn big_endian_messages_are_encoded_as_little_endian_ones() {
    let state = JointState {
        position: vec![0.25, -1.0],
        name: vec!["a".into(), "b".into()],
        ..JointState::default()
    };
    let little = cdr::to_vec(&state);
    let codec = |encoding: Encoding| encoding.codec(catalog(), &name("sensor_msgs/msg/JointState")).unwrap();
    // Header, stamp, frame_id "", names, positions, empty velocity and effort: all are 4-byte numbers except
    // positions.
    let mut big = little.clone();
    big[1] = 0;
    let strings = [16, 17, 18, 19, 28, 29, 36, 37]; // Offsets of characters, which are not swapped.
    for (start, width) in
        [(4, 4), (8, 4), (12, 4), (20, 4), (24, 4), (32, 4), (40, 4), (44, 8), (52, 8), (60, 4), (64, 4)]
    {
        assert!(!strings.contains(&start));
        big[start..start + width].reverse();
    }
    assert_eq!(cdr::from_slice::<JointState>(&big).unwrap(), state);
    for encoding in Encoding::ALL.into_iter().filter(|encoding| *encoding != Encoding::Cdr) {
        assert_eq!(
            codec(encoding).encode(&big).unwrap(),
            codec(encoding).encode(&little).unwrap(),
            "{encoding}"
        );
    }
}

#[test]
fn version_2_of_cdr_is_encoded_as_version_1() {
    use downbeat_msgs::sensor_msgs::msg::Temperature;

    let mut value = Temperature { temperature: 36.6, variance: 0.5, ..Temperature::default() };
    value.header.frame_id = "abcd".into();
    let version_1 = cdr::to_vec(&value);
    // Doubles are aligned to 4 bytes there: after stamp, length and five characters with padding.
    let (head, doubles) = (&version_1[4..24], &version_1[28..]);
    let version_2 = [&[0, 7, 0, 0], head, doubles].concat();
    assert_eq!(cdr::from_slice::<Temperature>(&version_2).unwrap(), value);
    let codec = Encoding::Protobuf.codec(catalog(), &name("sensor_msgs/msg/Temperature")).unwrap();
    assert_eq!(codec.encode(&version_2).unwrap(), codec.encode(&version_1).unwrap());
}

#[test]
fn a_zero_that_is_not_the_default_of_the_definition_stays_zero() {
    let zero = cdr::to_vec(&Quaternion { x: 0.0, y: 0.0, z: 0.0, w: 0.0 });
    for encoding in Encoding::ALL {
        let codec = encoding.codec(catalog(), &name("geometry_msgs/msg/Quaternion")).unwrap();
        assert_eq!(codec.decode(&codec.encode(&zero).unwrap()).unwrap(), zero, "{encoding}");
    }
}

#[test]
fn a_codec_accepts_only_messages_of_its_type() {
    let codec = Encoding::Json.codec(catalog(), &name("sensor_msgs/msg/JointState")).unwrap();
    let error = codec.to_vec(&Quaternion::default()).unwrap_err().to_string();
    assert_eq!(
        error,
        "sensor_msgs/msg/JointState: cannot write json: the message is a geometry_msgs/msg/Quaternion"
    );
}

#[test]
fn names_of_encodings_and_channels_are_parsed() {
    for encoding in Encoding::ALL {
        assert_eq!(encoding.as_str().parse(), Ok(encoding));
        let codec = encoding.codec(catalog(), &name("sensor_msgs/msg/Image")).unwrap();
        assert_eq!(Encoding::of_channel(codec.message_encoding(), &codec.schema().name), Some(encoding));
    }
    let error = "protobufs".parse::<Encoding>().unwrap_err().to_string();
    assert!(
        error.starts_with("unknown encoding \"protobufs\"; there are cdr, json, cbor, protobuf, "),
        "{error}"
    );
}

#[test]
fn large_messages_go_through_every_encoding_that_has_bytes() {
    let image = Image { width: 1024, height: 1024, data: vec![7; 1 << 20], ..Image::default() };
    let cdr = cdr::to_vec(&image);
    let start = Instant::now();
    for encoding in Encoding::ALL.into_iter().filter(|encoding| *encoding != Encoding::Json) {
        let codec = encoding.codec(catalog(), &name("sensor_msgs/msg/Image")).unwrap();
        let bytes = codec.encode(&cdr).unwrap();
        assert!(bytes.len() < (1 << 20) + 1024, "{encoding}: {} bytes", bytes.len());
        assert_eq!(codec.decode(&bytes).unwrap(), cdr, "{encoding}");
    }
    // A watchdog against work per byte that grows with the message, not a measurement.
    assert!(start.elapsed() < Duration::from_secs(60));
}

#[test]
fn events_of_services_have_a_codec_by_the_text_of_their_service() {
    let text = format!(
        "{}\nSRV: std_srvs/srv/SetBool\nbool data\n---\nbool success\nstring message\n",
        "=".repeat(80)
    );
    let codec = Encoding::Json.codec_of_text("std_srvs/srv/SetBool_Event", &text).unwrap();
    let event = SetBoolEvent {
        info: ServiceEventInfo { event_type: 1, ..ServiceEventInfo::default() },
        request: vec![SetBoolRequest { data: true }],
        response: Vec::new(),
    };
    let json = codec.encode(&cdr::to_vec(&event)).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    assert_eq!((&json["info"]["event_type"], &json["request"][0]["data"]), (&1.into(), &true.into()));
}
