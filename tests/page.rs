//! The page in a browser, at a running emulated robot.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;

use std::ffi::OsString;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use common::rclpy::Peer;
use common::{Running, downbeat, record_until, robot_file};
use serde_json::json;

/// Where the browser is: `DOWNBEAT_CHROMIUM`, or where distributions put it.
fn chromium() -> Option<PathBuf> {
    let usual = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let named = std::env::var_os("DOWNBEAT_CHROMIUM").map(PathBuf::from);
    named.or_else(|| usual.iter().map(PathBuf::from).find(|path| path.exists()))
}

/// A script of `bridge/view/tests/page`, with what it needs in its environment. Where there is no Node.js or no browser, prints a
/// message.
fn script(name: &str) -> Option<Command> {
    let skip = |reason: &str| {
        let _ = writeln!(std::io::stderr(), "skipped: {reason}");
        None
    };
    let Some(modules) = std::env::var_os("DOWNBEAT_NODE_MODULES") else {
        return skip("DOWNBEAT_NODE_MODULES is not set (cargo xtask test sets it where there is Node.js)");
    };
    let Some(chromium) = chromium() else {
        return skip("there is no Chromium (Debian: the package chromium; elsewhere set DOWNBEAT_CHROMIUM)");
    };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bridge/view/tests/page");
    let mut command = Command::new("node");
    let variables: [(&str, OsString); 4] = [
        ("DOWNBEAT", env!("CARGO_BIN_EXE_downbeat").into()),
        ("DOWNBEAT_CHROMIUM", chromium.into()),
        ("DOWNBEAT_NODE_MODULES", modules),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST".into()),
    ];
    command.arg(folder.join(name)).envs(variables).stdin(Stdio::null());
    Some(command)
}

/// The URL for browsers.
fn page_of(program: &Running) -> String {
    const BEFORE: &str = "open in a browser: ";
    program.wait_for_output(BEFORE);
    let output = program.output();
    output.lines().find_map(|line| line.strip_prefix(BEFORE)).unwrap().to_owned()
}

/// Runs a script, which must succeed.
fn pass(script: &mut Command, shown: &Running) {
    let output = script.output().unwrap();
    let [out, error] =
        [output.stdout, output.stderr].map(|bytes| String::from_utf8_lossy(&bytes).into_owned());
    assert!(output.status.success(), "{out}\n{error}\n{}", shown.output());
}

#[test]
fn each_view_shows_true_values_of_a_running_robot_and_changes_it() {
    const DOMAIN: u16 = 213;
    let Some(mut script) = script("robot.mjs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = robot_file(folder.path(), |text| text);
    let domain = DOMAIN.to_string();
    let line = ["run", file.to_str().unwrap(), "--domain", &domain, "--view=0"];
    // Its recordings and its socket are in the folder.
    let robot =
        Running::start_by(downbeat(&line).current_dir(folder.path()).env("XDG_RUNTIME_DIR", folder.path()));
    script.env("DOWNBEAT_PAGE", page_of(&robot)).env("DOWNBEAT_FOLDER", folder.path());
    script.env("XDG_RUNTIME_DIR", folder.path()).env("ROS_DOMAIN_ID", &domain);
    pass(&mut script, &robot);

    // The parameter that was set in the page.
    let Some(mut rclpy) = Peer::start(DOMAIN, "LOCALHOST") else { return };
    let call = json!({"do": "parameters", "node": "/darwin_op", "call": "get_parameters", "argument": ["mux.hold_s"]});
    assert_eq!(rclpy.ask(call)["values"][0]["double_value"], 3.25);
    rclpy.leave();
}

#[test]
fn a_bag_is_scrubbed_in_the_page() {
    let Some(mut script) = script("bag.mjs") else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = robot_file(folder.path(), |text| text);
    let bag = folder.path().join("bag");
    let paths = [&bag, &file].map(|path| path.to_str().unwrap());
    let record = ["run", paths[1], "--domain", "215", "--record", paths[0]];
    record_until(&record, &bag, "/joint_states", 300);
    let shown = Running::start(&["bag", "view", paths[0], "--start-paused", "--port", "0", "--page", "0"]);
    script.env("DOWNBEAT_PAGE", page_of(&shown)).env("DOWNBEAT_BAG", &bag);
    pass(script.env("DOWNBEAT_FOLDER", folder.path()), &shown);
}
