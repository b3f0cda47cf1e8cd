//! `cargo xtask bags`

use std::process::Command;

use crate::python;
use crate::steps::{Steps, run};

/// The long tests of damaged bags; `cargo xtask test` runs short versions of them.
pub(crate) fn bags() -> anyhow::Result<()> {
    let python = python::interpreter()?;
    let mut steps = Steps::default();
    steps.step("500 mutations of every recorded bag", || {
        let mut command = Command::new(env!("CARGO"));
        command.args([
            "test",
            "--release",
            "--package",
            "downbeat",
            "--test",
            "bag_mutations",
            "--",
            "--nocapture",
        ]);
        run(command.env("DOWNBEAT_PYTHON", &python).env("DOWNBEAT_BAG_MUTATIONS", "500"))
    });
    steps.step("a million mutations of small bag files", || {
        let mut command = Command::new(env!("CARGO"));
        command.args([
            "test",
            "--release",
            "--package",
            "downbeat-bags",
            "--test",
            "fuzz",
            "any_mutated_bag",
        ]);
        run(command.env("DOWNBEAT_FUZZ_ROUNDS", "1000000"))
    });
    steps.finish()
}
