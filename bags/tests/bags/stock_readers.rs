//! The readers of bags that others wrote: `rosbags`, `mcap-ros2-support` and Foxglove's `@mcap/core`.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use super::Reader;

/// Opens the bags in a folder with the stock readers that are there. Each decodes every message, and must
/// find as many on every topic as we do. Returns the names of the readers.
///
/// `mcap-ros2-support` reads no names of parts of services and actions; those topics are left out.
#[track_caller]
pub fn open_bags(folder: &Path) -> Vec<&'static str> {
    // Tests of the program include this file too.
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let programs = if package.ends_with("bags") { package.join("tests") } else { package.join("bags/tests") };
    let mut readers = Vec::new();
    if let Some(python) = test_machine::interpreter("DOWNBEAT_PYTHON") {
        let mut command = Command::new(python);
        let found = printed(command.arg("-B").arg(programs.join("python/open_bags.py")).arg(folder));
        compare(folder, "rosbags", &found["rosbags"], |_| true);
        compare(folder, "mcap-ros2-support", &found["mcap_ros2"], |type_name| type_name.contains("/msg/"));
        readers.extend(["rosbags", "mcap-ros2-support"]);
    }
    if let Some(modules) = test_machine::node_modules() {
        let mut command = Command::new("node");
        command
            .arg(programs.join("node/count_messages.mjs"))
            .arg(folder)
            .env("DOWNBEAT_NODE_MODULES", modules);
        compare(folder, "@mcap/core", &printed(&mut command), |_| true);
        readers.push("@mcap/core");
    }
    readers
}

/// Compares the numbers of messages that a reader found on the topics of the bags, whose types it reads.
#[track_caller]
fn compare(folder: &Path, reader: &str, found: &Value, reads: fn(&str) -> bool) {
    for bag in std::fs::read_dir(folder).unwrap() {
        let path = bag.unwrap().path();
        let bag = Reader::open(&path).unwrap();
        let topics =
            bag.topics().iter().filter(|topic| topic.message_count > 0 && reads(&topic.info.type_name));
        let ours: BTreeMap<_, _> = topics.map(|topic| (&topic.info.name, topic.message_count)).collect();
        let name = path.file_name().unwrap().to_str().unwrap();
        assert_eq!(found[name], json!(ours), "{}, read by {reader}", path.display());
        // Of the topics that this reader reads, metadata.yaml has the same numbers.
        let metadata = bag.metadata().map(|metadata| &metadata.topics[..]).unwrap_or_default();
        let noted = metadata.iter().filter(|topic| topic.message_count > 0 && reads(&topic.type_name));
        let noted: BTreeMap<_, _> = noted.map(|topic| (&topic.name, topic.message_count)).collect();
        assert!(bag.metadata().is_none() || noted == ours, "{}: {noted:?}, not {ours:?}", path.display());
    }
}

#[track_caller]
fn printed(command: &mut Command) -> Value {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}
