//! `cargo xtask recorder`

use std::process::Command;

use crate::steps::run;
use crate::{node, python};

/// Records beside busy cores, on slow and full disks (as root), with splits, kills, large messages and floods
/// of small ones. Other readers open every bag.
pub(crate) fn recorder(minutes: f64) -> anyhow::Result<()> {
    let (python, modules) = (python::interpreter()?, node::modules()?);
    println!(
        "| experiment | load | offered | written | lost | most MB queued in each half | files | read by |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
    let mut command = Command::new(env!("CARGO"));
    command.args([
        "test",
        "--release",
        "--quiet",
        "--package",
        "downbeat-bags",
        "--test",
        "bags",
        "under_load::",
        "--",
    ]);
    // One after another: each measures the machine.
    command.args(["--ignored", "--nocapture", "--test-threads=1"]);
    command.env("DOWNBEAT_PYTHON", python).env("DOWNBEAT_MINUTES", minutes.to_string());
    command.envs(modules.iter().map(|folder| ("DOWNBEAT_NODE_MODULES", folder)));
    run(&mut command)
}
