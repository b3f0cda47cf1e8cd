//! Bags on the command line: looked at, checked, repaired, merged, cut, compared.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::path::{Path, PathBuf};

use common::{output_of, text_of};
use downbeat::bags::{Reader, Selection};

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
fn info_tells_what_ros2_bag_info_tells_and_more() {
    let bag = real();
    let expected = std::fs::read_to_string(bag.with_file_name("jazzy_mcap_info.txt")).unwrap();
    assert_eq!(text_of(&["bag", "info", text(&bag)]).trim_end(), expected.trim_end());
    let names = text_of(&["bag", "info", text(&bag), "--topic-name"]);
    assert!(names.lines().any(|name| name == "/tf") && !names.contains("_service_event"), "{names}");
    let verbose = text_of(&["bag", "info", "-v", text(&bag)]);
    assert!(verbose.contains("Request Count: 17 | Response Count: 18 | Size Contribution: "), "{verbose}");
    let file = bag.join("jazzy_mcap_0.mcap");
    let told = json(&["bag", "info", text(&file), "--json", "--verbose"]);
    assert_eq!(told["storage_identifier"], "mcap");
    assert_eq!(told["services"][0]["request_count"], 17);
    let topics = told["topics"].as_array().unwrap();
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
    assert_eq!(latched.topics()[id.index()].message_count, 1, "was sent before");
    let output = output_of(&["bag", "convert", text(&bag), "-o", text(&at("none")), "--topics", "/imu"]);
    let message = String::from_utf8(output.stderr).unwrap();
    assert!(message.contains("the bag has no topic /imu; it has "), "{message}");
    let database = at("database");
    let convert =
        ["bag", "convert", text(&bag), "-o", text(&database), "-s", "sqlite3", "--compression", "lz4"];
    let output = output_of(&convert);
    let message = String::from_utf8(output.stderr).unwrap();
    let expected =
        if cfg!(feature = "sqlite") { "compresses nothing" } else { "build with `--features sqlite`" };
    assert!(!output.status.success() && message.contains(expected), "{message}");
    assert!(!database.exists());
}
