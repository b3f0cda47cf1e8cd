//! The tables of options in docs/bags.md name each option of `ros2 bag record` and `ros2 bag play`, and say
//! of each whether it is an option here.
#![allow(clippy::unwrap_used)]

use std::collections::BTreeMap;

use clap::{Args, Command};

use super::play::PlayArguments;
use super::record::arguments::RecordArguments;

/// `ros2bag/verb/record.py` of ROS 2 Jazzy.
const OF_RECORD: [&str; 37] = [
    "output",
    "storage",
    "topics",
    "services",
    "topic-types",
    "all",
    "all-topics",
    "all-services",
    "regex",
    "exclude-regex",
    "exclude-topics",
    "exclude-topic-types",
    "exclude-services",
    "include-unpublished-topics",
    "include-hidden-topics",
    "no-discovery",
    "polling-interval",
    "ignore-leaf-topics",
    "qos-profile-overrides-path",
    "serialization-format",
    "max-bag-size",
    "max-bag-duration",
    "max-cache-size",
    "disable-keyboard-controls",
    "start-paused",
    "use-sim-time",
    "node-name",
    "custom-data",
    "snapshot-mode",
    "log-level",
    "storage-preset-profile",
    "storage-config-file",
    "compression-mode",
    "compression-format",
    "compression-queue-size",
    "compression-threads",
    "compression-threads-priority",
];

/// `ros2bag/verb/play.py` of ROS 2 Jazzy.
const OF_PLAY: [&str; 25] = [
    "read-ahead-queue-size",
    "rate",
    "topics",
    "services",
    "regex",
    "exclude-regex",
    "exclude-topics",
    "exclude-services",
    "qos-profile-overrides-path",
    "loop",
    "remap",
    "clock",
    "clock-topics",
    "clock-topics-all",
    "delay",
    "playback-duration",
    "playback-until-sec",
    "playback-until-nsec",
    "start-paused",
    "start-offset",
    "wait-for-all-acked",
    "disable-keyboard-controls",
    "disable-loan-message",
    "publish-service-requests",
    "service-requests-source",
];

/// The rows of the table of a command: the options without dashes, and what is said of each.
fn table(command: &str) -> BTreeMap<String, String> {
    let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/bags.md");
    let page = std::fs::read_to_string(path).unwrap();
    let header = format!("| `{command}` |");
    let rows = page.lines().skip_while(|line| !line.starts_with(&header)).skip(2);
    let rows = rows.take_while(|line| line.starts_with('|')).map(|row| {
        let (names, text) = row.trim_matches(['|', ' ']).split_once(" | ").unwrap();
        let long = names.split(", ").find_map(|name| name.trim_matches('`').strip_prefix("--")).unwrap();
        (long.to_owned(), text.to_owned())
    });
    rows.collect()
}

fn compare<T: Args>(command: &str, options: &[&str]) {
    let table = table(command);
    let named: Vec<_> = table.keys().map(String::as_str).collect();
    let mut expected = options.to_vec();
    expected.sort_unstable();
    assert_eq!(named, expected, "{command}");
    let ours = T::augment_args(Command::new("bag"));
    let is_ours = |name: &str| ours.get_arguments().any(|option| option.get_long() == Some(name));
    for (name, text) in table {
        assert_eq!(is_ours(&name), !text.starts_with("rejected"), "{command} --{name}: {text}");
    }
}

#[test]
fn the_page_says_of_every_option_of_ros2_bag_what_it_is_here() {
    compare::<RecordArguments>("ros2 bag record", &OF_RECORD);
    compare::<PlayArguments>("ros2 bag play", &OF_PLAY);
}
