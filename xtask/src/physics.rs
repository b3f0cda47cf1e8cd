//! `cargo xtask physics`

use std::process::Command;

use crate::steps::run;

/// The simulated Darwin OP in perturbed worlds; `cargo xtask test` runs one world for each task.
pub(crate) fn physics(arguments: &[String]) -> anyhow::Result<()> {
    let example = ["run", "--release", "--package", "downbeat-physics", "--features", "mujoco"];
    run(Command::new(env!("CARGO")).args(example).args(["--example", "tasks", "--"]).args(arguments))
}
