//! Our bags, read by other software: `mcap`, `mcap-ros2-support` and `rosbags` from PyPI.

use std::path::Path;

use downbeat_bags::metadata::HUMBLE_VERSION;
use downbeat_bags::{Compression, Reader, TopicDescription, WriterOptions};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::{Message, cdr};
use downbeat_msgs::{diagnostic_msgs, downbeat_interfaces, sensor_msgs, std_msgs};
use python_peer::Python;
use serde_json::{Value, json};

use crate::matrix::{Way, With};
use crate::support::noted;

/// A topic of messages of that type.
pub fn topic<M: Message>(name: &str, qos: QosProfile) -> TopicDescription {
    TopicDescription {
        name: name.to_owned(),
        type_name: M::TYPE_NAME.to_owned(),
        definition: M::DEFINITION.to_owned(),
        type_hash: M::TYPE_HASH.to_owned(),
        offered_qos: vec![qos.into()],
        format: None,
    }
}

/// The output of a program in `tests/python` for a bag; `None` without Python.
pub fn read_with_python(program: &str, bag: &Path) -> Option<Value> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python").join(program);
    Some(serde_json::from_str(&Python::find()?.run(script, &[bag])).unwrap())
}

#[test]
fn other_software_decodes_every_message_of_our_bags() {
    for (compression_name, compression) in Compression::ALL {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("bag");
        let options = WriterOptions::new().compression(compression).chunk_size(20_000);
        let mut writer = options.custom_data("emulated", "true").create(&bag).unwrap();
        let joints =
            writer.add_topic(topic::<sensor_msgs::msg::JointState>("/joint_states", QosProfile::DEFAULT));
        let imu = writer.add_topic(topic::<sensor_msgs::msg::Imu>("/imu", QosProfile::SENSOR_DATA));
        let chatter = writer.add_topic(topic::<std_msgs::msg::String>("/chatter", QosProfile::LATCHED));
        let diagnostics = writer
            .add_topic(topic::<diagnostic_msgs::msg::DiagnosticArray>("/diagnostics", QosProfile::DEFAULT));
        let exchanges = writer
            .add_topic(topic::<downbeat_interfaces::msg::BusExchange>("/bus/exchanges", QosProfile::DEFAULT));
        let silent = writer.add_topic(topic::<std_msgs::msg::String>("/silent", QosProfile::DEFAULT));
        silent.unwrap();

        let mut time = 1_700_000_000_000_000_000;
        for n in 0..300_u32 {
            time += 8_000_000;
            let mut write = |id, data: Vec<u8>| writer.write(id, time + 500, time, &data).unwrap();
            let state = sensor_msgs::msg::JointState {
                name: vec!["j_pan".to_owned(), "j_tilt".to_owned()],
                position: vec![f64::from(n) / 100.0, -1.5],
                ..Default::default()
            };
            write(*joints.as_ref().unwrap(), cdr::to_vec(&state));
            write(*imu.as_ref().unwrap(), cdr::to_vec(&sensor_msgs::msg::Imu::default()));
            let exchange = downbeat_interfaces::msg::BusExchange {
                instruction: vec![0xff, 0xff, 1, 2, 1, 0xfb],
                sequence: u64::from(n),
                ..Default::default()
            };
            write(*exchanges.as_ref().unwrap(), cdr::to_vec(&exchange));
            if n % 100 == 0 {
                write(
                    *chatter.as_ref().unwrap(),
                    cdr::to_vec(&std_msgs::msg::String { data: format!("hé {n}") }),
                );
                write(
                    *diagnostics.as_ref().unwrap(),
                    cdr::to_vec(&diagnostic_msgs::msg::DiagnosticArray::default()),
                );
            }
        }
        let summary = writer.finish().unwrap();
        let Some(read) = read_with_python("read_bag.py", &bag) else { return };
        let feature = format!("every message, compression {compression_name}");
        let _checks = [With::Mcap, With::McapRos2, With::Rosbags].map(|with| noted(&feature, with, Way::Out));
        let _check = noted("metadata.yaml: quality of service, custom data", With::Rosbags, Way::Out);

        for reader in ["mcap", "any", "rosbag2"] {
            for topic in &summary.topics {
                let count = read[reader]["counts"].get(&topic.name).and_then(Value::as_u64).unwrap_or(0);
                assert_eq!(count, topic.written, "{reader}: {}", topic.name);
            }
        }
        for reader in ["mcap", "any"] {
            assert_eq!(read[reader]["text"], json!("hé 200"), "{reader}");
            assert_eq!(read[reader]["position"], json!([2.99, -1.5]), "{reader}");
        }
        assert_eq!(read["any"]["types"]["/bus/exchanges"], json!("downbeat_interfaces/msg/BusExchange"));
        assert_eq!(read["rosbag2"]["custom_data"], json!({ "emulated": "true" }));
        assert_eq!(read["rosbag2"]["distro"], json!("jazzy"));
        assert!(read["rosbag2"]["qos"]["/chatter"][0].as_str().unwrap().contains("TRANSIENT_LOCAL"));
    }
}

#[test]
fn other_software_opens_a_bag_without_messages() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    writer.add_topic(topic::<std_msgs::msg::String>("/silent", QosProfile::DEFAULT)).unwrap();
    writer.finish().unwrap();
    let Some(read) = read_with_python("count_messages.py", &bag) else { return };
    let _checks = [With::Mcap, With::Rosbags].map(|with| noted("a bag without messages", with, Way::Out));
    assert_eq!(read, json!({ "mcap": 0, "rosbag2": 0, "topics": ["/silent"] }));
}

/// The state of a bag after killing the recorder: no end mark, metadata.yaml from the last flush.
#[test]
fn other_software_finds_topics_and_counts_of_an_unfinished_bag() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let id = writer.add_topic(topic::<std_msgs::msg::String>("/chatter", QosProfile::DEFAULT)).unwrap();
    let data = cdr::to_vec(&std_msgs::msg::String { data: "hi".to_owned() });
    for time in 0..5 {
        writer.write(id, time, time, &data).unwrap();
    }
    writer.flush().unwrap();
    let Some(read) = read_with_python("count_metadata.py", &bag) else { return };
    let _check =
        noted("a bag that is still being recorded, or whose recorder was killed", With::Mcap, Way::Out);
    assert_eq!(read, json!({ "message_count": 5, "topics": { "/chatter": 5 }, "mcap": 5 }));
}

#[test]
fn a_bag_for_humble_has_its_version_and_numbers_for_policies() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let mut writer = WriterOptions::new().metadata_version(HUMBLE_VERSION).create(&bag).unwrap();
    let id = writer.add_topic(topic::<std_msgs::msg::String>("/chatter", QosProfile::LATCHED)).unwrap();
    let silent = topic::<std_msgs::msg::String>("/silent", QosProfile::SENSOR_DATA);
    writer.add_topic(TopicDescription { offered_qos: Vec::new(), ..silent }).unwrap();
    let data = cdr::to_vec(&std_msgs::msg::String { data: "hi".to_owned() });
    for time in 0..3 {
        writer.write(id, time, time, &data).unwrap();
    }
    writer.finish().unwrap();
    let reader = Reader::open(&bag).unwrap();
    assert_eq!(reader.metadata().unwrap().version, HUMBLE_VERSION);
    assert_eq!(reader.topics()[0].info.offered_qos, [QosProfile::LATCHED.into()]);
    let Some(read) = read_with_python("read_humble.py", &bag) else { return };
    // Keep last 1, reliable, transient local, automatic.
    let qos = json!({ "/chatter": [[1, 1, 1, 1, 1]], "/silent": [] });
    let of_file = json!({ "/chatter": [[1, 1, 1, 1, 1]], "/silent": [] });
    assert_eq!(read, json!({ "version": 5, "qos": qos, "in_file": of_file, "messages": 3 }));
}
