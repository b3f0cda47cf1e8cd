//! What the modules of the page compute, their types, and their weight, with Node.js.
#![allow(clippy::unwrap_used, missing_docs)]

use std::path::{Path, PathBuf};
use std::process::Command;

/// The tests of a folder, below it too.
fn tests_in(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            tests_in(&path, found);
        } else if path.to_str().is_some_and(|path| path.ends_with(".test.mjs")) {
            found.push(path);
        }
    }
}

#[test]
fn the_modules_of_the_page_pass_their_own_tests() {
    let Some(modules) = test_machine::node_modules() else { return };
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut tests = Vec::new();
    for folder in ["page", "tests/page"] {
        tests_in(&package.join(folder), &mut tests);
    }
    assert!(tests.iter().any(|path| path.ends_with("layout.test.mjs")), "{tests:?}");
    let mut node = Command::new("node");
    let output = node.arg("--test").args(&tests).env("DOWNBEAT_NODE_MODULES", modules).output().unwrap();
    let [out, error] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success(), "{out}\n{error}");
}
