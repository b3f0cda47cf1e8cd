//! `cargo xtask aarch64`: tests for the processor of a Raspberry Pi, under qemu on this machine. Nothing is
//! timed.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};
use serde_json::Value;

use crate::dist::cross::{Target, environment};
use crate::dist::program;
use crate::skips;
use crate::steps::{Steps, output_of, run, workspace};

/// A bag and, beside it, its robot file.
const WALK: &str = "bags/recordings/darwin_op_walk_simulated";
/// Matches, of players that believe the truth and of players that see, with their simulated lengths.
const MATCHES: [(&str, &str); 2] = [("robots/match.toml", "40s"), ("robots/seeing_teams.toml", "20s")];
/// A match that begins soon, so that it has shots and falls.
const SOON: [&str; 2] = ["-p", "match.ready_s:=5"];

/// Parts of the names of tests of what qemu cannot: start the own program as a child, multicast over the
/// loopback interface, and the addresses of the error queue of a socket.
const NOT_UNDER_QEMU: [&str; 4] = [
    "killed",
    "a_full_disk_is_reported_once",
    "datagrams_to_the_group_and_to_the_address",
    "a_closed_port_is_reported_with_its_address",
];

/// Runs the tests of the lowest packages, and replays on each processor the runs that the other one recorded.
pub(crate) fn aarch64() -> anyhow::Result<()> {
    ensure!(
        test_machine::has_program("qemu-aarch64-static"),
        "qemu-aarch64-static is missing; on Debian: apt install qemu-user-static libc6:arm64"
    );
    let skips = skips::Run::new()?;
    let mut steps = Steps::default();
    steps.step("tests of executor, messages, bags and the RTPS engine", || tests(&skips));
    let mut programs = Vec::new();
    steps.step("programs for both processors", || {
        for target in [Target::X86_64, Target::Aarch64] {
            programs.push(Machine { target, program: program(target)? });
        }
        Ok(())
    });
    if let [x86_64, aarch64] = programs.as_slice() {
        steps.step("the recorded walk, on aarch64", || {
            // The bag lacks what its robot file does not record.
            let except = ["--strict", "--except", "ground_truth/*", "simulation", "simulator/**"];
            aarch64.replays(&Path::new(WALK).with_extension("toml"), Path::new(WALK), &except)
        });
        for (file, length) in MATCHES {
            for (records, replays) in [(x86_64, aarch64), (aarch64, x86_64)] {
                let name = format!("{file} recorded on {}, on {}", records.target, replays.target);
                steps.step(&name, || {
                    let folder = tempfile::tempdir()?;
                    let bag = folder.path().join("match");
                    records.records(file, length, &bag)?;
                    ["linear", "pool:2"].iter().try_for_each(|launcher| {
                        let options = [&SOON[..], &["--launcher", launcher]].concat();
                        replays.replays(Path::new(file), &bag, &options)
                    })
                });
            }
        }
    }
    skips.print()?;
    steps.finish()
}

fn tests(skips: &skips::Run) -> anyhow::Result<()> {
    let mut cargo = Command::new(env!("CARGO"));
    cargo.args(["test", "--no-fail-fast", "--lib", "--tests", "--target", Target::Aarch64.triple()]);
    cargo.args(
        ["executor", "msgs", "bags", "rtps", "policy"].map(|name| format!("--package=downbeat-{name}")),
    );
    // Peers are programs of this machine.
    cargo.envs(environment(Target::Aarch64)?).env_remove("DOWNBEAT_STRICT").envs([skips.variable()]);
    cargo.env("CARGO_TARGET_AARCH64_UNKNOWN_LINUX_GNU_RUNNER", "qemu-aarch64-static -L /");
    // The emulator is slow enough with code that is optimised; the generated code in the tests of messages
    // takes longer to optimise than to run.
    cargo.env("CARGO_PROFILE_DEV_OPT_LEVEL", "1").env("CARGO_PROFILE_DEV_DEBUG", "false");
    cargo.args(["--config", "profile.dev.package.downbeat-msgs.opt-level=0"]);
    cargo.env("CARGO_TARGET_DIR", workspace().join("target/aarch64")).env("CARGO_INCREMENTAL", "0");
    cargo.arg("--").args(NOT_UNDER_QEMU.map(|part| format!("--skip={part}")));
    run(&mut cargo)
}

/// A processor with the program of a release for it.
struct Machine {
    target: Target,
    program: PathBuf,
}

impl Machine {
    fn command(&self) -> Command {
        let mut command = self.target.runs(&self.program);
        command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
        command
    }

    fn records(&self, file: &str, length: &str, bag: &Path) -> anyhow::Result<()> {
        let mut plays = self.command();
        plays.args(["match", file, "--fast", "--duration", length]).args(SOON);
        run(plays.arg("--record").arg(bag))
    }

    /// Replays a bag: no message may be different.
    fn replays(&self, robot: &Path, bag: &Path, options: &[&str]) -> anyhow::Result<()> {
        let mut replay = self.command();
        replay.args(["bag", "replay"]).args([robot, bag]).arg("--json").args(options);
        let printed = output_of(&mut replay)?;
        let report = printed.find('{').map_or("", |start| &printed[start..]);
        let report: Value = serde_json::from_str(report).context("the replay has no report")?;
        let (compared, different) = (&report["compared"], &report["different"]);
        println!("{different} of {compared} messages are different");
        ensure!(*different == 0 && compared.as_u64() > Some(0), "{report:#}");
        Ok(())
    }
}
