//! Commands that show, check, repair, merge, cut and compare bags.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use common::{QUIET_ROBOT, open_with_stock_readers, output_of, text_of};
use downbeat::bags::metadata::{Metadata, RecordedQos};
use downbeat::bags::{
    McapOptions, Reader, Selection, Storage, StorageOptions, TopicDescription, WriterOptions,
};
use downbeat::msgs::qos::QosProfile;
use test_machine::free_domain;

fn text(path: &Path) -> &str {
    path.to_str().unwrap()
}

/// A bag of the real recorder.
fn real() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("bags/tests/data/jazzy_mcap")
}

fn count(bag: &Path) -> usize {
    Reader::open(bag).unwrap().messages(Selection::all()).unwrap().filter(Result::is_ok).count()
}

fn json(arguments: &[&str]) -> serde_json::Value {
    serde_json::from_slice(&output_of(arguments).stdout).unwrap()
}

#[test]
fn info_prints_what_ros2_bag_info_prints_and_more() {
    let bag = real();
    let expected = std::fs::read_to_string(bag.with_file_name("jazzy_mcap_info.txt")).unwrap();
    assert_eq!(text_of(&["bag", "info", text(&bag)]).trim_end(), expected.trim_end());
    let names = text_of(&["bag", "info", text(&bag), "--topic-name"]);
    assert!(names.lines().any(|name| name == "/tf") && !names.contains("_service_event"), "{names}");
    let counts = |order: &str| -> Vec<u64> {
        let info = text_of(&["bag", "info", "--sort", order, text(&bag)]);
        let counts = info.split("| Count: ").skip(1).map(|rest| rest.split(' ').next().unwrap().parse());
        counts.collect::<Result<_, _>>().unwrap()
    };
    assert!(counts("count").is_sorted() && !counts("type").is_sorted(), "{:?}", counts("count"));
    let verbose = text_of(&["bag", "info", "-v", text(&bag)]);
    assert!(verbose.contains("Request Count: 17 | Response Count: 18 | Size Contribution: "), "{verbose}");
    let file = bag.join("jazzy_mcap_0.mcap");
    let info = json(&["bag", "info", text(&file), "--json", "--verbose"]);
    assert_eq!(info["storage_identifier"], "mcap");
    assert_eq!(info["services"][0]["request_count"], 17);
    let topics = info["topics"].as_array().unwrap();
    let image = topics.iter().find(|topic| topic["name"] == "/reference/camera/image_raw").unwrap();
    assert_eq!(image["type"], "sensor_msgs/msg/Image");
    assert!(image["bytes"].as_u64().unwrap() > 1000 && image["has_definition"] == true);
}

#[test]
fn a_bag_is_checked_and_a_damaged_one_is_repaired() {
    let folder = tempfile::tempdir().unwrap();
    assert!(text_of(&["bag", "check", text(&real())]).contains("found 0 problems"));
    let bytes = std::fs::read(real().join("jazzy_mcap_0.mcap")).unwrap();
    let damaged = folder.path().join("run_0.mcap");
    std::fs::write(&damaged, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let output = output_of(&["bag", "check", text(&damaged)]);
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(
        !output.status.success() && printed.contains("recording or copying was interrupted"),
        "{printed}"
    );
    text_of(&["bag", "repair", text(&damaged)]);
    let repaired = folder.path().join("run_0_repaired");
    assert_eq!(count(&repaired), count(&damaged));
    assert!(text_of(&["bag", "check", text(&repaired)]).contains("found 0 problems"));
    std::fs::remove_file(repaired.join("metadata.yaml")).unwrap();
    let printed = text_of(&["bag", "reindex", text(&repaired)]);
    assert!(printed.contains(&format!("of {} messages", count(&damaged))), "{printed}");
    assert!(text_of(&["bag", "check", text(&repaired)]).contains("found 0 problems"));
    open_with_stock_readers(&repaired);
}

/// What others know of a bag beside its messages.
fn described(bag: &Path) -> (String, String, BTreeMap<String, String>, Vec<Vec<RecordedQos>>) {
    let Metadata { storage_identifier, ros_distro, custom_data, topics, .. } =
        Metadata::read(&bag.join("metadata.yaml")).unwrap();
    (storage_identifier, ros_distro, custom_data, topics.into_iter().map(|topic| topic.offered_qos).collect())
}

#[test]
fn what_a_bag_says_of_itself_survives_reindexing_repair_and_conversion() {
    let folder = tempfile::tempdir().unwrap();
    let mut storages = vec![Storage::Mcap];
    storages.extend(StorageOptions::of(Storage::Sqlite3).is_ok().then_some(Storage::Sqlite3));
    for storage in storages {
        let bag = folder.path().join(storage.identifier());
        let options = WriterOptions::new().storage(StorageOptions::of(storage).unwrap());
        let options = options.custom_data("place", "lawn").ros_distro("humble");
        let mut writer = options.create(&bag).unwrap();
        let info = TopicDescription {
            name: "/chatter".to_owned(),
            type_name: "std_msgs/msg/String".to_owned(),
            definition: "string data\n".to_owned(),
            // Of two publishers.
            offered_qos: vec![QosProfile::LATCHED.into(), QosProfile::SENSOR_DATA.into()],
            ..TopicDescription::default()
        };
        let topic = writer.add_topic(info).unwrap();
        writer.write(topic, 1_000, 1_000, b"\x00\x01\x00\x00\x03\x00\x00\x00hi\x00").unwrap();
        writer.finish().unwrap();
        let original = described(&bag);
        assert_eq!((original.1.as_str(), original.3[0].len()), ("humble", 2));

        std::fs::remove_file(bag.join("metadata.yaml")).unwrap();
        text_of(&["bag", "reindex", text(&bag)]);
        assert_eq!(described(&bag), original, "reindexed");
        let repaired = folder.path().join(format!("{storage}_repaired"));
        text_of(&["bag", "repair", text(&bag)]);
        assert_eq!(described(&repaired), original, "repaired");
        let converted = folder.path().join(format!("{storage}_converted"));
        text_of(&["bag", "convert", text(&bag), "-s", storage.identifier(), "-o", text(&converted)]);
        assert_eq!(described(&converted), original, "converted");
        if storage == Storage::Mcap {
            [bag, repaired, converted].iter().for_each(|bag| open_with_stock_readers(bag));
        }
    }
}

#[test]
fn bags_are_filtered_merged_cut_and_compared() {
    let folder = tempfile::tempdir().unwrap();
    let bag = real();
    let at = |name: &str| folder.path().join(name);
    let part = |name: &str, options: &[&str]| {
        text_of(&[&["bag", "convert", text(&bag), "--output", text(&at(name))], options].concat());
    };
    part("imu", &["--topics", "/reference/imu/data_raw", "--compression", "zstd"]);
    part("rest", &["--exclude-topics", "/reference/imu/data_raw"]);
    text_of(&["bag", "convert", text(&at("imu")), text(&at("rest")), "-o", text(&at("all"))]);
    assert!(count(&at("imu")) > 10 && count(&at("imu")) + count(&at("rest")) == count(&bag));
    let same = text_of(&["bag", "diff", text(&bag), text(&at("all")), "--times"]);
    assert!(same.contains(&format!("{} messages on ", count(&bag))), "{same}");
    part("split", &["-d", "1", "--storage-preset-profile", "zstd_fast"]);
    assert!(at("split").join("split_2.mcap").exists());
    text_of(&["bag", "diff", text(&bag), text(&at("split")), "--times"]);
    let output = output_of(&["bag", "diff", text(&bag), text(&at("rest"))]);
    let printed = String::from_utf8(output.stdout).unwrap();
    assert!(!output.status.success(), "{printed}");
    assert!(printed.contains("/reference/imu/data_raw: only in the first bag"), "{printed}");
    let second = at("second");
    let cut =
        ["bag", "cut", text(&bag), "--from", "1s", "--until", "2s", "-o", text(&second), "--no-latched"];
    text_of(&cut);
    let reader = Reader::open(at("second")).unwrap();
    let start = Reader::open(&bag).unwrap().start_time().unwrap();
    assert!(reader.start_time().unwrap() >= start + 1_000_000_000);
    assert!(reader.end_time().unwrap() <= start + 2_000_000_000 && reader.message_count() > 50);
    text_of(&["bag", "cut", text(&bag), "--from", "1s", "--until", "2s", "-o", text(&at("latched"))]);
    let latched = Reader::open(at("latched")).unwrap();
    let id = latched.topic("/reference/robot_description").unwrap();
    assert_eq!(latched.topics()[id.index()].message_count, 1, "was published before");
    ["imu", "rest", "all", "split", "second", "latched"]
        .iter()
        .for_each(|name| open_with_stock_readers(&at(name)));
    let output = output_of(&["bag", "convert", text(&bag), "-o", text(&at("none")), "--topics", "/imu"]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("the bag has no topic /imu; it has "), "{message}");
    let database = at("database");
    let convert =
        ["bag", "convert", text(&bag), "-o", text(&database), "-s", "sqlite3", "--compression", "lz4"];
    let output = output_of(&convert);
    let message = String::from_utf8(output.stderr).unwrap();
    let expected = if cfg!(feature = "sqlite") {
        "does not support compression"
    } else {
        "build with --features sqlite"
    };
    assert!(!output.status.success() && message.contains(expected), "{message}");
    assert!(!database.exists());
}

#[test]
fn an_existing_output_is_kept_unless_force_is_given() {
    let folder = tempfile::tempdir().unwrap();
    let bag = real();
    let at = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (made, tables, plot) = (at("made"), at("tables"), at("plot.svg"));
    let robot = folder.path().join("quiet.toml");
    std::fs::write(&robot, QUIET_ROBOT).unwrap();
    let imu = "/reference/imu/data_raw:angular_velocity.x";
    let only = ["--topics", "/reference/imu/data_raw"];
    // Each command is refused before it does anything.
    let refused: [&[&str]; 2] = [
        &["bag", "record", "--robot", text(&robot), "-o", &made],
        &["bag", "record", "/chatter", "-o", &made],
    ];
    let made_anew: [&[&str]; 6] = [
        &["bag", "convert", text(&bag), "-o", &made],
        &["bag", "cut", text(&bag), "--from", "1s", "-o", &made],
        &["bag", "repair", text(&bag), "-o", &made],
        &["bag", "export", text(&bag), "-o", &tables, only[0], only[1]],
        &["bag", "plot", text(&bag), imu, "-o", &plot],
        &["bag", "record", "--robot", text(&robot), "--duration", "10ms", "-o", &made],
    ];
    for command in [made_anew[0], made_anew[3], made_anew[4]] {
        text_of(command);
    }
    let content = std::fs::read(Path::new(&made).join("made_0.mcap")).unwrap();
    for command in refused.iter().chain(&made_anew) {
        let output = output_of(command);
        let error = String::from_utf8(output.stderr).unwrap();
        let path = [&made, &tables, &plot].into_iter().find(|path| command.contains(&path.as_str())).unwrap();
        assert!(!output.status.success(), "{command:?}");
        assert!(error.contains(&format!("{path} exists already")) && error.contains("--force"), "{error}");
    }
    assert_eq!(std::fs::read(Path::new(&made).join("made_0.mcap")).unwrap(), content);
    for command in made_anew {
        text_of(&[command, &["--force"]].concat());
    }
    let output = output_of(&["bag", "convert", &made, "-o", &made, "--force"]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && error.contains("is the input"), "{error}");
    assert!(Reader::open(&made).is_ok());
}

/// A bag with a hundred messages, about ten per chunk.
fn many_chunks(folder: &Path) -> PathBuf {
    let bag = folder.join("chunks");
    let info = TopicDescription {
        name: "/chatter".to_owned(),
        type_name: "std_msgs/msg/String".to_owned(),
        definition: "string data\n".to_owned(),
        ..TopicDescription::default()
    };
    let storage = McapOptions { chunk_size: 500, ..McapOptions::default() };
    let mut writer = WriterOptions::new().storage(storage).create(&bag).unwrap();
    let topic = writer.add_topic(info).unwrap();
    for time in 0..100 {
        let message = downbeat::msgs::std_msgs::msg::String { data: format!("number {time}") };
        writer.write(topic, time, time, &downbeat::msgs::cdr::to_vec(&message)).unwrap();
    }
    writer.finish().unwrap();
    bag
}

#[test]
fn unreadable_parts_of_a_bag_are_an_error_after_the_rest_was_copied() {
    let domain = free_domain().to_string();
    let folder = tempfile::tempdir().unwrap();
    let bytes = std::fs::read(many_chunks(folder.path()).join("chunks_0.mcap")).unwrap();
    let damaged = folder.path().join("damaged.mcap");
    std::fs::write(&damaged, &bytes[..bytes.len() / 2]).unwrap();
    assert!((10..90).contains(&count(&damaged)), "{}", count(&damaged));
    let at = |name: &str| folder.path().join(name);
    let failed = |arguments: &[&str]| {
        let output = output_of(arguments);
        let error = String::from_utf8(output.stderr).unwrap();
        assert!(!output.status.success(), "{arguments:?}: {error}");
        let info = format!(
            "1 part cannot be read; see above, and `downbeat bag check {0}`; `downbeat bag repair {0}`",
            text(&damaged)
        );
        assert!(error.contains(&info), "{error}");
    };
    let only = "/chatter";
    failed(&["bag", "convert", text(&damaged), "-o", text(&at("converted"))]);
    failed(&["bag", "cut", text(&damaged), "--from", "0s", "-o", text(&at("cut"))]);
    failed(&["bag", "export", text(&damaged), "--topics", only, "-o", text(&at("tables"))]);
    failed(&["bag", "play", text(&damaged), "--topics", only, "-r", "1000", "--domain", &domain]);
    assert_eq!(count(&at("converted")), count(&damaged));
    assert_eq!(count(&at("cut")), count(&damaged));
    let table = std::fs::read_to_string(at("tables").join("chatter.csv")).unwrap();
    assert!(table.lines().count() > 10);
    // Nothing is lost if only the summary of a bag is damaged.
    let mut unended = bytes;
    let end = unended.len();
    unended[end - 8..].fill(0);
    std::fs::write(at("unended.mcap"), &unended).unwrap();
    text_of(&["bag", "convert", text(&at("unended.mcap")), "-o", text(&at("whole"))]);
    assert_eq!(count(&at("whole")), 100);
    ["converted", "cut", "whole"].iter().for_each(|name| open_with_stock_readers(&at(name)));
}

#[test]
fn names_in_a_bag_do_not_reach_the_terminal_as_control_characters() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("bag");
    let info = TopicDescription {
        name: "/cam\u{1b}[2J\nTopic: /forged\u{9b}".to_owned(),
        type_name: "std_msgs/msg/\u{1b}]0;title\u{7}".to_owned(),
        ..TopicDescription::default()
    };
    let mut writer = WriterOptions::new().create(&bag).unwrap();
    let topic = writer.add_topic(info).unwrap();
    writer.write(topic, 1, 1, &[0, 1, 0, 0]).unwrap();
    writer.finish().unwrap();
    let other = folder.path().join("other");
    let real = real();
    let commands: [&[&str]; 6] = [
        &["bag", "info", text(&bag)],
        &["bag", "info", text(&bag), "--json"],
        &["bag", "check", text(&bag)],
        &["bag", "diff", text(&bag), text(&real)],
        &["bag", "export", text(&bag), "-o", text(&other)],
        &["bag", "convert", text(&bag), "--topics", "/none", "-o", text(&other)],
    ];
    for command in commands {
        let output = output_of(command);
        let printed = String::from_utf8([output.stdout, output.stderr].concat()).unwrap();
        let harmful = |character: char| character.is_control() && !"\n\t".contains(character);
        assert!(!printed.contains(harmful), "{command:?}: {printed:?}");
        assert!(printed.contains("cam\\u001b[2J"), "{command:?}: {printed}");
        assert!(!printed.lines().any(|line| line.starts_with("Topic: /forged")), "{printed}");
    }
}

#[test]
fn a_flipped_bit_in_a_recording_costs_at_most_a_message_and_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let name = "darwin_op_walk_simulated";
    let whole = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("bags/recordings")
        .join(name)
        .join(format!("{name}_0.mcap"));
    let (expected, bytes) = (count(&whole), std::fs::read(&whole).unwrap());
    let damaged = folder.path().join("run_0.mcap");
    let mut altered = bytes.clone();
    // In the name of a joint: a changed length would cost more messages.
    let name_of_joint = b"r_sho_pitch";
    let later = bytes.len() * 5 / 8;
    let found = bytes[later..].windows(name_of_joint.len()).position(|part| part == name_of_joint);
    altered[later + found.unwrap()] ^= 4;
    std::fs::write(&damaged, &altered).unwrap();
    let repaired = folder.path().join("repaired");
    let printed = text_of(&["bag", "repair", text(&damaged), "--output", text(&repaired)]);
    assert!(printed.contains("messages are read"), "{printed}");
    assert!(count(&repaired) >= expected - 1, "{} of {expected}", count(&repaired));
    assert!(text_of(&["bag", "check", text(&repaired)]).contains("found 0 problems"));
    // All other commands process it too, and report the damage.
    let converted = folder.path().join("converted");
    let output = output_of(&["bag", "convert", text(&damaged), "--output", text(&converted)]);
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(count(&converted), count(&repaired));
    [converted, repaired].iter().for_each(|bag| open_with_stock_readers(bag));
}

#[test]
fn a_bag_of_which_nothing_can_be_read_is_not_repaired() {
    let folder = tempfile::tempdir().unwrap();
    let damaged = folder.path().join("run_0.mcap");
    let mut bytes = std::fs::read(real().join("jazzy_mcap_0.mcap")).unwrap();
    bytes[8..].fill(0xff);
    std::fs::write(&damaged, bytes).unwrap();
    let output = output_of(&["bag", "repair", text(&damaged)]);
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("no message of") && error.contains("can be read"), "{error}");
}
