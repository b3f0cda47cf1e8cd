//! A bag with messages of every built-in type, read by other software: values, definitions, hashes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use downbeat_bags::{TopicDescription, WriterOptions};
use downbeat_msgs::{Message, carried, cdr};
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use self::exact::{first_difference, from_exact};
use self::random::random_message;
use crate::matrix::{Way, With};
use crate::node::{message_json, read_with_node};
use crate::python::read_with_python;
use crate::support::noted;

// Exact values, shared with the tests of messages.
#[path = "../../../msgs/tests/interop/exact.rs"]
mod exact;
#[path = "../../../msgs/tests/interop/random.rs"]
mod random;

const SEED: u64 = 0xba65;
const VALUES_PER_TYPE: usize = 4;
/// The receive time of the first message, in nanoseconds.
const START: i64 = 1_700_000_000_000_000_000;
const PERIOD: i64 = 1_000_000;

/// A built-in type.
struct Type {
    name: &'static str,
    hash: &'static str,
    definition: &'static str,
    write: fn(&Value) -> Vec<u8>,
}

impl Type {
    fn of<T: Message + DeserializeOwned>() -> Self {
        Self {
            name: T::TYPE_NAME,
            hash: T::TYPE_HASH,
            definition: T::DEFINITION,
            write: |value| cdr::to_vec(&from_exact::<T>(value)),
        }
    }

    fn topic(&self) -> String {
        format!("/{}", self.name)
    }

    fn is_event(&self) -> bool {
        self.name.ends_with("_Event")
    }

    /// The group of types that a reader supports or not as a whole.
    fn kind(&self) -> &'static str {
        match self.is_message() {
            _ if self.is_event() => "events of services",
            false => "feedback of actions",
            true if self.has_a("wstring") => "messages with wide strings",
            true => "messages of every other carried type",
        }
    }

    fn is_message(&self) -> bool {
        self.name.contains("/msg/")
    }

    /// Returns whether it contains a field of that type, directly or nested.
    fn has_a(&self, word: &str) -> bool {
        let is_constant = |line: &str| line.replace("<=", "").contains('=');
        let begins =
            |line: &str| line.strip_prefix(word).is_some_and(|rest| rest.starts_with([' ', '[', '<']));
        self.definition.lines().any(|line| begins(line.trim_start()) && !is_constant(line))
    }
}

/// Every type that topics can have: requests, responses, goals and results are not sent on topics.
fn every_type() -> Vec<Type> {
    macro_rules! table {
        ($($message:ty),* $(,)?) => { vec![$(Type::of::<$message>()),*] };
    }
    let mut types = downbeat_msgs::for_each_message!(table);
    types.retain(|of| of.is_message() || of.is_event() || of.name.ends_with("_FeedbackMessage"));
    types
}

const KINDS: [&str; 4] = [
    "events of services",
    "feedback of actions",
    "messages with wide strings",
    "messages of every other carried type",
];

/// A reader, and why it cannot read some types.
struct Peer {
    name: &'static str,
    with: With,
    exception: fn(&Type) -> Option<&'static str>,
}

const READERS: [Peer; 3] = [
    Peer {
        name: "mcap_ros2",
        with: With::McapRos2,
        exception: |of| match of.is_message() {
            false => {
                Some("it reads neither definitions of services nor names of parts of services and actions")
            }
            true => of.has_a("wstring").then_some("it does not support wide strings"),
        },
    },
    Peer {
        name: "rosbags",
        with: With::Rosbags,
        exception: |of| of.has_a("wstring").then_some("it does not support wide strings"),
    },
    // Types of packages without wheels are excluded below.
    Peer { name: "rclpy", with: With::Rclpy, exception: |_| None },
];

/// Writes the bags `messages` and `events`; returns the values by topic.
fn write_bags(folder: &Path, types: &[Type]) -> BTreeMap<String, Vec<Value>> {
    let (events, messages): (Vec<&Type>, Vec<_>) = types.iter().partition(|of| of.is_event());
    let mut values = write(&folder.join("messages"), &messages);
    values.extend(write(&folder.join("events"), &events));
    values
}

fn write(bag: &Path, types: &[&Type]) -> BTreeMap<String, Vec<Value>> {
    let mut writer = WriterOptions::new().chunk_size(50_000).create(bag).unwrap();
    let mut values: BTreeMap<String, Vec<Value>> = BTreeMap::new();
    let mut time = START;
    for of in types {
        let info = TopicDescription {
            name: of.topic(),
            type_name: of.name.to_owned(),
            definition: of.definition.to_owned(),
            type_hash: of.hash.to_owned(),
            ..TopicDescription::default()
        };
        let id = writer.add_topic(info).unwrap();
        for number in 0..VALUES_PER_TYPE {
            let value = random_message(carried(), &of.name.parse().unwrap(), SEED, number);
            time += PERIOD;
            writer.write(id, time, time, &(of.write)(&value)).unwrap();
            values.entry(of.topic()).or_default().push(value);
        }
    }
    let summary = writer.finish().unwrap();
    assert_eq!(summary.message_count(), (types.len() * VALUES_PER_TYPE) as u64);
    values
}

#[test]
fn others_decode_values_of_every_carried_type() {
    let types = every_type();
    assert!(types.len() > 200, "{}", types.len());
    let folder = tempfile::tempdir().unwrap();
    let values = write_bags(folder.path(), &types);
    // Some readers return numbers without their types.
    fs::write(folder.path().join("values.json"), json!(values).to_string()).unwrap();
    let Some(read) = read_with_python("decode_types.py", folder.path()) else { return };
    let packages: BTreeSet<&str> =
        read["packages"].as_array().unwrap().iter().filter_map(Value::as_str).collect();
    for (kind, reader) in KINDS.iter().flat_map(|kind| READERS.iter().map(move |reader| (*kind, reader))) {
        let types: Vec<&Type> = types.iter().filter(|of| of.kind() == kind).collect();
        let check = noted(&format!("values: {kind}"), reader.with, Way::Out);
        let _check = match (reader.exception)(types[0]) {
            Some(reason) => check.limited_by(reason),
            None => check,
        };
        let found = &read[reader.name];
        let (mut decoded, mut known) = (0, types.len());
        for of in &types {
            let package = of.name.split('/').next().unwrap();
            if reader.name == "rclpy" && !packages.contains(package) {
                assert_eq!(found[of.topic()], Value::Null, "{}", of.name);
                known -= 1;
                continue;
            }
            if let Some(reason) = (reader.exception)(of) {
                // Fails if the exception is no longer needed.
                assert!(!found[of.topic()].is_array(), "{} reads {}, though {reason}", reader.name, of.name);
                continue;
            }
            let read_values = found[of.topic()].as_array();
            let read_values =
                read_values.unwrap_or_else(|| panic!("{}: {}: {}", reader.name, of.name, found[of.topic()]));
            assert_eq!(read_values.len(), VALUES_PER_TYPE, "{}: {}", reader.name, of.name);
            for (number, (read_value, value)) in read_values.iter().zip(&values[&of.topic()]).enumerate() {
                if let Some(difference) = first_difference(value, read_value) {
                    panic!("{}: {}, value {number} of seed {SEED:#x}: at {difference}", reader.name, of.name);
                }
            }
            decoded += 1;
        }
        let is_exception = (reader.exception)(types[0]).is_some();
        assert!(
            is_exception || decoded * 2 > known && known > 0,
            "{} decoded {decoded} of {kind}",
            reader.name
        );
    }
}

/// Compares the schemas and the bytes of messages.
#[test]
fn mcap_core_reads_every_message_of_every_carried_type() {
    let types = every_type();
    let folder = tempfile::tempdir().unwrap();
    let values = write_bags(folder.path(), &types);
    let check = noted("every message of every carried type", With::McapCore, Way::Out);
    for (bag, is_event) in [("messages", false), ("events", true)] {
        let file = folder.path().join(format!("{bag}/{bag}_0.mcap"));
        let Some(read) = read_with_node(&file) else { return check.skipped() };
        let types: Vec<&Type> = types.iter().filter(|of| of.is_event() == is_event).collect();
        let mut time = START;
        let mut messages = Vec::new();
        for of in &types {
            for value in &values[&of.topic()] {
                time += PERIOD;
                messages.push(message_json(&of.topic(), time, time, &(of.write)(value)));
            }
        }
        for by in ["indexed", "streamed"] {
            let read = &read[by];
            assert_eq!(read["error"], Value::Null, "{bag}, {by}");
            assert!(*read["messages"].as_array().unwrap() == messages, "{bag}, {by}: the messages differ");
            for of in &types {
                let channel = &read["channels"][of.topic()];
                assert_eq!(channel["schema"]["name"], of.name, "{bag}, {by}");
                let (_, text) = carried().schema_text(&of.name.parse().unwrap()).unwrap();
                assert_eq!(channel["schema"]["text"], text, "{bag}, {by}");
                assert_eq!(channel["metadata"]["topic_type_hash"], of.hash, "{bag}, {by}");
            }
        }
    }
}

/// `rosbags` computes the hashes of the definitions in a bag, and rejects a bag (`AnyReader`) if one differs
/// from the recorded hash. The hashes in our bags are those published by the ROS 2 packages
/// (`share/*/msg/*.json`).
#[test]
fn hashes_in_bags_are_those_that_ros_2_publishes_and_rosbags_computes() {
    let types = every_type();
    let folder = tempfile::tempdir().unwrap();
    write_bags(folder.path(), &types);
    let Some(read) = read_with_python("hash_types.py", folder.path()) else { return };
    let (mut published, mut computed) = (0, 0);
    {
        let _check = noted("type hashes", With::Rclpy, Way::Out);
        for of in &types {
            let recorded = &read["recorded"][of.topic()];
            assert_eq!(*recorded, of.hash, "{}", of.name);
            if let Some(theirs) = read["published"].get(of.name) {
                assert_eq!(theirs, recorded, "{}", of.name);
                published += 1;
            }
        }
        assert!(published > 150, "{published} of {}", types.len());
    }
    let _check = noted("type hashes", With::Rosbags, Way::Out);
    // Of messages as `ros2msg`, of parts of services and actions, whose schemas are IDL, among them.
    for ending in [
        "/msg/Imu",
        "/srv/SetBool_Event",
        "Fibonacci_SendGoal_Event",
        "Fibonacci_GetResult_Event",
        "Fibonacci_FeedbackMessage",
    ] {
        assert!(types.iter().any(|of| of.name.ends_with(ending)), "{ending}");
    }
    for of in types.iter().filter(|of| !of.has_a("wstring")) {
        let theirs = read["computed"][of.topic()].as_str();
        assert_eq!(theirs, Some(of.hash), "{}", of.name);
        computed += 1;
    }
    assert!(computed > 200, "{computed} of {}", types.len());
}
