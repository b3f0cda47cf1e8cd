//! Our bags, read by `@mcap/core`, the JavaScript library of Foxglove and others: by its index and as a
//! stream.

use std::fs;
use std::path::Path;
use std::process::Command;

use downbeat_bags::{Compression, McapOptions, RecordingSummary, TopicDescription, WriterOptions};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::{cdr, sensor_msgs, std_msgs, std_srvs};
use serde_json::{Value, json};

use crate::matrix::{Way, With};
use crate::python::topic;
use crate::support::noted;

/// The output of `read_bag.mjs` for a bag file; `None` without Node.js.
pub(crate) fn read_with_node(file: &Path) -> Option<Value> {
    let modules = test_machine::node_modules()?;
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/node/read_bag.mjs");
    let output = Command::new("node")
        .arg(script)
        .arg(file)
        .env("DOWNBEAT_NODE_MODULES", modules)
        .output()
        .unwrap_or_else(|error| panic!("cannot run node: {error}"));
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    Some(serde_json::from_slice(&output.stdout).unwrap())
}

/// A message in the format of `read_bag.mjs`.
pub(crate) fn message_json(topic: &str, log_time: i64, publish_time: i64, data: &[u8]) -> Value {
    let hex: String = data.iter().map(|byte| format!("{byte:02x}")).collect();
    json!([topic, log_time.to_string(), publish_time.to_string(), hex])
}

/// Writes a bag with many chunks; returns the writer's summary and the messages in the readers' format.
fn write(bag: &Path, compression: Compression) -> (RecordingSummary, Vec<TopicDescription>, Vec<Value>) {
    let storage = McapOptions { compression, is_compression_forced: true, ..McapOptions::default() };
    let mut writer = WriterOptions::new().storage(storage).chunk_size(3_000).create(bag).unwrap();
    let topics = [
        topic::<sensor_msgs::msg::JointState>("/joint_states", QosProfile::SENSOR_DATA),
        topic::<std_msgs::msg::String>("/chatter", QosProfile::LATCHED),
        topic::<std_srvs::srv::SetBoolEvent>("/switch/_service_event", QosProfile::SERVICES),
        topic::<std_msgs::msg::String>("/silent", QosProfile::DEFAULT),
    ];
    let ids = topics.clone().map(|topic| writer.add_topic(topic).unwrap());
    let mut messages = Vec::new();
    for n in 0..300_i64 {
        let state = sensor_msgs::msg::JointState {
            name: vec!["j_pan".to_owned()],
            position: vec![n as f64 / 7.0],
            ..Default::default()
        };
        let mut data = vec![(0, cdr::to_vec(&state))];
        if n % 3 == 0 {
            data.push((1, cdr::to_vec(&std_msgs::msg::String { data: format!("hé {n}") })));
        }
        if n % 50 == 0 {
            data.push((2, cdr::to_vec(&std_srvs::srv::SetBoolEvent::default())));
        }
        for (index, data) in data {
            let publish_time = 1_700_000_000_000_000_001 + 8_000_000 * n + index as i64;
            let log_time = publish_time + 500;
            writer.write(ids[index], log_time, publish_time, &data).unwrap();
            messages.push(message_json(&topics[index].name, log_time, publish_time, &data));
        }
    }
    (writer.finish().unwrap(), topics.into(), messages)
}

#[test]
fn mcap_core_reads_every_message_of_our_bags() {
    for (name, compression) in Compression::ALL {
        let folder = tempfile::tempdir().unwrap();
        let (summary, topics, messages) = write(&folder.path().join("bag"), compression);
        let check = noted(&format!("every message, compression {name}"), With::McapCore, Way::Out);
        let Some(read) = read_with_node(&folder.path().join("bag/bag_0.mcap")) else {
            return check.skipped();
        };
        for by in ["indexed", "streamed"] {
            let read = &read[by];
            assert_eq!(read["error"], Value::Null, "{name}, {by}");
            // Counts by topic match the writer's report, in the order in which messages were received.
            let found = read["messages"].as_array().unwrap();
            for topic in &summary.topics {
                let count = found.iter().filter(|message| message[0] == topic.name.as_str()).count();
                assert_eq!(count as u64, topic.written, "{name}, {by}: {}", topic.name);
            }
            assert!(*found == messages, "{name}, {by}: the messages differ");
            for topic in &topics {
                let channel = &read["channels"][&topic.name];
                let schema = &channel["schema"];
                assert_eq!(schema["name"], topic.type_name.as_str(), "{name}, {by}");
                let of = topic.type_name.parse().unwrap();
                let (encoding, text) = downbeat_msgs::carried().schema_text(&of).unwrap();
                assert_eq!(schema["encoding"], encoding.as_str(), "{name}, {by}");
                assert_eq!(schema["text"], text, "{name}, {by}");
                assert_eq!(channel["encoding"], "cdr", "{name}, {by}");
                assert_eq!(channel["metadata"]["topic_type_hash"], topic.type_hash.as_str(), "{name}, {by}");
                let qos = channel["metadata"]["offered_qos_profiles"].as_str().unwrap();
                let profiles = downbeat_bags::metadata::qos_from_yaml(qos, Path::new("channel")).unwrap();
                assert_eq!(profiles, topic.offered_qos, "{name}, {by}");
            }
            assert_eq!(read["channels"].as_object().unwrap().len(), topics.len(), "{name}, {by}");
        }
        let indexed = &read["indexed"];
        assert_eq!(indexed["profile"], "ros2");
        assert_eq!(indexed["declared"], summary.message_count());
        assert_eq!(indexed["metadata"], json!(["rosbag2", "rosbag2"]));
        let compressions = indexed["compressions"].as_array().unwrap();
        let expected = if compression == Compression::None { "" } else { name };
        assert!(
            compressions.len() > 5 && compressions.iter().all(|compression| compression == expected),
            "{compressions:?}"
        );
    }
}

/// Shows that it verifies our checksums; otherwise reading every message would prove less.
#[test]
fn mcap_core_finds_a_changed_byte_by_our_checksums() {
    let folder = tempfile::tempdir().unwrap();
    write(&folder.path().join("bag"), Compression::None);
    let bytes = fs::read(folder.path().join("bag/bag_0.mcap")).unwrap();
    let file = folder.path().join("changed.mcap");
    let text = bytes.windows(5).position(|text| text == "hé 3".as_bytes()).unwrap();
    let summary_start = mcap::read::footer(&bytes).unwrap().summary_start as usize;
    let in_summary =
        summary_start + bytes[summary_start..].windows(7).position(|at| at == b"/silent").unwrap();
    for (at, by, words) in [
        (text, "indexed", "Incorrect chunk CRC"),
        (text, "streamed", "Incorrect chunk CRC"),
        (in_summary, "indexed", "Incorrect summary CRC"),
    ] {
        let mut changed = bytes.clone();
        changed[at] ^= 1;
        fs::write(&file, &changed).unwrap();
        let check = noted("checksums of chunks and summary", With::McapCore, Way::Out);
        let Some(read) = read_with_node(&file) else { return check.skipped() };
        let error = read[by]["error"].as_str().unwrap_or_default();
        assert!(error.contains(words), "{by} of byte {at}: {error:?}");
    }
}
