//! A test without its tool.
#![allow(clippy::unwrap_used, missing_docs)]

use std::process::{Command, Output};

use test_machine::{LIST, Skips, missing, skipped};

/// Set for the processes that the other test starts.
const LACKS: &str = "DOWNBEAT_TEST_LACKS";

#[test]
fn a_test_that_lacks_something() {
    match std::env::var(LACKS).as_deref() {
        Ok("a tool") => missing("sextant", "Debian: the package sextant"),
        Ok("a driver") => skipped("this kernel has no driver for sextants"),
        _ => {}
    }
}

#[test]
fn a_missing_tool_is_printed_and_listed_and_fails_a_strict_run_but_a_missing_driver_does_not() {
    let folder = tempfile::tempdir().unwrap();
    let list = folder.path().join("skips.txt");
    let run = |lacks: &str, strict: &str| {
        let mut command = Command::new(std::env::current_exe().unwrap());
        command.args(["--exact", "a_test_that_lacks_something"]).env(LACKS, lacks);
        command.env(LIST, &list).env("DOWNBEAT_STRICT", strict).output().unwrap()
    };
    let error = |output: &Output| String::from_utf8_lossy(&output.stderr).into_owned();

    let strict = run("a tool", "1");
    let said = String::from_utf8_lossy(&strict.stdout).into_owned();
    assert!(!strict.status.success() && said.contains("sextant is missing (Debian: the package"), "{said}");
    assert_eq!(Skips::read(&list, None).unwrap(), Skips::default());

    for (strict, lacks) in [("", "a tool"), ("0", "a tool"), ("1", "a driver")] {
        let passed = run(lacks, strict);
        let line = "skipped: skips a_test_that_lacks_something: ";
        // Although the harness shows nothing that a passing test prints.
        assert!(passed.status.success() && error(&passed).contains(line), "{}", error(&passed));
    }
    let test = "skips a_test_that_lacks_something";
    let expected = format!(
        "skipped:\n  sextant is missing (Debian: the package sextant)\n      {test}\n  \
         this kernel has no driver for sextants\n      {test}"
    );
    assert_eq!(Skips::read(&list, None).unwrap().to_string(), expected);
}
