//! The Python process with the reference implementations.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// A Python with the ROS 2 wheels.
pub struct Peer {
    python: PathBuf,
}

impl Peer {
    /// The interpreter named by `DOWNBEAT_PYTHON`; prints a note if it is not set.
    pub fn find() -> Option<Self> {
        match std::env::var_os("DOWNBEAT_PYTHON") {
            Some(python) => Some(Self { python: python.into() }),
            None => {
                // Bypasses the capture of test output, which hides the output of passing tests.
                let line = "skipped: DOWNBEAT_PYTHON is not set (cargo xtask test sets it)\n";
                let _ = std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes());
                None
            }
        }
    }

    /// The folder with a folder for each ROS 2 package.
    pub fn share(&self) -> PathBuf {
        // <environment>/bin/python
        self.python.parent().and_then(Path::parent).unwrap().join("share")
    }

    /// Whether the wheels contain the package of that type.
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
        // Tests run in parallel, in one process or several.
        let test = std::thread::current().name().unwrap_or_default().replace("::", "_");
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("{test}_{command}.txt"));
        std::fs::write(&file, input).unwrap();
        let output = Command::new(&self.python)
            .arg("-B") // writes no compiled files to the source tree
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/interop/python/peer.py"))
            .arg(command)
            .arg(&file)
            .args(arguments)
            // Fast CDR does not initialise padding. These settings make the C library return zeroed memory,
            // so that equal values have equal bytes.
            .env("GLIBC_TUNABLES", "glibc.malloc.perturb=255:glibc.malloc.tcache_count=0")
            .output()
            .unwrap_or_else(|error| panic!("cannot run {}: {error}", self.python.display()));
        assert!(output.status.success(), "peer.py {command}: {}", String::from_utf8_lossy(&output.stderr));
        Answer { text: String::from_utf8(output.stdout).unwrap() }
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

/// The sorted entries of a folder; empty if it does not exist.
fn entries(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

fn read_json(path: &Path) -> Value {
    let text = std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Written for speed in debug builds, where the tests spend much of their time here.
pub fn hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let mut digits = vec![0; bytes.len() * 2];
    for (pair, byte) in digits.as_chunks_mut::<2>().0.iter_mut().zip(bytes) {
        *pair = [DIGITS[usize::from(byte >> 4)], DIGITS[usize::from(byte & 15)]];
    }
    String::from_utf8(digits).unwrap()
}

pub fn unhex(text: &str) -> Vec<u8> {
    let value = |digit: u8| match digit {
        b'0'..=b'9' => digit - b'0',
        b'a'..=b'f' => digit - b'a' + 10,
        _ => panic!("{digit:#x} is not a hexadecimal digit"),
    };
    let (pairs, rest) = text.as_bytes().as_chunks::<2>();
    assert!(rest.is_empty(), "half a byte");
    pairs.iter().map(|&[high, low]| value(high) << 4 | value(low)).collect()
}
