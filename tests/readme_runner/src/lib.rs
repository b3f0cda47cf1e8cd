//! Runs the commands of a README and compares their output with the text in it.
//!
//! A block of commands is marked `sh`. The following block marked `text` is the expected output:
//!
//! - `…` stands for any text within a line;
//! - the lines are printed in this order; other lines may be printed between them;
//! - a line `^C` stands for Ctrl-C, after the lines above it have been printed.
//!
//! Commands run in a copy of the folder of the README, which is removed afterwards. Each page has a separate
//! ROS domain on loopback. `cargo run` runs the program that was built for the test, so that nothing is built
//! twice; `cargo test` does nothing, because it includes the test of the page.
#![allow(clippy::missing_panics_doc)] // errors are reported as panics

mod page;
mod session;

use std::fs;
use std::path::{Path, PathBuf};

/// A README whose commands are run.
pub struct Readme {
    source: PathBuf,
    folder: tempfile::TempDir,
    programs: PathBuf,
    program: String,
}

impl Readme {
    /// The README of a package. `package` is `env!("CARGO_MANIFEST_DIR")`, and `program`, which `cargo run`
    /// runs, is `env!("CARGO_BIN_EXE_…")`.
    #[must_use]
    pub fn of(package: &str, program: &str) -> Self {
        let (source, program) = (PathBuf::from(package), Path::new(program));
        let folder = tempfile::Builder::new().prefix("readme").tempdir();
        let folder = folder.expect("a temporary folder can be made");
        copy(&source, folder.path());
        let name = program.file_name().expect("a program has a name");
        let programs = program.parent().expect("a program is in a folder");
        Self {
            source,
            folder,
            programs: programs.to_owned(),
            program: name.to_str().expect("its name is text").to_owned(),
        }
    }

    /// Replaces text in the copy of a file before the commands run, for example a port that may be in use.
    #[must_use]
    pub fn replacing(self, file: &str, from: &str, to: &str) -> Self {
        let path = self.folder.path().join(file);
        let text = fs::read_to_string(&path).expect("the file is text");
        assert!(text.contains(from), "{file} does not contain {from:?}");
        fs::write(&path, text.replace(from, to)).expect("the copy can be written");
        self
    }

    /// Runs the commands twice, because readers repeat examples.
    ///
    /// # Panics
    /// Panics if a command fails, does not end, or does not print the expected output.
    pub fn check(self) {
        let path = self.source.join("README.md");
        let text = fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let blocks = page::blocks(&text);
        assert!(!blocks.is_empty(), "{} has no commands", path.display());
        for time in ["", ", the second time"] {
            for block in &blocks {
                let place = format!("{}:{}{time}", path.display(), block.line);
                session::run(block, &place, self.folder.path(), &self.programs, &self.program);
            }
        }
    }
}

/// Copies what commands may read: everything except sources and test programs.
fn copy(from: &Path, to: &Path) {
    for entry in fs::read_dir(from).unwrap_or_else(|error| panic!("{}: {error}", from.display())) {
        let path = entry.expect("the folder can be read").path();
        let name = path.file_name().expect("an entry has a name");
        if path.is_dir() {
            if name != "src" && name != "target" {
                fs::create_dir_all(to.join(name)).expect("a folder can be made");
                copy(&path, &to.join(name));
            }
        } else {
            fs::copy(&path, to.join(name)).expect("a file can be copied");
        }
    }
}
