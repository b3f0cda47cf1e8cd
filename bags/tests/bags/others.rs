//! Bags of other writers: `rosbags`, `mcap-ros2-support` and the `mcap` crate, other storages, compressed
//! files, older metadata.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use downbeat_bags::{BagInfo, Comparer, Reader, ReaderError, check};
use mcap::records::MessageHeader;

use crate::matrix::{Check, Way, With};
use crate::python::read_with_python;
use crate::support::{fixture, messages, noted, number, value};

#[test]
fn bags_of_other_writers_are_read_message_by_message() {
    let folder = tempfile::tempdir().unwrap();
    let Some(bags) = read_with_python("write_bags.py", folder.path()) else { return };
    let bags = bags.as_object().unwrap();
    assert_eq!(bags.len(), 17);
    for (name, expected) in bags {
        let path = folder.path().join(name);
        if name.contains("sqlite3") && !cfg!(feature = "sqlite") {
            assert_is_refused(&path);
            continue;
        }
        let _check = note(name);
        let reader = Reader::open(&path).unwrap_or_else(|error| panic!("{name}: {error}"));
        assert_eq!(reader.truncation().next(), None, "{name}");
        let comparers: Vec<_> = reader.topics().iter().map(|topic| Comparer::new(&topic.info, &[])).collect();
        let read = messages(&reader);
        let expected = expected.as_array().unwrap();
        assert_eq!(read.len(), expected.len(), "{name}");
        for (message, expected) in read.iter().zip(expected) {
            let topic = &reader.topics()[message.topic.index()];
            assert_eq!(topic.info.name, expected[0].as_str().unwrap(), "{name}");
            assert_eq!(message.log_time, expected[1].as_i64().unwrap(), "{name}");
            let data = bytes(expected[2].as_str().unwrap());
            let difference = comparers[message.topic.index()].compare(&data, &message.data);
            assert_eq!(difference, None, "{name}: {}", topic.info.name);
        }
        let info = BagInfo::of(&reader).unwrap().to_string();
        assert!(info.contains("Messages:          400\n"), "{name}: {info}");
        assert!(info.contains("Topic: /chatter | Type: std_msgs/msg/String | Count: 200"), "{name}: {info}");
    }
}

#[test]
fn test_bags_of_rosbags_rs_are_read_message_by_message() {
    let mut bags = vec!["rosbags_rs/test_bag_mcap"];
    if cfg!(feature = "sqlite") {
        bags.push("rosbags_rs/test_bag_sqlite3");
    }
    for bag in bags {
        let reader = Reader::open(fixture(bag)).unwrap();
        assert_eq!(reader.truncation().next(), None, "{bag}");
        let counts: Vec<u64> = reader.topics().iter().map(|topic| topic.message_count).collect();
        assert_eq!(counts, [2; 94], "{bag}: two messages of each type");
        let found = check(&reader, |_| {}).unwrap();
        assert_eq!(found.messages, 188, "{bag}");
        if reader.storage_identifier() == "mcap" {
            // It has no definition of std_msgs/msg/Empty, which is carried.
            assert_eq!(found.decoded, 188, "{bag}: {:?}", found.problems);
        }
    }
}

#[test]
fn files_of_the_mcap_crate_are_read_in_any_layout() {
    let whole = || mcap::WriteOptions::new().compression(None).profile("ros2").chunk_size(Some(2000));
    let layouts = [
        whole(),
        whole().use_chunks(false),
        whole().emit_message_indexes(false),
        whole().emit_chunk_indexes(false),
        whole().emit_statistics(false),
        whole().repeat_channels(false).repeat_schemas(false),
        whole().emit_summary_records(false).emit_summary_offsets(false),
    ];
    for (layout, options) in layouts.into_iter().enumerate() {
        let mut file = std::io::Cursor::new(Vec::new());
        let mut writer = options.create(&mut file).unwrap();
        let schema = writer.add_schema("std_msgs/msg/Int64", "ros2msg", b"int64 data\n").unwrap();
        let channels =
            ["/a", "/b"].map(|topic| writer.add_channel(schema, topic, "cdr", &BTreeMap::new()).unwrap());
        for n in 0..200_u32 {
            let channel_id = channels[usize::from(n % 10 == 0)];
            let (log_time, publish_time) = (u64::from(n), u64::from(n / 2));
            let header = MessageHeader { channel_id, sequence: n, log_time, publish_time };
            writer.write_to_known_channel(&header, &number(n.into())).unwrap();
        }
        let name = "calibration".to_owned();
        let data = vec![1; 100].into();
        let (log_time, create_time, media_type) = (1, 2, "application/octet-stream".to_owned());
        writer.attach(&mcap::Attachment { log_time, create_time, name, media_type, data }).unwrap();
        writer.finish().unwrap();
        drop(writer);
        let reader = Reader::from_bytes("of_the_crate.mcap", file.into_inner()).unwrap();
        assert_eq!(reader.truncation().next(), None, "layout {layout}");
        let read: Vec<_> = messages(&reader)
            .iter()
            .map(|message| (message.topic.index(), message.log_time, message.publish_time, value(message)))
            .collect();
        let written: Vec<_> = (0..200).map(|n| (usize::from(n % 10 == 0), n, n / 2, n)).collect();
        assert_eq!(read, written, "layout {layout}");
        let counts: Vec<u64> = reader.topics().iter().map(|topic| topic.message_count).collect();
        assert_eq!(counts, [180, 20], "layout {layout}");
    }
}

/// The note for a bag name of `write_bags.py`.
fn note(bag: &str) -> Check {
    match bag.split('_').collect::<Vec<_>>().as_slice() {
        ["rosbags", _, storage, mode] => {
            noted(&format!("storage {storage}, compression mode {mode}"), With::Rosbags, Way::In)
        }
        ["mcap", "ros2", compression] => {
            let compression = compression.trim_end_matches(".mcap");
            noted(&format!("every message, compression {compression}"), With::McapRos2, Way::In)
        }
        _ => panic!("{bag}: written by whom?"),
    }
}

fn bytes(hex: &str) -> Vec<u8> {
    (0..hex.len() / 2).map(|n| u8::from_str_radix(&hex[2 * n..2 * n + 2], 16).unwrap()).collect()
}

fn assert_is_refused(bag: &Path) {
    let error = Reader::open(bag).unwrap_err();
    assert!(matches!(error, ReaderError::Unsupported { .. }), "{error}");
    assert!(error.to_string().contains("--features sqlite"), "{error}");
}

#[test]
fn a_bag_of_the_real_recorder_in_sqlite_is_read() {
    let bag = fixture("jazzy_sqlite3");
    if !cfg!(feature = "sqlite") {
        return assert_is_refused(&bag);
    }
    let _check = noted("a recorded bag, storage sqlite3", With::Rosbag2, Way::In);
    let reader = Reader::open(&bag).unwrap();
    let metadata = reader.metadata().unwrap().clone();
    assert_eq!((reader.storage_identifier(), metadata.storage_identifier.as_str()), ("sqlite3", "sqlite3"));
    let read = messages(&reader);
    assert_eq!(read.len() as u64, metadata.message_count);
    assert!(read.is_sorted_by_key(|message| message.log_time));
    assert_eq!(read[0].log_time, metadata.starting_time);
    assert_eq!(reader.duration(), metadata.duration);
    for (expected, found) in metadata.topics.iter().zip(reader.topics()) {
        assert_eq!(found.message_count, expected.message_count, "{}", expected.name);
        assert_eq!(found.info.type_hash, expected.type_hash, "{}", expected.name);
    }
    let joints = reader.topic("/reference/joint_states").unwrap();
    assert!(reader.topics()[joints.index()].info.definition.contains("MSG: std_msgs/Header"));
    // Without metadata.yaml, and as a bare file, it is the same bag.
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("jazzy_sqlite3_0.db3");
    fs::copy(bag.join("jazzy_sqlite3_0.db3"), &file).unwrap();
    for path in [folder.path(), &file] {
        assert_eq!(messages(&Reader::open(path).unwrap()).len(), read.len(), "{}", path.display());
    }
}

#[cfg(feature = "sqlite")]
#[test]
fn intact_parts_of_a_damaged_sqlite_file_are_read_and_the_rest_is_reported() {
    let file = fixture("jazzy_sqlite3").join("jazzy_sqlite3_0.db3");
    let whole = fs::read(&file).unwrap();
    let count = messages(&Reader::open(&file).unwrap()).len();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.db3");
    let (mut recovered, mut opened) = (0, 0);
    // A page of SQLite is 4 KiB.
    for page in 1..whole.len() / 4096 {
        let mut damaged = whole.clone();
        damaged[page * 4096..(page + 1) * 4096].fill(0xa5);
        fs::write(&path, &damaged).unwrap();
        let Ok(reader) = Reader::open(&path) else { continue };
        opened += 1;
        let read = messages(&reader).len();
        assert!(read <= count, "page {page}");
        if read < count && read > 0 {
            recovered += 1;
            let is_told = reader.truncation().count() > 0
                || reader.messages(downbeat_bags::Selection::all()).unwrap().any(|read| read.is_err());
            assert!(is_told, "page {page}: {read} of {count} messages");
        }
    }
    assert!(opened > 20 && recovered > 10, "{opened} opened, {recovered} with some of the messages");
    for length in [0, 100, 4096, 50_000, whole.len() - 5000] {
        fs::write(&path, &whole[..length]).unwrap();
        if let Ok(reader) = Reader::open(&path) {
            assert!(messages(&reader).len() <= count);
        }
    }
}

/// Everything before the damage in a truncated or altered compressed file is read.
#[test]
fn a_damaged_compressed_file_is_read_as_far_as_it_decompresses() {
    let folder = tempfile::tempdir().unwrap();
    let whole = fs::read(fixture("jazzy_mcap").join("jazzy_mcap_0.mcap")).unwrap();
    let count = messages(&Reader::open(fixture("jazzy_mcap")).unwrap()).len();
    let path = folder.path().join("run_0.mcap.zstd");
    let packed = ruzstd::encoding::compress_to_vec(&*whole, ruzstd::encoding::CompressionLevel::Fastest);
    fs::write(&path, &packed).unwrap();
    for opened in [path.as_path(), folder.path()] {
        let reader = Reader::open(opened).unwrap();
        assert_eq!(messages(&reader).len(), count);
        assert_eq!(reader.truncation().next(), None);
    }
    fs::write(&path, &packed[..packed.len() - 100]).unwrap();
    let reader = Reader::open(&path).unwrap();
    assert!(reader.truncation().any(|lost| lost.to_string().contains("cannot be decompressed completely")));
    fs::write(&path, &packed[..20]).unwrap();
    drop(Reader::open(&path));
}

#[test]
fn a_bag_file_in_memory_is_read_like_one_on_disk() {
    let mut files = vec![fixture("jazzy_mcap").join("jazzy_mcap_0.mcap")];
    if cfg!(feature = "sqlite") {
        files.push(fixture("jazzy_sqlite3").join("jazzy_sqlite3_0.db3"));
    }
    for file in files {
        let on_disk = Reader::open(&file).unwrap();
        let bytes = fs::read(&file).unwrap();
        // Decompresses to less than the in-memory limit, then to more.
        let packed = ruzstd::encoding::compress_to_vec(&*bytes, ruzstd::encoding::CompressionLevel::Fastest);
        let mut long = bytes.clone();
        long.resize(3 * 1024 * 1024, 0);
        let long = ruzstd::encoding::compress_to_vec(&*long, ruzstd::encoding::CompressionLevel::Fastest);
        for (bytes, is_whole) in [(bytes, true), (packed, true), (long, false)] {
            let reader = Reader::from_bytes("received", bytes).unwrap();
            assert_eq!(messages(&reader), messages(&on_disk), "{}", file.display());
            assert_eq!(reader.files().collect::<Vec<_>>(), [Path::new("received")]);
            if is_whole {
                assert_eq!(reader.topics(), on_disk.topics());
                assert_eq!(reader.truncation().next(), None);
            }
        }
    }
    let error = Reader::from_bytes("received", &b"<html>"[..]).unwrap_err().to_string();
    assert!(error.contains("received is not an MCAP file"), "{error}");
}

const OLD: &str = "rosbag2_bagfile_information:
  version: VERSION
  storage_identifier: mcap
  relative_file_paths:
    - PATH
  duration:
    nanoseconds: 3700000000
  starting_time:
    nanoseconds_since_epoch: 1795230923877473869
  message_count: 3
  topics_with_message_count:
    - topic_metadata:
        name: /reference/robot_description
        type: std_msgs/msg/String
        serialization_format: cdrTOPIC
      message_count: 1
";

#[test]
fn metadata_of_every_version_is_read() {
    let qos =
        "\n        offered_qos_profiles: \"- history: 3\\n  depth: 0\\n  reliability: 1\\n  durability: 1\"";
    let hash = "\n        type_description_hash: RIHS01_ab";
    let compression = "  compression_format: \"\"\n  compression_mode: \"\"\n";
    let files = "  files:\n    - path: run_0.mcap\n      starting_time:\n        nanoseconds_since_epoch: 0\n      \
                 duration:\n        nanoseconds: 5\n      message_count: 3\n";
    let custom = "  custom_data:\n    run: 7\n";
    // That of a later ROS too, as far as it is the same.
    for version in 1..=10 {
        let folder = tempfile::tempdir().unwrap();
        let bag = folder.path().join("run");
        fs::create_dir(&bag).unwrap();
        fs::copy(fixture("jazzy_mcap").join("jazzy_mcap_0.mcap"), bag.join("run_0.mcap")).unwrap();
        let topic = match version {
            1..=3 => String::new(),
            4..=6 => qos.to_owned(),
            _ => format!("{qos}{hash}"),
        };
        let mut text = OLD.replace("VERSION", &version.to_string()).replace("TOPIC", &topic);
        text = text.replace("PATH", if version < 4 { "run/run_0.mcap" } else { "run_0.mcap" });
        for (since, part) in [(3, compression), (5, files), (6, custom), (8, "  ros_distro: rolling\n")] {
            if version >= since {
                text.push_str(part);
            }
        }
        fs::write(bag.join("metadata.yaml"), text).unwrap();
        let reader = Reader::open(&bag).unwrap_or_else(|error| panic!("version {version}: {error}"));
        let metadata = reader.metadata().unwrap();
        assert_eq!(metadata.version, version);
        assert_eq!(metadata.files.len(), usize::from(version >= 5), "version {version}");
        assert_eq!(metadata.ros_distro, if version >= 8 { "rolling" } else { "" });
        assert_eq!(metadata.topics[0].offered_qos.len(), usize::from(version >= 4));
        assert!(messages(&reader).len() > 100, "version {version}");
    }
}

#[test]
fn an_unsupported_bag_is_refused_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let yaml = folder.path().join("metadata.yaml");
    let whole = OLD.replace("VERSION", "9").replace("TOPIC", "").replace("PATH", "run_0.mcap");
    fs::write(&yaml, whole.replace("storage_identifier: mcap", "storage_identifier: rocks")).unwrap();
    let error = Reader::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("its storage is rocks; supported are mcap and sqlite3"), "{error}");
    fs::write(&yaml, format!("{whole}  compression_format: lz77\n  compression_mode: FILE\n")).unwrap();
    let error = Reader::open(folder.path()).unwrap_err().to_string();
    assert!(error.contains("compressed with \"lz77\""), "{error}");
}
