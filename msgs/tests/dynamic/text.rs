//! YAML as the tools of ROS 2 write and read it, byte by byte; JSON as serde writes it for the structs.
//!
//! `tests/data/echo.jsonl` is the output of rosidl_runtime_py 0.13.1 (branch jazzy) and PyYAML 6.0.3 for
//! rclpy messages, created by `echo.py` in this folder.

use std::collections::BTreeSet;

use downbeat_msgs::definitions::Catalog;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, Stamps, YamlStyle};
use downbeat_msgs::{Message, carried, cdr, sensor_msgs, std_msgs};
use python_peer::unhex;
use serde_json::Value as Json;

use crate::random::Random;

fn recorded() -> Vec<Json> {
    let lines = include_str!("../data/echo.jsonl").lines();
    lines.map(|line| serde_json::from_str(line).unwrap()).collect()
}

fn type_of(catalog: &Catalog, line: &Json) -> DynamicType {
    DynamicType::new(catalog, &line["type"].as_str().unwrap().parse().unwrap()).unwrap()
}

#[test]
fn messages_are_printed_like_ros2_topic_echo_to_the_byte() {
    let catalog = carried();
    let mut count = 0;
    for line in recorded().iter().filter(|line| line["yaml"].is_string()) {
        let style = YamlStyle {
            truncate_length: line["style"]["truncate_length"].as_u64().map(|length| length as usize),
            no_arr: line["style"]["no_arr"] == true,
            no_str: line["style"]["no_str"] == true,
            flow_style: line["style"]["flow_style"] == true,
        };
        let of = type_of(catalog, line);
        let message = DynamicMessage::from_cdr(&of, &unhex(line["cdr"].as_str().unwrap())).unwrap();
        assert_eq!(message.to_yaml(&style), line["yaml"].as_str().unwrap(), "{} {style:?}", line["type"]);
        count += 1;
    }
    assert!(count > 300, "{count}");
}

#[test]
fn messages_printed_without_truncation_are_read_again() {
    let catalog = carried();
    for line in recorded().iter().filter(|line| line["yaml"].is_string()) {
        if ["truncate_length", "no_arr", "no_str"].iter().any(|option| !line["style"][option].is_null()) {
            continue;
        }
        let of = type_of(catalog, line);
        let message = DynamicMessage::from_cdr(&of, &unhex(line["cdr"].as_str().unwrap())).unwrap();
        let yaml = line["yaml"].as_str().unwrap();
        // Characters that YAML cannot represent, and line breaks that it normalises.
        let is_odd = |c: char| matches!(c, '\u{85}' | '\u{2028}' | '\u{2029}' | '\u{10ffff}');
        if !yaml.contains(is_odd) {
            let read = DynamicMessage::from_yaml(&of, yaml).unwrap_or_else(|error| panic!("{yaml}: {error}"));
            assert_eq!(read.to_cdr().len(), message.to_cdr().len(), "{yaml}");
            assert_eq!(read.to_yaml(&YamlStyle::default()), message.to_yaml(&YamlStyle::default()));
        }
    }
}

/// Input that only ROS 2 or only we accept, and why.
const TAKEN_DIFFERENTLY: [(&str, &str); 8] = [
    ("std_msgs/msg/String", "data: [1]"), // There, the text of a Python list.
    ("std_msgs/msg/String", "data: {a: 1}"), // Likewise.
    ("std_msgs/msg/Int8", "data: 128"),   // There, it becomes -128.
    ("std_msgs/msg/Float32", "data: 1e39"), // There, infinite.
    ("std_msgs/msg/UInt8MultiArray", "data: [256]"),
    ("geometry_msgs/msg/PoseArray", "poses: {}"), // There, an empty list.
    ("geometry_msgs/msg/PoseWithCovariance", "covariance: [1, 2]"), // There, memory is read past its end.
    ("sensor_msgs/msg/JointState", "name: [1]"),  // Here, the text `1`, as for a single string.
];

#[test]
fn user_input_is_read_as_by_ros2_topic_pub() {
    let catalog = carried();
    let mut differences = BTreeSet::new();
    let lines = recorded();
    let lines: Vec<&Json> = lines.iter().filter(|line| line["fill"].is_string()).collect();
    for line in &lines {
        let of = type_of(catalog, line);
        let text = line["fill"].as_str().unwrap();
        let mut message = DynamicMessage::new(&of);
        match (message.fill_yaml(text), line["cdr"].as_str()) {
            (Ok(stamps), Some(theirs)) => {
                // Padding differs.
                let theirs = DynamicMessage::from_cdr(&of, &unhex(theirs)).unwrap();
                assert_eq!(
                    message.to_yaml(&YamlStyle::default()),
                    theirs.to_yaml(&YamlStyle::default()),
                    "{text}"
                );
                assert_eq!(stamps.paths().count() as u64, line["stamps"], "{text}");
            }
            (Err(_), None) => {}
            (ours, _) => {
                let stamps: Result<Stamps, _> = ours;
                eprintln!("{} {text}: {stamps:?}", line["type"]);
                differences.insert((line["type"].as_str().unwrap(), text));
            }
        }
    }
    assert!(lines.len() > 60);
    assert!(differences.iter().all(|difference| TAKEN_DIFFERENTLY.contains(difference)), "{differences:?}");
}

#[test]
fn times_to_be_set_by_the_sender_are_set_on_sending() {
    let catalog = carried();
    let mut array = DynamicMessage::new(
        &DynamicType::new(catalog, &"diagnostic_msgs/msg/DiagnosticArray".parse().unwrap()).unwrap(),
    );
    let stamps = array.fill_yaml("{header: auto, status: [{name: a}]}").unwrap();
    assert_eq!(stamps.paths().collect::<Vec<_>>(), ["header.stamp"]);
    let time = downbeat_msgs::builtin_interfaces::msg::Time { sec: 3, nanosec: 4 };
    stamps.set(&mut array, time).unwrap();
    assert_eq!(array.get("header.stamp.nanosec").unwrap().as_i64(), Some(4));
    let of = array.message_type().clone();
    let error = DynamicMessage::from_yaml(&of, "header: auto").unwrap_err().to_string();
    assert_eq!(error, "cannot read this YAML: `header.stamp` is to be set by the sender: give it a time");
}

#[test]
fn errors_name_the_line_the_field_and_a_suggestion() {
    let of = DynamicType::of::<sensor_msgs::msg::JointState>().unwrap();
    for (yaml, expected) in [
        (
            "header:\n  stmp: now\n",
            "cannot read this YAML, line 2, column 3: sensor_msgs/msg/JointState, field `header.stmp`: \
             std_msgs/msg/Header has no field `stmp`, did you mean `stamp`?",
        ),
        (
            "position: [1, x]",
            "cannot read this YAML, line 1, column 15: sensor_msgs/msg/JointState, field `position[1]`: \
             takes a number, found the string `x`",
        ),
        (
            "header: {stamp: {sec: 1.5}}",
            "cannot read this YAML, line 1, column 23: sensor_msgs/msg/JointState, field `header.stamp.sec`: \
             takes a int32, found the number 1.5",
        ),
        (
            "header: 5",
            "cannot read this YAML, line 1, column 9: sensor_msgs/msg/JointState, field `header`: \
             takes a std_msgs/msg/Header, found the integer 5",
        ),
    ] {
        let error = DynamicMessage::from_yaml(&of, yaml).unwrap_err().to_string();
        assert_eq!(error, expected);
    }
    let error = DynamicMessage::from_json(&of, "{\"name\": [\"a\", 5]}").unwrap_err().to_string();
    assert_eq!(
        error,
        "cannot read this JSON, line 1, column 16: invalid type: integer `5`, expected an element of a string[] for the \
         field `name[1]`"
    );
    for json in ["", "{", "{} {}", "[]", "5", "{\"header\": [1]}", "{\"header\": null}"] {
        assert!(DynamicMessage::from_json(&of, json).is_err(), "{json}");
    }
    for yaml in ["", "a: [", "&a [*a]", "- 1", "header: &a {stamp: *b}", "? {a: b}\n: c"] {
        assert!(DynamicMessage::from_yaml(&of, yaml).is_err(), "{yaml}");
    }
}

#[test]
fn a_text_cannot_allocate_unbounded_memory() {
    let mut catalog = Catalog::new();
    catalog.add_message("a/msg/A".parse().unwrap(), "B[] bs\n", "").unwrap();
    catalog.add_message("a/msg/B".parse().unwrap(), "uint8[16000000] b\n", "").unwrap();
    let of = DynamicType::new(&catalog, &"a/msg/A".parse().unwrap()).unwrap();
    let json = format!("{{\"bs\": [{}]}}", vec!["{}"; 100].join(","));
    let error = DynamicMessage::from_json(&of, &json).unwrap_err().to_string();
    assert!(error.contains("more than 268435456 bytes"), "{error}");
    // Aliases of aliases of aliases.
    let of = DynamicType::of::<std_msgs::msg::String>().unwrap();
    let mut bomb = String::from("a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n");
    for level in 1..12 {
        let alias = format!("*a{}", level - 1);
        bomb += &format!("a{level}: &a{level} [{}]\n", [alias.as_str(); 10].join(", "));
    }
    assert!(DynamicMessage::from_yaml(&of, &format!("{bomb}data: *a11\n")).is_err());
}

#[test]
fn json_is_that_of_the_structs() {
    fn check<T: Message + serde::Serialize + serde::de::DeserializeOwned>(random: &mut Random) {
        let of = DynamicType::of::<T>().unwrap();
        for _ in 0..10 {
            let value: T = random.value();
            let Ok(message) = DynamicMessage::from_cdr(&of, &cdr::to_vec(&value)) else { continue };
            assert_eq!(message.to_json(), serde_json::to_string(&value).unwrap());
            let read = DynamicMessage::from_json(&of, &message.to_json()).unwrap();
            assert_eq!(read.to_json(), message.to_json());
        }
    }
    let mut random = Random::new(0x150);
    macro_rules! check_each {
        ($($message:ty),* $(,)?) => { $(check::<$message>(&mut random);)* };
    }
    downbeat_msgs::for_each_message!(check_each);
}

#[test]
fn an_empty_value_in_yaml_is_refused_by_the_name_of_its_field() {
    let of = DynamicType::from_definition_text(
        "a/msg/A",
        "ros2msg",
        &format!("B b\nfloat64 x\nstring s\nuint8[] bytes\nstring[] names\nint8 n\nbool ok\n\n{}\nMSG: a/B\nfloat64 y\n", "=".repeat(80)),
    )
    .unwrap();
    for (yaml, field) in [
        ("{x: }", "x"),
        ("x: ~", "x"),
        ("{b: {y: null}}", "b.y"),
        ("{b: }", "b"),
        ("{s: }", "s"),
        ("s: null", "s"),
        ("{bytes: }", "bytes"),
        ("names: [a, ~]", "names[1]"),
        ("n: NULL", "n"),
        ("{ok: }", "ok"),
    ] {
        let error = DynamicMessage::from_yaml(&of, yaml).unwrap_err().to_string();
        assert!(error.contains(&format!("field `{field}`: is empty")), "{yaml}: {error}");
    }
    let message = DynamicMessage::from_yaml(&of, "{s: 'null', x: .nan, names: ['~', \"\"]}").unwrap();
    assert_eq!(message.get("s").unwrap().as_str(), Some("null"));
    assert!(message.get("x").unwrap().as_f64().unwrap().is_nan());
    // JSON has no other word for NaN.
    assert!(
        DynamicMessage::from_json(&of, "{\"x\": null}").unwrap().get("x").unwrap().as_f64().unwrap().is_nan()
    );
}

#[test]
fn bytes_in_base64_are_accepted_for_arrays_of_bytes() {
    let of = DynamicType::from_definition_text(
        "a/msg/A",
        "ros2msg",
        "uint8[] data\nbyte[] more\nuint8[3] three\nbyte one\nstring text\nint32[] numbers\n",
    )
    .unwrap();
    let fill = |yaml: &str| DynamicMessage::from_yaml(&of, yaml);
    let yaml = "# !!binary\ndata: !!binary |\n  AQID\n  BA==\nmore: !!binary \"/w==\"\nthree: !!binary AAEC\none: !!binary Bw==\n\
                text: 'a !!binary b'\n";
    let message = fill(yaml).unwrap();
    assert_eq!(
        message,
        fill("{data: [1, 2, 3, 4], more: [255], three: [0, 1, 2], one: 7, text: a !!binary b}").unwrap()
    );
    assert_eq!(fill("{data: !!binary AQID}").unwrap(), fill("data: [1, 2, 3]").unwrap());
    assert_eq!(fill("{data: !!binary ''}").unwrap(), fill("{}").unwrap());
    for (yaml, field) in [
        ("three: !!binary AQ==", "three"),
        ("data: !!binary A?==", "data"),
        ("data: !other AQ==", "data"),
        ("numbers: !!binary AQID", "numbers"),
    ] {
        let error = fill(yaml).unwrap_err().to_string();
        assert!(error.contains(&format!("`{field}`")), "{yaml}: {error}");
    }
}

#[test]
fn tags_of_scalars_are_those_of_yaml_1_1() {
    let of = DynamicType::from_definition_text(
        "a/msg/A",
        "ros2msg",
        "bool flag\nint32 number\nfloat64 size\nstring text\nbool[] flags\n",
    )
    .unwrap();
    let fill = |yaml: &str| DynamicMessage::from_yaml(&of, yaml);
    for (tagged, plain) in [
        ("flag: !!bool on", "flag: true"),
        ("flag: !!bool 'YES'", "flag: true"),
        ("flag: !!bool oFF", "flag: false"),
        ("{flags: [!!bool on, !!bool no, !!bool true]}", "flags: [true, false, true]"),
        ("number: !!int 0x1F", "number: 31"),
        ("number: !!int '1_000'", "number: 1000"),
        ("number: !!int -012", "number: -10"),
        ("size: !!float 5", "size: 5.0"),
        ("size: !!float -.INF", "size: -.inf"),
        ("size: !!int 3", "size: 3.0"),
        ("text: !!str 5", "text: '5'"),
        ("text: 'a !!bool b'", "text: a !!bool b"),
        ("# !!bool\nflag: !!bool yes # !!int", "flag: true"),
    ] {
        assert_eq!(fill(tagged).unwrap(), fill(plain).unwrap(), "{tagged}");
    }
    for (yaml, found) in [
        ("flag: !!bool y", "`y` with the tag `!!bool`"),
        ("flag: !!bool 1", "`1` with the tag `!!bool`"),
        ("number: !!int 1.5", "`1.5` with the tag `!!int`"),
        ("size: !!float wide", "`wide` with the tag `!!float`"),
    ] {
        let error = fill(yaml).unwrap_err().to_string();
        assert!(error.contains(found), "{yaml}: {error}");
    }
}
