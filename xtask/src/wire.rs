//! `cargo xtask wire`

use std::process::Command;

use crate::python;
use crate::steps::{Steps, run};

/// The long tests of the RTPS engine; `cargo xtask test` runs short versions of them.
pub(crate) fn wire() -> anyhow::Result<()> {
    let cargo = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO"));
        command.args(arguments);
        command
    };
    let mut steps = Steps::default();
    steps.step("rustdds, the second engine, in the conformance suite", || {
        let package = ["--package", "downbeat-conformance", "--features", "rustdds"];
        let tests = ["--test", "rustdds", "--", "--test-threads=1"];
        run(cargo(&["test"]).args(package).args(tests).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"))
    });
    steps.step("the engine with DDS Security in the conformance suite", || {
        let package = ["--package", "downbeat-conformance", "--features", "security", "--test", "secured"];
        run(cargo(&["test"]).args(package).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"))
    });
    steps.step("rustdds with DDS Security", || {
        let package = ["--package", "downbeat-bridge", "--features", "security", "--test", "security"];
        run(cargo(&["test"]).args(package).args(["--", "--ignored"]))
    });
    let rtps = |test: &str| cargo(&["test", "--release", "--package", "downbeat-rtps", "--test", test]);
    steps.step("10 000 simulated networks", || {
        run(rtps("simulation").env("DOWNBEAT_SIMULATION_SEEDS", "10000"))
    });
    steps.step("10 million hostile datagrams", || {
        run(rtps("hostile").env("DOWNBEAT_FUZZ_ROUNDS", "500000").args(["after_much_noise"]))
    });
    steps.step("cables that are out for half a minute and a minute", || {
        let package = ["test", "--package", "downbeat-bridge", "--test", "between_hosts"];
        let python = python::interpreter()?;
        let mut command = cargo(&package);
        command.args(["--", "--ignored", "who_is_behind_a_cable", "--test-threads=1"]);
        run(command.env("DOWNBEAT_PYTHON", python))
    });
    steps.finish()
}
