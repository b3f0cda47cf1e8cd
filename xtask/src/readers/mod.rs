//! `cargo xtask readers`

use std::process::Command;

use anyhow::Context;

use crate::steps::{Steps, run, workspace};
use crate::test::{self, Peers};

/// Runs all tests, keeps every bag that they remove, and opens each with the readers of others.
pub(crate) fn readers() -> anyhow::Result<()> {
    let folder = workspace().join("target/kept");
    if folder.exists() {
        std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
    }
    let (bags, temporary) = (folder.join("bags"), folder.join("tmp"));
    for folder in [&bags, &temporary] {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    let library = folder.join("keep_bags.so");
    let source = workspace().join("xtask/src/readers/keep_bags.c");
    run(Command::new("cc").args(["-shared", "-fPIC", "-O1", "-o"]).arg(&library).arg(source))?;
    let peers = Peers::install()?;
    let cargo = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO"));
        peers.tell(command.args(arguments).args(test::ALL).env("KEPT_BAGS", &bags));
        command
    };
    let mut steps = Steps::default();
    steps.step("compiling the tests", || run(&mut cargo(&["nextest", "run", "--workspace", "--no-run"])));
    steps.step("tests, whose bags are kept", || {
        let mut tests = cargo(&["nextest", "run", "--workspace"]);
        // Links do not cross file systems.
        run(tests.env("TMPDIR", &temporary).env("LD_PRELOAD", &library))
    });
    steps.step("every kept bag, opened by others", || {
        let mut readers = cargo(&["test", "--workspace", "--test", "bags"]);
        run(readers.args(["others_open_every_kept_bag", "--", "--ignored", "--nocapture"]))
    });
    steps.finish()
}
