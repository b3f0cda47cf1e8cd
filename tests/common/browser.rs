//! Opens pages of the program in a browser, driven by Node.js.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The path of the browser: `DOWNBEAT_CHROMIUM`, or the usual paths of distributions.
fn chromium() -> Option<PathBuf> {
    let usual = ["/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];
    let named = std::env::var_os("DOWNBEAT_CHROMIUM").map(PathBuf::from);
    named.or_else(|| usual.iter().map(PathBuf::from).find(|path| path.exists()))
}

/// A script of `bridge/view/tests/page`, with its environment. If there is no Node.js or no browser, reports
/// a skipped test and returns `None`.
pub fn script(name: &str) -> Option<Command> {
    let modules = test_machine::node_modules()?;
    let Some(chromium) = chromium() else {
        test_machine::missing("Chromium", "Debian: the package chromium; elsewhere set DOWNBEAT_CHROMIUM");
        return None;
    };
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("bridge/view/tests/page");
    let mut command = Command::new("node");
    let variables: [(&str, OsString); 5] = [
        ("DOWNBEAT", env!("CARGO_BIN_EXE_downbeat").into()),
        ("DOWNBEAT_CHROMIUM", chromium.into()),
        ("DOWNBEAT_NODE_MODULES", modules),
        ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST".into()),
        ("ROS_DOMAIN_ID", super::own_domain().to_string().into()),
    ];
    command.arg(folder.join(name)).envs(variables).stdin(Stdio::null());
    Some(command)
}
