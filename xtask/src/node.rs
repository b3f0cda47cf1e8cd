//! The npm packages of the tests: Foxglove's bag reader and its client for viewers, and what looks at our own
//! page.

use std::path::PathBuf;
use std::process::Command;

use anyhow::Context;

use crate::steps::{run, workspace};

/// The files that specify packages and versions.
const MANIFESTS: [&str; 2] = ["package.json", "package-lock.json"];

/// Installs the packages if they are missing or outdated and returns their folder. If there is no Node.js,
/// reports this and returns `None`: tests that need it are then skipped. In a strict run, that is an error.
pub(crate) fn modules() -> anyhow::Result<Option<PathBuf>> {
    if let Err(found) = find() {
        anyhow::ensure!(!test_machine::is_strict(), "{found}; install Node.js and npm, which tests need");
        eprintln!(
            "xtask: {found}; the tests with @mcap/core, with @foxglove/ws-protocol and of the page are skipped"
        );
        return Ok(None);
    }
    let source = workspace().join("bags/tests/node");
    let folder = workspace().join("target/node");
    let modules = folder.join("node_modules");
    // Written last, so that an interrupted installation is repeated.
    let installed = folder.join("installed-package-lock.json");
    let lock = source.join(MANIFESTS[1]);
    let wanted = std::fs::read_to_string(&lock).with_context(|| lock.display().to_string())?;
    if std::fs::read_to_string(&installed).is_ok_and(|text| text == wanted) {
        return Ok(Some(modules));
    }
    eprintln!("xtask: installing the npm packages of the tests into {}", folder.display());
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    for name in MANIFESTS {
        std::fs::copy(source.join(name), folder.join(name)).with_context(|| name.to_owned())?;
    }
    // Install scripts of packages do not run.
    let arguments = ["ci", "--ignore-scripts", "--no-audit", "--no-fund", "--loglevel=error", "--prefix"];
    run(Command::new("npm").args(arguments).arg(&folder))?;
    std::fs::write(&installed, wanted).with_context(|| installed.display().to_string())?;
    Ok(Some(modules))
}

const OLDEST: u32 = 18;

fn find() -> Result<(), String> {
    let version = |program: &str| -> Option<String> {
        let output = Command::new(program).arg("--version").output().ok()?;
        output.status.success().then(|| String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let node = version("node").ok_or("there is no Node.js")?;
    let major = node.trim_start_matches('v').split('.').next().and_then(|major| major.parse::<u32>().ok());
    if major.is_none_or(|major| major < OLDEST) {
        return Err(format!("Node.js is {node}, and {OLDEST} is needed"));
    }
    version("npm").ok_or("there is no npm")?;
    Ok(())
}
