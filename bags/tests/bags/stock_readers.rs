//! The readers of bags that others wrote: `rosbags`, `mcap-ros2-support` and Foxglove's `@mcap/core`.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use serde_json::{Value, json};

use super::Reader;

/// Opens the bags in a folder with the stock readers that are there. Each decodes every message, and must
/// find as many on every topic as we do. Returns the names of the readers.
#[track_caller]
pub fn open_bags(folder: &Path) -> Vec<&'static str> {
    let readers = read(folder);
    for bag in std::fs::read_dir(folder).unwrap() {
        let path = bag.unwrap().path();
        let bag = Reader::open(&path).unwrap();
        for reader in &readers {
            assert_eq!(reader.difference(&path, &bag), None, "{}, read by {}", path.display(), reader.name);
        }
    }
    readers.into_iter().map(|reader| reader.name).collect()
}

/// What a stock reader found in bags.
pub struct StockReader {
    pub name: &'static str,
    /// By the name of a bag: messages of each topic, or why it cannot be read.
    found: Value,
    /// Whether it reads a type. `mcap-ros2-support` reads no names of parts of services and actions.
    reads: fn(&str) -> bool,
}

/// Opens the bags, which are all that is in a folder, with the stock readers that are there.
#[track_caller]
pub fn read(folder: &Path) -> Vec<StockReader> {
    // Tests of the program include this file too.
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let programs = if package.ends_with("bags") { package.join("tests") } else { package.join("bags/tests") };
    let mut readers = Vec::new();
    if let Some(python) = test_machine::interpreter("DOWNBEAT_PYTHON") {
        let mut command = Command::new(python);
        let mut found = printed(command.arg("-B").arg(programs.join("python/open_bags.py")).arg(folder));
        let of_messages = |type_name: &str| type_name.contains("/msg/");
        readers.push(StockReader { name: "rosbags", found: found["rosbags"].take(), reads: |_| true });
        readers.push(StockReader {
            name: "mcap-ros2-support",
            found: found["mcap_ros2"].take(),
            reads: of_messages,
        });
    }
    if let Some(modules) = test_machine::node_modules() {
        let mut command = Command::new("node");
        command.arg(programs.join("node/count_messages.mjs")).arg(folder);
        let found = printed(command.env("DOWNBEAT_NODE_MODULES", modules));
        readers.push(StockReader { name: "@mcap/core", found, reads: |_| true });
    }
    readers
}

impl StockReader {
    /// How the number of messages that it found on a topic whose type it reads differs from ours, or from
    /// that in metadata.yaml; or why it reads none.
    pub fn difference(&self, path: &Path, bag: &Reader) -> Option<String> {
        let reads = self.reads;
        let topics =
            bag.topics().iter().filter(|topic| topic.message_count > 0 && reads(&topic.info.type_name));
        let ours: BTreeMap<_, _> = topics.map(|topic| (&topic.info.name, topic.message_count)).collect();
        let found = &self.found[path.file_name().unwrap().to_str().unwrap()];
        if let Some(refused) = found.as_str() {
            return Some(refused.to_owned());
        }
        if *found != json!(ours) {
            return Some(format!("{found}, and not {}", json!(ours)));
        }
        let metadata = bag.metadata()?;
        let noted = metadata.topics.iter();
        let noted = noted.filter(|topic| topic.message_count > 0 && reads(&topic.type_name));
        let noted: BTreeMap<_, _> = noted.map(|topic| (&topic.name, topic.message_count)).collect();
        (noted != ours).then(|| format!("metadata.yaml has {noted:?}, and not {ours:?}"))
    }
}

#[track_caller]
fn printed(command: &mut Command) -> Value {
    let output = command.output().unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}
