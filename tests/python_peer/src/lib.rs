//! The Python interpreter in `DOWNBEAT_PYTHON`, with the ROS 2 wheels, for tests that compare with it.
#![allow(clippy::unwrap_used, clippy::missing_panics_doc)]

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};

/// An interpreter with the ROS 2 packages in its environment.
pub struct Python(PathBuf);

impl Python {
    /// Returns the interpreter. If there is none, reports a skipped test and returns `None`.
    #[track_caller]
    pub fn find() -> Option<Self> {
        test_machine::interpreter("DOWNBEAT_PYTHON").map(|python| Self(python.into()))
    }

    /// The prefix of the environment, which has the layout of an ament prefix.
    pub fn prefix(&self) -> PathBuf {
        // <environment>/bin/python
        self.0.parent().and_then(Path::parent).unwrap().to_owned()
    }

    /// A command that runs a script and leaves no compiled files in the source tree.
    pub fn command(&self, script: impl AsRef<Path>) -> Command {
        let mut command = Command::new(&self.0);
        command.arg("-B").arg(script.as_ref());
        command
    }

    /// Runs a script and returns its output.
    pub fn run(&self, script: impl AsRef<Path>, arguments: &[impl AsRef<OsStr>]) -> String {
        printed(self.command(script).args(arguments))
    }

    /// Runs a command of a script with `input` in a file and returns its output.
    pub fn ask(&self, script: impl AsRef<Path>, command: &str, input: &str) -> String {
        with_file(input, |file| self.run(script, &[OsStr::new(command), file.as_os_str()]))
    }
}

/// Calls `use_it` with the path of a temporary file with this content.
pub fn with_file<T>(content: &str, use_it: impl FnOnce(&Path) -> T) -> T {
    // Tests run in parallel, in one process or in several.
    static COUNT: AtomicUsize = AtomicUsize::new(0);
    let unique = format!("downbeat_{}_{}", std::process::id(), COUNT.fetch_add(1, Ordering::Relaxed));
    let file = std::env::temp_dir().join(unique);
    std::fs::write(&file, content).unwrap();
    let result = use_it(&file);
    std::fs::remove_file(&file).unwrap();
    result
}

/// Runs a command, which must succeed, and returns its output.
pub fn printed(command: &mut Command) -> String {
    let output = command.output().unwrap_or_else(|error| panic!("cannot run {command:?}: {error}"));
    assert!(output.status.success(), "{command:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// Returns the sorted entries of a folder; empty if it does not exist.
pub fn entries(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    paths.sort();
    paths
}

/// Formats bytes as hexadecimal digits. Fast even in debug builds, because the tests use it often.
pub fn hex(bytes: &[u8]) -> String {
    const DIGITS: &[u8; 16] = b"0123456789abcdef";
    let mut digits = vec![0; bytes.len() * 2];
    for (pair, byte) in digits.as_chunks_mut::<2>().0.iter_mut().zip(bytes) {
        *pair = [DIGITS[usize::from(byte >> 4)], DIGITS[usize::from(byte & 15)]];
    }
    String::from_utf8(digits).unwrap()
}

/// Parses hexadecimal digits.
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
