//! The definitions of the Python environment with the ROS 2 wheels.

use std::path::{Path, PathBuf};

use python_peer::{Python, entries};

/// A file of a package.
pub struct File {
    pub package: String,
    pub path: PathBuf,
    pub text: String,
}

/// Runs a command of `peer.py` with `input` in a file; returns its output.
pub fn ask(python: &Python, command: &str, input: &str) -> String {
    python.ask(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/wheels/peer.py"), command, input)
}

/// The interface files with that extension, of all packages.
pub fn files_of(python: &Python, extension: &str) -> Vec<File> {
    let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
    let mut files = Vec::new();
    for package in entries(&python.prefix().join("share")) {
        for folder in ["msg", "srv", "action"].map(|folder| package.join(folder)) {
            let found = entries(&folder).into_iter();
            files.extend(found.filter(|file| file.extension().is_some_and(|of| of == extension)).map(
                |path| File { package: name(&package), text: std::fs::read_to_string(&path).unwrap(), path },
            ));
        }
    }
    files
}
