//! Opens pages of the program in a browser, driven by Node.js.

use std::ffi::OsString;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The path of the browser: `DOWNBEAT_CHROMIUM`, or the usual paths of distributions.
fn chromium() -> Option<PathBuf> {
    let usual = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let named = std::env::var_os("DOWNBEAT_CHROMIUM").map(PathBuf::from);
    named.or_else(|| usual.iter().map(PathBuf::from).find(|path| path.exists()))
}

/// A script of `bridge/view/tests/page`, with its environment. If there is no Node.js or no browser, prints a
/// message and returns `None`.
pub fn script(name: &str) -> Option<Command> {
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
