//! Reading and changing fields by path, and errors that list what exists.

use downbeat_msgs::definitions::Catalog;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, Value};
use downbeat_msgs::{geometry_msgs, sensor_msgs};

fn joints() -> DynamicMessage {
    let mut joints = DynamicMessage::new(&DynamicType::of::<sensor_msgs::msg::JointState>().unwrap());
    joints.set("name", vec!["pan".to_owned(), "tilt".to_owned()]).unwrap();
    joints.set("position", vec![0.25, 0.5]).unwrap();
    joints
}

/// A message with all kinds of fields.
fn kinds() -> DynamicMessage {
    let mut catalog = Catalog::new();
    let text = "bool flag\nbyte raw\nint8[<=3] few\nstring<=3 short\nstring<=2[<=2] shorts\nwstring wide\nInner[2] pair\n\
                Inner[] many\nfloat32 single\nuint64 large\nInner one\nchar[3] three\n";
    catalog.add_message("a/msg/Kinds".parse().unwrap(), text, "Kinds.msg").unwrap();
    catalog.add_message("a/msg/Inner".parse().unwrap(), "int16 x -2\nint16[] xs\n", "Inner.msg").unwrap();
    DynamicMessage::new(&DynamicType::new(&catalog, &"a/msg/Kinds".parse().unwrap()).unwrap())
}

#[test]
fn fields_and_elements_are_changed_and_read() {
    let mut message = joints();
    message.set("header.stamp.sec", 7).unwrap();
    message.set("position[1]", 1).unwrap();
    message.set("name[0]", "yaw").unwrap();
    message.push("effort", 3.5).unwrap();
    assert_eq!(message.get("header.stamp.sec").unwrap().as_i64(), Some(7));
    assert_eq!(message.get("position").unwrap().as_slice::<f64>(), Some([0.25, 1.0].as_slice()));
    let typed: sensor_msgs::msg::JointState = message.to_typed().unwrap();
    assert_eq!(
        (typed.header.stamp.sec, typed.name, typed.effort),
        (7, vec!["yaw".into(), "tilt".into()], vec![3.5])
    );
}

#[test]
fn nested_messages_are_changed_and_read() {
    let mut message = kinds();
    assert_eq!(message.get("pair[1].x").unwrap().as_i64(), Some(-2));
    message.set("pair[1].x", 5).unwrap();
    message.set("one.xs", vec![1, 2]).unwrap();
    message.resize("many", 2).unwrap();
    message.set("many[1].xs", vec![9]).unwrap();
    let inner = message.get("pair[1]").unwrap().to_value();
    let Value::Message(inner) = inner else { panic!("{inner:?}") };
    message.push("many", *inner.clone()).unwrap();
    message.set("one", *inner).unwrap();
    assert_eq!(message.get("many[1].xs[0]").unwrap().as_i64(), Some(9));
    assert_eq!(message.get("many[2].x").unwrap().as_i64(), Some(5));
    assert_eq!(message.get("one.x").unwrap().as_i64(), Some(5));
    assert_eq!(message.get("one.xs").unwrap().as_array().unwrap().len(), 0);
    message.resize("many", 1).unwrap();
    assert_eq!(message.get("many").unwrap().as_array().unwrap().len(), 1);
    let many = message.get("many").unwrap().to_value();
    let mut other = kinds();
    other.set("many", many).unwrap();
    assert_eq!(other.get("many"), message.get("many"));
    assert_eq!(DynamicMessage::from_cdr(message.message_type(), &message.to_cdr()).unwrap(), message);
}

#[test]
fn values_are_checked_against_the_type_of_the_field() {
    let mut message = kinds();
    for (path, value, end) in [
        ("flag", Value::from(1), "takes a bool, found the integer 1"),
        ("raw", Value::from(256), "takes a uint8, which cannot hold 256"),
        ("raw", Value::from(-1), "takes a uint8, which cannot hold -1"),
        ("raw", Value::from(0.5), "takes a uint8, found the number 0.5"),
        ("few", Value::from(vec![1, 2, 3, 4]), "takes at most 3 elements, found 4"),
        ("few", Value::from(vec![1, 200]), "takes a int8, which cannot hold 200"),
        ("few", Value::from(1), "takes int8[<=3], found the integer 1"),
        ("three", Value::from(vec![1, 2]), "takes exactly 3 elements, found 2"),
        (
            "short",
            Value::from("four"),
            "takes a string of at most 3 bytes (wide strings: 16-bit units), found 4",
        ),
        (
            "shorts",
            Value::from(vec!["abc".to_owned()]),
            "takes a string of at most 2 bytes (wide strings: 16-bit units), found 3",
        ),
        ("single", Value::from(1e300), "takes a float32, which cannot hold 1e300"),
        ("large", Value::from(f64::NAN), "takes a uint64, found the number NaN"),
        ("one", Value::from(2), "takes a a/msg/Inner, found the integer 2"),
        ("one", Value::from(joints()), "takes a a/msg/Inner, found a sensor_msgs/msg/JointState"),
        ("pair", Value::from("x"), "takes a/Inner[2], found the string `x`"),
    ] {
        let before = message.clone();
        let error = message.set(path, value).unwrap_err();
        assert_eq!(error.to_string(), format!("a/msg/Kinds, field `{path}`: {end}"));
        assert_eq!(message, before);
    }
    message.set("single", 2).unwrap();
    message.set("large", u64::MAX).unwrap();
    message.set("few", vec![1.0, -3.0]).unwrap();
    message.set("wide", "ü").unwrap();
    assert_eq!(message.get("few").unwrap().as_slice::<i8>(), Some([1, -3].as_slice()));
    assert!(message.push("few", 3).is_ok() && message.push("few", 4).is_err());
    assert!(message.push("three", 4).is_err() && message.resize("pair", 3).is_err());
}

#[test]
fn errors_list_what_exists_and_suggest_names() {
    let message = joints();
    for (path, end) in [
        ("header.stmp.sec", "std_msgs/msg/Header has no field `stmp`, did you mean `stamp`?"),
        (
            "quaternions",
            "sensor_msgs/msg/JointState has no field `quaternions`, it has `header`, `name`, `position`, `velocity`, \
             `effort`",
        ),
        ("header.frame_id.x", "cannot look for `x` in the string ``, which has no fields"),
        ("header.stamp.sec[0]", "cannot take element 0 of the integer 0, which has no elements"),
        ("header[0]", "cannot take element 0 of a std_msgs/msg/Header, which has no elements"),
        ("position[2]", "there is no element 2, there are 2, counted from 0"),
        ("position.x", "cannot look for `x` in an array of 2 elements, which has no fields"),
        ("header..x", "invalid path: expected the name of a field at byte 7, as in `points[3].x`"),
    ] {
        let expected = format!("sensor_msgs/msg/JointState, field `{path}`: {end}");
        assert_eq!(message.get(path).unwrap_err().to_string(), expected);
        assert_eq!(message.clone().set(path, 1).unwrap_err().to_string(), expected);
    }
    let empty = DynamicType::from_definition_text("a/msg/A", "ros2msg", "").unwrap();
    let error = DynamicMessage::new(&empty).get("x").unwrap_err().to_string();
    assert_eq!(error, "a/msg/A, field `x`: a/msg/A has no field `x`, it has no fields at all");
}

#[test]
fn an_array_of_messages_of_another_type_is_refused() {
    let mut path = DynamicMessage::new(&DynamicType::of::<geometry_msgs::msg::Polygon>().unwrap());
    let many = kinds().get("many").unwrap().to_value();
    let error = path.set("points", many).unwrap_err().to_string();
    assert!(error.ends_with("takes geometry_msgs/Point32[], found an array of 0 elements"), "{error}");
}
