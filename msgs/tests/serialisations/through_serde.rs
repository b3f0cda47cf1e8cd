//! The structs through their own serde traits.

use downbeat_msgs::cdr;
use downbeat_msgs::sensor_msgs::msg::{Image, JointState, PointCloud2};
use serde_json::Value;

use crate::random::Random;
use crate::types::every_type;

const VALUES_PER_TYPE: usize = 40;

#[test]
fn cbor_round_trips_every_type_exactly() {
    let mut random = Random::new(0xcb0);
    for of in every_type() {
        for _ in 0..VALUES_PER_TYPE {
            let value = (of.random)(&mut random);
            assert_eq!((of.from_cbor)(&(of.to_cbor)(&value)), value, "{}", of.name);
        }
    }
}

#[test]
fn json_round_trips_every_type_with_finite_numbers_exactly() {
    let mut random = Random::new(0x150);
    let mut infinite = 0;
    for of in every_type() {
        for _ in 0..VALUES_PER_TYPE {
            let mut json = (of.to_json_value)(&(of.random)(&mut random));
            infinite += make_finite(&mut json);
            let value = (of.from_json)(&json.to_string()).unwrap();
            assert_eq!((of.from_json)(&(of.to_json)(&value)).unwrap(), value, "{}", of.name);
        }
    }
    assert!(infinite > 1000, "only {infinite} numbers were not finite");
}

#[test]
fn json_writes_null_for_non_finite_numbers_which_the_structs_refuse() {
    let state = JointState { position: vec![f64::NAN, f64::INFINITY], ..JointState::default() };
    let json = serde_json::to_string(&state).unwrap();
    assert!(json.contains("\"position\":[null,null]"), "{json}");
    let error = serde_json::from_str::<JointState>(&json).unwrap_err().to_string();
    assert!(error.contains("invalid type: null, expected f64"), "{error}");
}

#[test]
fn json_keeps_the_greatest_integers() {
    use downbeat_msgs::test_msgs::msg::BasicTypes;

    let types = BasicTypes { int64_value: i64::MIN, uint64_value: u64::MAX, ..BasicTypes::default() };
    let json = serde_json::to_string(&types).unwrap();
    assert!(json.contains("-9223372036854775808") && json.contains("18446744073709551615"), "{json}");
    assert_eq!(serde_json::from_str::<BasicTypes>(&json).unwrap(), types);
}

#[test]
fn bytes_are_a_byte_string_in_cbor_and_a_list_in_json() {
    let image = Image { data: (0..=255).cycle().take(1 << 20).collect(), ..Image::default() };
    let mut cbor = Vec::new();
    ciborium::into_writer(&image, &mut cbor).unwrap();
    assert!(cbor.len() < (1 << 20) + 200, "{} bytes", cbor.len());
    assert_eq!(ciborium::from_reader::<Image, _>(&cbor[..]).unwrap(), image);

    let json = serde_json::to_value(&image).unwrap();
    assert_eq!(json["data"].as_array().unwrap().len(), 1 << 20);
    assert_eq!(serde_json::from_value::<Image>(json).unwrap(), image);
}

#[test]
fn a_list_of_numbers_in_cbor_is_also_read_as_bytes() {
    let mut cbor = Vec::new();
    ciborium::into_writer(&serde_json::json!({ "data": [1, 2, 255], "point_step": 3 }), &mut cbor).unwrap();
    let cloud: PointCloud2 = ciborium::from_reader(&cbor[..]).unwrap();
    assert_eq!((cloud.data, cloud.point_step), (vec![1, 2, 255], 3));
}

#[test]
fn an_array_of_bytes_of_another_length_is_refused() {
    use downbeat_msgs::rmw_dds_common::msg::Gid;

    let error = serde_json::from_str::<Gid>(r#"{"data": [1, 2]}"#).unwrap_err().to_string();
    assert!(error.contains("invalid length 2"), "{error}");
    let gid = Gid { data: std::array::from_fn(|index| index as u8) };
    assert_eq!(serde_json::from_str::<Gid>(&serde_json::to_string(&gid).unwrap()).unwrap(), gid);
    assert_eq!(cdr::to_vec(&gid).len(), 4 + 16);
}

/// Replaces each null, which represents a number that is not finite; returns their number.
fn make_finite(json: &mut Value) -> usize {
    match json {
        Value::Null => {
            *json = 1.5.into();
            1
        }
        Value::Array(values) => values.iter_mut().map(make_finite).sum(),
        Value::Object(values) => values.values_mut().map(make_finite).sum(),
        _ => 0,
    }
}
