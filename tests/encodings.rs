//! Recordings in other encodings than CDR: other readers read them, and they play like CDR.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use common::{QUIET_ROBOT, output_of, python, robot_file, run_until_recorded, text_of};
use downbeat::bags::{Reader, Selection, TopicDescription, WriterOptions};
use downbeat::bridge::edge::Interfaces;
use downbeat::encoding::{RecordedType, topic_info};
use downbeat::msgs::cdr;
use downbeat::msgs::encoding::{Codec, Encoding};
use downbeat::msgs::sensor_msgs::msg::JointState;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// Records the demo without ROS 2, with more than one second of motion.
fn recorded(folder: &Path, arguments: &[&str], change: impl Fn(String) -> String) -> PathBuf {
    let (robot, bag) = (robot_file(folder, change), folder.join("bag"));
    let common = ["bag", "record", "--robot", text(&robot), "--output", text(&bag)];
    run_until_recorded(&[&common[..], arguments].concat(), &bag, "/joint_states", 150);
    bag
}

/// Topic, log time and CDR of every message, in any encoding.
fn messages(bag: &Path) -> Vec<(String, i64, Vec<u8>)> {
    let reader = Reader::open(bag).unwrap();
    let topics: Vec<RecordedType> = reader
        .topics()
        .iter()
        .map(|topic| RecordedType::of(topic, &Interfaces::carried()).unwrap())
        .collect();
    let messages = reader.messages(Selection::all()).unwrap().map(Result::unwrap);
    let of = |index: usize| (reader.topics()[index].info.name.clone(), &topics[index]);
    messages
        .map(|message| {
            let (name, topic) = of(message.topic.index());
            (name, message.log_time, topic.to_cdr(message.data).unwrap().to_vec())
        })
        .collect()
}

/// Copies the messages into another encoding.
fn encoded(bag: &Path, into: &Path, encoding: Encoding, change: impl Fn(&mut TopicDescription)) {
    let reader = Reader::open(bag).unwrap();
    let mut writer = WriterOptions::new().create(into).unwrap();
    let topics: Vec<(_, Option<Codec>)> = reader
        .topics()
        .iter()
        .map(|topic| {
            let known = Interfaces::carried().message(&topic.info.type_name).unwrap();
            let (mut info, codec) =
                topic_info(topic.info.name.clone(), known, topic.info.offered_qos.clone(), encoding).unwrap();
            change(&mut info);
            (writer.add_topic(info).unwrap(), codec)
        })
        .collect();
    for message in reader.messages(Selection::all()).unwrap().map(Result::unwrap) {
        let (id, codec) = &topics[message.topic.index()];
        let data = codec.as_ref().map_or(message.data.to_vec(), |codec| codec.encode(&message.data).unwrap());
        writer.write(*id, message.log_time, message.publish_time, &data).unwrap();
    }
    writer.finish().unwrap();
}

#[test]
fn a_robot_recorded_with_foxglove_schemas_is_read_by_mcap_and_its_protobuf_support() {
    let folder = tempfile::tempdir().unwrap();
    let bag = recorded(folder.path(), &[], |text| {
        text.replace("[record]", "[record]\nencoding = \"foxglove-protobuf\"")
    });
    let ours = messages(&bag);
    let info = text_of(&["bag", "info", text(&bag)]);
    assert!(info.contains("Type: sensor_msgs/msg/JointState") && info.contains("protobuf"), "{info}");

    let Some(found) = python("decode_protobuf_bag.py", &[&bag]) else { return };
    assert_eq!(found["schemas"]["/joint_states"], "foxglove.JointStates");
    assert_eq!(found["schemas"]["/imu/data_raw"], "sensor_msgs.msg.Imu");
    let mut counts = BTreeMap::<&str, u64>::new();
    ours.iter().for_each(|(topic, ..)| *counts.entry(topic).or_default() += 1);
    assert!(counts["/joint_states"] > 10, "{counts:?}");
    assert_eq!(found["counts"], serde_json::to_value(&counts).unwrap());

    let (_, _, last) = ours.iter().rfind(|message| message.0 == "/joint_states").unwrap();
    let last: JointState = cdr::from_slice(last).unwrap();
    let joints = found["last_joints"].as_array().unwrap();
    assert_eq!(joints.len(), last.name.len());
    for (joint, (name, position)) in joints.iter().zip(last.name.iter().zip(&last.position)) {
        // A servo that did not answer in time has no position; JSON has no NaN.
        let position = position.is_finite().then_some(*position);
        assert_eq!((joint["name"].as_str(), joint["position"].as_f64()), (Some(name.as_str()), position));
    }
}

#[test]
fn a_bag_plays_into_a_robot_identically_in_all_encodings() {
    let folder = tempfile::tempdir().unwrap();
    let bag = recorded(folder.path(), &[], |text| text);
    let robot = folder.path().join("motion_only.toml");
    std::fs::write(&robot, QUIET_ROBOT).unwrap();
    let play = |bag: &Path, name: &str, arguments: &[&str]| {
        let output = folder.path().join(name);
        let common = ["bag", "play", text(bag), "--into", text(&robot), "--record", text(&output)];
        text_of(&[&common[..], arguments].concat());
        messages(&output)
    };
    let expected = play(&bag, "expected", &[]);
    assert!(expected.iter().filter(|message| message.0 == "/joint_goals").count() > 100);
    for encoding in [Encoding::Json, Encoding::Cbor, Encoding::Protobuf, Encoding::FlatBuffers] {
        let other = folder.path().join(format!("{encoding}_bag"));
        encoded(&bag, &other, encoding, |_| {});
        assert_eq!(messages(&other), messages(&bag), "{encoding}");
        assert_eq!(play(&other, &format!("from_{encoding}"), &[]), expected, "{encoding}");
        let name = format!("to_{encoding}");
        assert_eq!(play(&bag, &name, &["--encoding", encoding.as_str()]), expected, "{encoding}");
        let reader = Reader::open(folder.path().join(name)).unwrap();
        let formats = reader.topics().iter().map(|topic| topic.serialization_format.as_str());
        assert!(
            formats.clone().count() > 0
                && formats.clone().all(|format| format == encoding.message_encoding())
        );
    }
}

#[test]
fn messages_of_another_definition_or_unknown_encoding_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let bag = recorded(folder.path(), &[], |text| text);
    let robot = folder.path().join("motion_only.toml");
    std::fs::write(&robot, QUIET_ROBOT).unwrap();
    let refused = |name: &str, change: &dyn Fn(&mut TopicDescription)| {
        let other = folder.path().join(name);
        encoded(&bag, &other, Encoding::Protobuf, change);
        let output = output_of(&["bag", "play", text(&other), "--into", text(&robot)]);
        assert!(!output.status.success());
        String::from_utf8(output.stderr).unwrap()
    };
    let error = refused("old", &|info| info.type_hash = format!("RIHS01_{}", "0".repeat(64)));
    assert!(error.contains("was recorded with another definition of "), "{error}");
    let error = refused("msgpack", &|info| info.format.as_mut().unwrap().message_encoding = "msgpack".into());
    assert!(error.contains("holds messages in \"msgpack\", which is not supported"), "{error}");
}
