//! What modules of libraries show a debugger. Skipped on machines without a compiler.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use common::{Robot, library};
use downbeat_executor::{LifecycleState, ModuleOptions, Restart};
use downbeat_library_host::{LibraryOptions, set_child_command};
use downbeat_msgs::std_msgs::msg::Float64;
use std::ffi::OsString;
use std::path::Path;
use std::time::Duration;

/// Robots with the library in their process and in a child process.
fn both(path: &Path) -> [Robot; 2] {
    set_child_command([OsString::from(env!("CARGO_BIN_EXE_library-child"))]);
    [false, true].map(|is_isolated| {
        let mut robot = Robot::new();
        let options = LibraryOptions {
            module: "module".into(),
            path: path.into(),
            is_isolated,
            ..LibraryOptions::default()
        };
        robot.add(&options, ModuleOptions::default()).unwrap();
        robot
    })
}

fn is_active(robot: &Robot) -> bool {
    robot.core.modules()[0].state == LifecycleState::Active
}

#[test]
fn a_module_in_c_shows_its_variables() {
    let Some(path) = library("amplifier.c", &[]) else { return };
    for mut robot in both(&path) {
        let input = robot.core.inlet::<Float64>("in").unwrap();
        robot.cycles(3);
        input.publish(Float64 { data: 1.5 }).unwrap();
        robot.cycles(5);
        // It is published at 30 ms and taken at 40 ms; later the module is not called.
        let shown = "amplifier {\n    received: 1,\n    has_begun: true,\n    out: 3.0,\n    \
                     text: \"in \\\"C\\\"\",\n    last: [3.0, 0.04],\n}";
        assert_eq!(robot.core.debug("module").unwrap(), shown);
    }
}

#[test]
fn a_module_in_cpp_shows_values_of_all_kinds() {
    let Some(path) = library("counter.cpp", &[]) else { return };
    for mut robot in both(&path) {
        robot.cycles(1);
        let before = robot.core.debug("module").unwrap();
        robot.cycles(9);
        let after = robot.core.debug("module").unwrap();
        assert!(before.starts_with("Counter {\n    count: 0.0,\n"), "{before}");
        assert!(!after.starts_with("Counter {\n    count: 0.0,\n"), "{after}");
        let rest = "    is_on: true,\n    small: 7,\n    large: \"18446744073709551615\",\n    color: 1,\n    \
                    text: \"two\\nlines\",\n    literal: \"letters\",\n    bytes: [1, 2],\n    floats: [0.5, 1.0],\n    \
                    numbers: [-1, 2],\n    flags: [true, false],\n    names: [\"left\", \"right\"],\n    none: [],\n}";
        assert!(after.ends_with(rest), "{after}");
    }
}

#[test]
fn a_library_with_the_table_of_the_first_header_shows_nothing() {
    for size in ["-DSIZE_IS_WHOLE", "-DSIZE=(sizeof(first_module_v1)+1)"] {
        let Some(path) = library("old.c", &[size]) else { return };
        for mut robot in both(&path) {
            robot.cycles(3);
            assert_eq!(robot.core.debug("module"), None);
            assert!(is_active(&robot));
        }
    }
}

#[test]
fn a_table_shorter_than_that_of_the_first_header_is_refused() {
    let Some(path) = library("old.c", &["-DSIZE=offsetof(first_module_v1,restore)"]) else { return };
    let mut robot = Robot::new();
    let options = LibraryOptions { module: "module".into(), path, ..LibraryOptions::default() };
    let refusal = robot.add(&options, ModuleOptions::default()).unwrap_err();
    assert!(refusal.contains("set struct_size to sizeof(downbeat_module_v1)"), "{refusal}");
}

#[test]
fn values_that_are_none_and_thousands_of_variables_do_no_harm() {
    for fails in [false, true] {
        let Some(path) = library("hostile.c", if fails { &["-DFAILS"] } else { &[] }) else { return };
        for mut robot in both(&path) {
            robot.cycles(3);
            let shown = robot.core.debug("module").unwrap();
            assert!(shown.starts_with("hostile\u{fffd} {\n"), "{shown}");
            for line in [
                "line\\nbreak \u{fffd}\\u{1b}[31m: \"\u{fffd}( \\u{1b}[31m\",",
                "texts: [\"a\u{fffd}\", NULL, \"b\"],",
                "unknown: <77 is no kind of value>,",
                "nothing: <the data of the value are NULL>,",
                "two: <a single value has count 1, not 2>,",
                "null: <the value is NULL>,",
                "number_0: 0,",
            ] {
                assert!(shown.lines().any(|shown| shown.trim_start() == line), "{line}\n{shown}");
            }
            for part in
                ["xxx\"... and 1046576 more bytes,", ", 120, ... and ", "short: <downbeat_value_v1 declares"]
            {
                assert!(shown.contains(part), "{part}\n{shown}");
            }
            assert!(shown.lines().all(|line| line.len() < 2500), "{shown}");
            let end = shown.split_once("\n}").unwrap().1;
            let failure =
                if fails { "\nfurther variables cannot be shown: there is no joint 21" } else { "" };
            assert_eq!(end, format!("\n... and 4510 more{failure}"));
            robot.cycles(3);
            assert!(is_active(&robot), "neither a request nor a failure has an effect");
            assert_eq!(robot.core.debug("module").unwrap(), shown);
        }
    }
}

#[test]
fn an_exception_is_shown_behind_the_variables() {
    for (define, reason) in [
        ("-DMISTAKE_OF_VARIABLES", "there is no joint 21"),
        ("-DSETTING_OF_VARIABLES", "settings can be read in `setup`, `handle` and `transition` only"),
    ] {
        let Some(path) = library("counter.cpp", &[define]) else { return };
        for mut robot in both(&path) {
            robot.cycles(5);
            let shown = robot.core.debug("module").unwrap();
            assert!(shown.starts_with("Counter {\n    count: "), "{shown}");
            assert!(shown.ends_with(&format!("}}\nfurther variables cannot be shown: {reason}")), "{shown}");
            let counts = robot.receive("count");
            robot.cycles(5);
            assert!(counts.try_iter().count() > 0);
        }
    }
}

#[test]
fn a_child_that_does_not_return_its_variables_is_killed_and_the_module_starts_again() {
    let Some(path) = library("counter.cpp", &["-DENDLESS_VARIABLES"]) else { return };
    set_child_command([OsString::from(env!("CARGO_BIN_EXE_library-child"))]);
    let options = LibraryOptions {
        module: "module".into(),
        path,
        is_isolated: true,
        time_limit: Duration::from_millis(500),
        ..LibraryOptions::default()
    };
    let mut robot = Robot::new();
    let restart = Restart::Times { limit: 1, backoff: Duration::from_millis(10) };
    robot.add(&options, ModuleOptions { restart, ..ModuleOptions::default() }).unwrap();
    robot.cycles(3);
    let shown = robot.core.debug("module").unwrap();
    assert!(shown.starts_with("its variables cannot be shown: the child process "), "{shown}");
    assert!(shown.contains("did not return from `variables` within 500ms and was killed"), "{shown}");
    robot.cycles(10);
    assert_eq!(robot.core.modules()[0].restarts, 1);
    assert!(is_active(&robot));
}
