//! `cargo xtask security`

use std::process::Command;

use crate::steps::run;

/// The fuzz targets of DDS Security, in release; `cargo xtask test` runs some thousand inputs of each.
pub(crate) fn security(rounds: u64) -> anyhow::Result<()> {
    let package =
        ["test", "--release", "--package", "downbeat-security", "--test", "fuzz", "--", "--nocapture"];
    run(Command::new(env!("CARGO")).args(package).env("DOWNBEAT_FUZZ_ROUNDS", rounds.to_string()))
}
