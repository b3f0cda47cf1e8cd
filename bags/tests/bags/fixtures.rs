//! Bags of the real recorder, compared with the output of its own tools.

use std::fs;
use std::path::Path;

use downbeat_bags::metadata::{FILE_NAME, Metadata, RecordedQos};
use downbeat_bags::{BagInfo, Reader, RecordedTopic, Selection, WriterOptions};
use downbeat_msgs::dynamic::Definitions;

use crate::matrix::{Way, With};
use crate::support::{fixture, messages, noted};

const FIXTURES: [&str; 2] = ["jazzy_mcap", "jazzy_mcap_zstd"];

#[test]
fn real_bags_are_read_and_counts_match_their_metadata() {
    for (name, layout) in FIXTURES.into_iter().zip(["storage mcap", "storage mcap, zstd_fast"]) {
        let _check = noted(&format!("a recorded bag, {layout}"), With::Rosbag2, Way::In);
        let reader = Reader::open(fixture(name)).unwrap();
        let metadata = Metadata::read(&fixture(name).join(FILE_NAME)).unwrap();
        assert_eq!(reader.truncation().count(), 0, "{name}");
        let messages: Vec<_> =
            reader.messages(Selection::all()).unwrap().map(|message| message.unwrap()).collect();
        assert_eq!(messages.len() as u64, metadata.message_count, "{name}");
        assert!(messages.is_sorted_by_key(|message| message.log_time), "{name}");
        assert_eq!(messages[0].log_time, metadata.starting_time, "{name}");
        assert_eq!(reader.topics().len(), metadata.topics.len(), "{name}");
        for (index, recorded) in metadata.topics.iter().enumerate() {
            let read = messages.iter().filter(|message| message.topic.index() == index).count();
            assert_eq!(read as u64, recorded.message_count, "{name}: {}", recorded.name);
            assert_eq!(
                reader.topics()[index].message_count,
                recorded.message_count,
                "{name}: {}",
                recorded.name
            );
        }
    }
}

#[test]
fn real_topics_have_definition_hash_and_quality_of_service() {
    let reader = Reader::open(fixture("jazzy_mcap")).unwrap();
    let id = reader.topic("/reference/joint_states").unwrap();
    let info = &reader.topics()[id.index()].info;
    assert_eq!(info.type_name, "sensor_msgs/msg/JointState");
    assert!(info.definition.contains("float64[] position"));
    assert!(info.definition.contains("MSG: std_msgs/Header"));
    assert!(info.type_hash.starts_with("RIHS01_a13ee3a3"));
    let heard = RecordedQos::from(downbeat_msgs::qos::QosProfile::DEFAULT).without_history();
    assert_eq!(info.offered_qos, [heard]);
}

#[test]
fn metadata_yaml_is_written_byte_for_byte_like_the_real_recorder() {
    let _check = noted("metadata.yaml, byte for byte", With::Rosbag2, Way::Both);
    for name in FIXTURES {
        let path = fixture(name).join(FILE_NAME);
        let text = fs::read_to_string(&path).unwrap();
        assert_eq!(Metadata::parse(&text, &path).unwrap().to_yaml(), text, "{name}");
    }
}

/// The real bag recorded again by our writer.
#[test]
fn a_real_bag_written_again_has_the_same_metadata_and_messages() {
    let folder = tempfile::tempdir().unwrap();
    let copy = folder.path().join("jazzy_mcap");
    let reader = Reader::open(fixture("jazzy_mcap")).unwrap();
    let mut writer = WriterOptions::new().create(&copy).unwrap();
    let mut ids = Vec::new();
    for topic in reader.topics() {
        ids.push(writer.add_topic(topic.info.clone()).unwrap());
    }
    for message in messages(&reader) {
        let id = ids[message.topic.index()];
        writer.write(id, message.log_time, message.publish_time, &message.data).unwrap();
    }
    writer.finish().unwrap();

    let metadata = |bag: &Path| fs::read_to_string(bag.join(FILE_NAME)).unwrap();
    assert_eq!(metadata(&copy), metadata(&fixture("jazzy_mcap")));
    let again = Reader::open(&copy).unwrap();
    assert_eq!(messages(&again), messages(&reader));
    // The type of the service's events is not a message, so the real recorder has no ros2msg text for it;
    // ours is IDL, without comments.
    let definitions = |reader: &Reader| -> Vec<String> {
        let topics = reader.topics().iter().filter(|topic| !topic.info.type_name.contains("/srv/"));
        topics.map(|topic| topic.info.definition.clone()).collect()
    };
    let known = Definitions::new();
    for (topic, ours) in reader.topics().iter().zip(again.topics()) {
        let hash = |topic: &RecordedTopic| topic.info.definition_with(&known).unwrap().definition.hash;
        assert_eq!(hash(ours), hash(topic), "{}", topic.info.name);
    }
    assert_eq!(definitions(&again), definitions(&reader));
}

#[test]
fn info_equals_the_output_of_ros2_bag_info() {
    let _check = noted("`bag info` prints the same", With::Rosbag2, Way::In);
    // From `ros2 bag info jazzy_mcap` of Jazzy; see tests/data/README.md. The program adds the last line
    // break.
    let expected = fs::read_to_string(fixture("jazzy_mcap_info.txt")).unwrap();
    let reader = Reader::open(fixture("jazzy_mcap")).unwrap();
    assert_eq!(format!("{}\n", BagInfo::of(&reader).unwrap()), expected);
}

#[test]
fn a_directory_without_metadata_yaml_and_a_bare_file_open_too() {
    let folder = tempfile::tempdir().unwrap();
    let file = fixture("jazzy_mcap").join("jazzy_mcap_0.mcap");
    fs::copy(&file, folder.path().join("jazzy_mcap_0.mcap")).unwrap();
    let whole = Reader::open(fixture("jazzy_mcap")).unwrap();
    for path in [folder.path(), file.as_path()] {
        let reader = Reader::open(path).unwrap();
        assert_eq!(messages(&reader), messages(&whole), "{}", path.display());
        assert_eq!(reader.topics(), whole.topics());
        assert_eq!(reader.metadata().unwrap().ros_distro, "jazzy", "from the record in the file");
        let info = BagInfo::of(&reader).unwrap();
        assert_eq!(info.files, [if path.is_dir() { "jazzy_mcap_0.mcap" } else { file.to_str().unwrap() }]);
    }
}
