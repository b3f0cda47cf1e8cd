//! Messages built and changed at run time, read by rclpy and rosbags.
//!
//! Needs the Python interpreter named by `DOWNBEAT_PYTHON`; without it the tests print a note and pass.

use downbeat_msgs::carried;
use downbeat_msgs::definitions::Kind;
use downbeat_msgs::dynamic::{DynamicMessage, DynamicType, MessageRef, ValueRef};
use python_peer::{Python, hex, unhex};
use serde_json::Value as Json;

use crate::random::Random;

/// Runs a command of `peer.py` with `input` in a file; returns its lines of output, or `None` without Python.
fn ask(command: &str, input: &str) -> Option<Vec<String>> {
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/dynamic/peer.py");
    Some(Python::find()?.ask(script, command, input).lines().map(String::from).collect())
}

/// Gives every number, boolean and text a value that encodes its place, and every sequence two elements, by
/// path.
fn fill(message: &mut DynamicMessage, random: &mut Random) {
    let mut todo = paths(message.as_message(), "");
    let mut number = 1;
    while let Some(path) = todo.pop() {
        number = number % 100 + 1;
        match message.get(&path).unwrap() {
            ValueRef::Message(inner) => {
                let inner = paths(inner, &path);
                todo.extend(inner);
            }
            ValueRef::Array(_) => {
                // Sequences of fixed length or a smaller bound keep their length.
                let count = if message.resize(&path, 2).is_ok() { 2 } else { array_length(message, &path) };
                todo.extend((0..count.min(3)).map(|index| format!("{path}[{index}]")));
            }
            ValueRef::Bool(_) => message.set(&path, random.value::<bool>()).unwrap(),
            ValueRef::String(_) | ValueRef::WString(_) => message.set(&path, format!("t{number}")).unwrap(),
            _ => message.set(&path, number).unwrap(),
        }
    }
}

fn array_length(message: &DynamicMessage, path: &str) -> usize {
    message.get(path).unwrap().as_array().unwrap().len()
}

fn paths(message: MessageRef<'_>, prefix: &str) -> Vec<String> {
    let separator = if prefix.is_empty() { "" } else { "." };
    message.fields().map(|(name, _)| format!("{prefix}{separator}{name}")).collect()
}

/// Every built-in message that the wheels contain, including parts of services and actions, filled by path.
fn messages() -> Vec<DynamicMessage> {
    const NO_WHEEL: [&str; 10] = [
        "bond",
        "control_msgs",
        "controller_manager_msgs",
        "downbeat_interfaces",
        "composition_interfaces",
        "example_interfaces",
        "rosbag2_interfaces",
        "simulation_interfaces",
        "statistics_msgs",
        "tf2_msgs",
    ];
    let mut random = Random::new(0xf111);
    let names = carried().messages().map(|message| &message.name);
    let wanted = names.filter(|name| name.kind != Kind::Action && !NO_WHEEL.contains(&name.package.as_str()));
    wanted
        .map(|name| {
            let mut message = DynamicMessage::new(&DynamicType::new(carried(), name).unwrap());
            fill(&mut message, &mut random);
            message
        })
        .collect()
}

#[test]
fn rclpy_reads_messages_built_by_path() {
    let messages = messages();
    let input: String = messages
        .iter()
        .map(|message| format!("{}\t{}\n", message.type_name(), hex(&message.to_cdr())))
        .collect();
    let Some(answer) = ask("read", &input) else { return };
    assert_eq!(answer.len(), messages.len());
    for (message, theirs) in messages.iter().zip(&answer) {
        let ours: Json = serde_json::to_value(message).unwrap();
        assert_eq!(ours, serde_json::from_str::<Json>(theirs).unwrap(), "{}", message.type_name());
    }
    assert!(messages.len() > 150, "{}", messages.len());
}

#[test]
fn big_endian_bytes_of_rosbags_are_the_same_messages() {
    // rosbags reads neither wide strings nor definition texts that start with a service.
    let messages: Vec<DynamicMessage> = messages()
        .into_iter()
        .filter(|message| {
            let name = message.type_name();
            name.kind == Kind::Message && name.name != "WStrings"
        })
        .collect();
    let input: String = messages
        .iter()
        .map(|message| {
            let definition = carried().definition_text(message.type_name()).unwrap();
            format!("{}\t{}\t{}\n", message.type_name(), hex(definition.as_bytes()), hex(&message.to_cdr()))
        })
        .collect();
    let Some(answer) = ask("big", &input) else { return };
    assert_eq!(answer.len(), messages.len());
    for (message, big) in messages.iter().zip(&answer) {
        let bytes = unhex(big);
        assert_eq!(bytes[..2], [0, 0]);
        assert_eq!(&DynamicMessage::from_cdr(message.message_type(), &bytes).unwrap(), message);
    }
}
