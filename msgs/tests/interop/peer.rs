//! The Python process with the reference implementations.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use python_peer::{Python, entries, printed, with_file};
pub use python_peer::{hex, unhex};
use serde_json::Value;

/// A Python with the ROS 2 wheels.
pub struct Peer(Python);

impl Peer {
    pub fn find() -> Option<Self> {
        Python::find().map(Self)
    }

    /// The folder with a folder for each ROS 2 package.
    pub fn share(&self) -> PathBuf {
        self.0.prefix().join("share")
    }

    /// Returns whether the wheels contain the package of that type.
    pub fn has_package_of(&self, name: &str) -> bool {
        let package = name.split('/').next().unwrap();
        self.share().join(package).is_dir()
    }

    /// The file in the wheels for an interface, or for the one that it is a part of.
    pub fn published(&self, name: &str) -> Value {
        let kind_ends = name.rfind('/').unwrap();
        let stem = name[kind_ends..].find('_').map_or(name, |end| &name[..kind_ends + end]);
        read_json(&self.share().join(stem).with_extension("json"))
    }

    /// The hashes in the wheels, of messages, services and actions and all their parts.
    pub fn published_hashes(&self) -> BTreeMap<String, String> {
        let mut hashes = BTreeMap::new();
        for package in entries(&self.share()) {
            for path in ["msg", "srv", "action"].iter().flat_map(|kind| entries(&package.join(kind))) {
                if path.extension().is_some_and(|extension| extension == "json") {
                    for entry in read_json(&path)["type_hashes"].as_array().unwrap() {
                        let text_of = |key: &str| entry[key].as_str().unwrap().to_owned();
                        hashes.insert(text_of("type_name"), text_of("hash_string"));
                    }
                }
            }
        }
        hashes
    }

    /// Runs a command of `python/peer.py` with `input` in a file; returns the parts of each line of output.
    pub fn ask(&self, command: &str, arguments: &[&str], input: &str) -> Answer {
        let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/interop/python/peer.py");
        let text = with_file(input, |file| {
            let mut asked = self.0.command(script);
            // Fast CDR does not initialise padding. These settings make the C library return zeroed memory,
            // so that equal values have equal bytes.
            asked.env("GLIBC_TUNABLES", "glibc.malloc.perturb=255:glibc.malloc.tcache_count=0");
            printed(asked.arg(command).arg(file).args(arguments))
        });
        Answer { text }
    }
}

/// The output of a command.
pub struct Answer {
    text: String,
}

impl Answer {
    /// The parts of each line, which must be `PARTS`.
    pub fn lines<const PARTS: usize>(&self) -> Vec<[&str; PARTS]> {
        let parts = self.text.lines().map(|line| line.split('\t').collect::<Vec<_>>());
        parts.map(|parts| parts.try_into().unwrap_or_else(|parts| panic!("{parts:?}"))).collect()
    }
}

fn read_json(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}
