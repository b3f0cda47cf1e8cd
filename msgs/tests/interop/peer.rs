//! The Python at the other end.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;

/// A Python with the ROS 2 wheels.
pub struct Peer {
    python: PathBuf,
}

impl Peer {
    /// The one `DOWNBEAT_PYTHON` names; says so if there is none.
    pub fn find() -> Option<Self> {
        match std::env::var_os("DOWNBEAT_PYTHON") {
            Some(python) => Some(Self { python: python.into() }),
            None => {
                // Past the capture of test output, which shows nothing of a test that passes.
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

    /// The file the wheels have for an interface, or for the one that it is a part of.
    pub fn published(&self, name: &str) -> Value {
        // The parts of a service or an action are in its file.
        let kind_ends = name.rfind('/').unwrap();
        let stem = name[kind_ends..].find('_').map_or(name, |end| &name[..kind_ends + end]);
        let path = self.share().join(stem).with_extension("json");
        let text =
            std::fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        serde_json::from_str(&text).unwrap()
    }

    /// The hashes in the file the wheels have for an interface, by name.
    pub fn published_hashes(&self, name: &str) -> BTreeMap<String, String> {
        let json = self.published(name);
        let text_of = |entry: &Value, key: &str| entry[key].as_str().unwrap().to_owned();
        let entries = json["type_hashes"].as_array().unwrap().iter();
        entries.map(|entry| (text_of(entry, "type_name"), text_of(entry, "hash_string"))).collect()
    }

    /// Runs a command of `peer.py` with `input` in a file; gives what it prints.
    pub fn ask(&self, command: &str, arguments: &[&str], input: &str) -> String {
        let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join(format!("interop_{command}.txt"));
        std::fs::write(&file, input).unwrap();
        let output = Command::new(&self.python)
            .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/interop/peer.py"))
            .arg(command)
            .arg(&file)
            .args(arguments)
            // Fast CDR leaves padding as it finds it in fresh memory. These make the C library hand out zeros, so that
            // equal values have equal bytes.
            .env("GLIBC_TUNABLES", "glibc.malloc.perturb=255:glibc.malloc.tcache_count=0")
            .output()
            .unwrap_or_else(|error| panic!("cannot run {}: {error}", self.python.display()));
        assert!(output.status.success(), "peer.py {command}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    }
}

pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().fold(String::new(), |mut text, byte| {
        write!(text, "{byte:02x}").unwrap();
        text
    })
}

pub fn unhex(text: &str) -> Vec<u8> {
    let digits = text.as_bytes().as_chunks::<2>().0.iter();
    digits.map(|pair| u8::from_str_radix(std::str::from_utf8(pair).unwrap(), 16).unwrap()).collect()
}
