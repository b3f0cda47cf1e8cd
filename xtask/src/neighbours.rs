//! `cargo xtask neighbours`

use std::process::Command;

use crate::python;
use crate::steps::run;

/// LeRobot with all that it needs, 4 GB.
const LEROBOT: &str = "lerobot==0.4.4";

/// What is too large for the test run.
pub(crate) fn neighbours() -> anyhow::Result<()> {
    let lerobot = python::tools("target/venv_lerobot", &[LEROBOT])?;
    let tests = ["test", "--release", "--package", "downbeat", "--features", "tables", "--test", "datasets"];
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(tests).args(["--", "--ignored", "--nocapture", "--test-threads=1"]);
    cargo.env("DOWNBEAT_LEROBOT_PYTHON", lerobot).env("DOWNBEAT_PYTHON", python::interpreter()?);
    run(&mut cargo)
}
