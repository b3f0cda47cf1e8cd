//! `cargo xtask fleet`

use std::process::Command;

use crate::steps::run;

/// The fleet of 50 robots; `cargo xtask test` runs a small one.
pub(crate) fn fleet() -> anyhow::Result<()> {
    let package = ["--package", "downbeat-bridge", "--features", "zenoh", "--test", "fleet"];
    let tests = ["--", "--ignored", "--nocapture", "--exact", "fifty_robots_stay_together"];
    run(Command::new(env!("CARGO")).args(["test", "--release"]).args(package).args(tests))
}
