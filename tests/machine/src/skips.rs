//! The list of the tests that a run skipped.
//!
//! Each skipped test appends a line to a file in the target folder, and prints one past the capture of
//! output. `cargo xtask skips` prints the list; the last test program of `cargo test` does, too.

use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::fs::File;
use std::io::{self, Read, Seek, Write};
use std::panic::Location;
use std::path::{Path, PathBuf};

/// With a value other than empty or `0`, a missing tool is a failure.
const STRICT: &str = "DOWNBEAT_STRICT";

/// The variable that names the file of the list. By default, it is in the target folder and only holds the
/// latest run of tests.
pub const LIST: &str = "DOWNBEAT_SKIPS";

/// Reports that the running test is skipped because the machine lacks a tool. `remedy` says how to install
/// it.
///
/// # Panics
/// If the run is strict.
#[track_caller]
pub fn missing(tool: &str, remedy: &str) {
    let reason = format!("{tool} is missing ({remedy})");
    assert!(!is_strict(), "{reason}; a test without its tool fails because {STRICT} is set");
    report(&reason);
}

/// Whether a missing tool is a failure.
pub fn is_strict() -> bool {
    std::env::var_os(STRICT).is_some_and(|value| !value.is_empty() && value != "0")
}

/// Reports that the running test skips some or all of its work for a reason that does not fail a strict run:
/// this machine or this user cannot do something that no package provides.
#[track_caller]
pub fn skipped(reason: &str) {
    report(reason);
}

#[track_caller]
fn report(reason: &str) {
    let test = running_test(Location::caller());
    // Not by `eprintln!`, whose output is hidden for tests that pass.
    let _ = io::stderr().write_all(format!("skipped: {test}: {reason}\n").as_bytes());
    let written = match list_file() {
        Some(file) => append(&file, this_run().as_deref(), reason, &test),
        None => Ok(()), // an installed program, which has no target folder
    };
    // A list that is silently incomplete is worse than a failure.
    written.unwrap_or_else(|error| panic!("cannot list the skipped test {test}: {error}"));
}

/// The test program, and the test or the place in its source.
fn running_test(place: &Location) -> String {
    let program = std::env::current_exe().ok();
    let stem = program.as_deref().and_then(Path::file_stem).unwrap_or_default().to_string_lossy();
    // Without the hash that cargo appends.
    let program = stem.rsplit_once('-').map_or(&*stem, |(name, _)| name);
    // The test harness runs each test in a thread with its name.
    match std::thread::current().name() {
        Some(test) if test != "main" => format!("{program} {test}"),
        _ => format!("{program} {}:{}", place.file(), place.line()),
    }
}

/// Appends a line. A file that begins with another `run` is begun anew.
fn append(file: &Path, run: Option<&str>, reason: &str, test: &str) -> io::Result<()> {
    let in_line = |text: &str| text.split(['\n', '\t']).map(str::trim).collect::<Vec<_>>().join(" ");
    let mut list = File::options().read(true).append(true).create(true).open(file)?;
    // Test programs may run at the same time.
    list.lock()?;
    if let Some(run) = run {
        let header = format!("# {run}\n");
        let mut before = String::new();
        list.rewind()?;
        list.read_to_string(&mut before)?;
        if !before.starts_with(&header) {
            list.set_len(0)?;
            list.write_all(header.as_bytes())?;
        }
    }
    list.write_all(format!("{}\t{}\n", in_line(reason), in_line(test)).as_bytes())
}

/// The tests that a run skipped, by reason.
#[derive(Debug, Default, PartialEq, Eq)]
pub struct Skips {
    tests: BTreeMap<String, BTreeSet<String>>,
}

impl Skips {
    /// Reads the list of the latest run.
    ///
    /// # Errors
    /// If the file exists but cannot be read.
    pub fn of_latest_run() -> io::Result<Self> {
        list_file().map_or(Ok(Self::default()), |file| Self::read(&file, None))
    }

    /// Reads the list of the run to which this test program belongs.
    ///
    /// # Errors
    /// If the file exists but cannot be read.
    pub fn of_this_run() -> io::Result<Self> {
        list_file().map_or(Ok(Self::default()), |file| Self::read(&file, this_run().as_deref()))
    }

    /// Reads a list; empty if there is none, or if it is of another `run`.
    ///
    /// # Errors
    /// If the file exists but cannot be read.
    pub fn read(file: &Path, run: Option<&str>) -> io::Result<Self> {
        let text = match std::fs::read_to_string(file) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(Self::default()),
            text => text?,
        };
        let mut skips = Self::default();
        if run.is_some_and(|run| text.lines().next() != Some(&format!("# {run}"))) {
            return Ok(skips);
        }
        for (reason, test) in text.lines().filter_map(|line| line.split_once('\t')) {
            skips.tests.entry(reason.to_owned()).or_default().insert(test.to_owned());
        }
        Ok(skips)
    }

    /// The list with all tests, not only some for each reason.
    pub fn in_full(&self) -> impl fmt::Display {
        Shown { skips: self, most: usize::MAX }
    }
}

/// The file of the list; `None` if no variable names it and this program is in no target folder.
pub fn list_file() -> Option<PathBuf> {
    if let Some(file) = std::env::var_os(LIST) {
        return Some(file.into());
    }
    let program = std::env::current_exe().ok()?;
    // Cargo marks its target folder.
    let target = program.ancestors().find(|folder| folder.join("CACHEDIR.TAG").exists())?;
    Some(target.join("skips.txt"))
}

/// A name of the run: all test programs that one `cargo` starts have the same. `None` if whoever named the
/// file of the list decides what is one run.
fn this_run() -> Option<String> {
    if std::env::var_os(LIST).is_some() {
        return None;
    }
    if let Ok(run) = std::env::var("NEXTEST_RUN_ID") {
        return Some(format!("nextest {run}"));
    }
    let cargo = std::os::unix::process::parent_id();
    // Linux gives the number of an ended process to a new one, so the start time belongs to the name: field
    // 22 of this file.
    let status = std::fs::read_to_string(format!("/proc/{cargo}/stat")).unwrap_or_default();
    let after_name = status.rsplit(')').next().unwrap_or_default();
    Some(format!("cargo {cargo} {}", after_name.split_whitespace().nth(19).unwrap_or_default()))
}

impl fmt::Display for Skips {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        Shown { skips: self, most: 3 }.fmt(f)
    }
}

struct Shown<'a> {
    skips: &'a Skips,
    most: usize,
}

impl fmt::Display for Shown<'_> {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let Skips { tests } = self.skips;
        if tests.is_empty() {
            return f.write_str("skipped: nothing");
        }
        f.write_str("skipped:")?;
        for (reason, tests) in tests {
            write!(f, "\n  {reason}")?;
            for test in tests.iter().take(self.most) {
                write!(f, "\n      {test}")?;
            }
            let more = tests.len().saturating_sub(self.most);
            if more > 0 {
                write!(f, "\n      and {more} more (`cargo xtask skips` lists all)")?;
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_list_names_each_test_once_under_its_reason() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("skips.txt");
        assert_eq!(Skips::read(&file, None).unwrap().to_string(), "skipped: nothing");
        for test in ["mqtt b", "mqtt a", "mqtt b", "mqtt c", "mqtt d"] {
            append(&file, None, "no broker", test).unwrap();
        }
        append(&file, None, "in two\n\tlines", "other test").unwrap();
        let skips = Skips::read(&file, None).unwrap();
        let expected = "skipped:\n  in two  lines\n      other test\n  no broker\n      mqtt a\n      mqtt b\n      mqtt c\n      \
                        and 1 more (`cargo xtask skips` lists all)";
        assert_eq!(skips.to_string(), expected);
        assert!(skips.in_full().to_string().ends_with("\n      mqtt c\n      mqtt d"));
    }

    #[test]
    fn a_list_begins_anew_with_each_run() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("skips.txt");
        append(&file, Some("first"), "no broker", "a").unwrap();
        append(&file, Some("first"), "no broker", "b").unwrap();
        assert_eq!(Skips::read(&file, Some("first")).unwrap().tests["no broker"].len(), 2);
        append(&file, Some("second"), "no broker", "c").unwrap();
        assert_eq!(Skips::read(&file, Some("first")).unwrap(), Skips::default());
        assert!(Skips::read(&file, Some("second")).unwrap().to_string().ends_with("\n  no broker\n      c"));
    }
}
