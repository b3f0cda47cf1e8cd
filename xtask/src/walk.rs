//! `cargo xtask record-walk`

use std::process::Command;

use crate::steps::run;
use crate::test::ALL;

/// Records the bag `bags/recordings/darwin_op_walk_simulated`, and replays it.
pub(crate) fn record() -> anyhow::Result<()> {
    let tests = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO"));
        // As `cargo xtask test` builds them, so that nothing is compiled twice.
        command.args(["test", "--workspace"]).args(ALL).args(["--test", "walk_replay", "--"]).args(arguments);
        command
    };
    run(&mut tests(&["--ignored", "--exact", "record_the_walk"]))?;
    run(&mut tests(&[]))
}
