//! `cargo xtask test`

use std::ffi::OsStr;
use std::path::PathBuf;
use std::process::Command;
use std::thread::JoinHandle;

use anyhow::Context;

use crate::matrix::Notes;
use crate::steps::{Steps, output_of, run, run_and_repeat, workspace};
use crate::{audit, budget, install, node, python, skips, tidy, wheel};

/// The steps of new users, which the tests of pages and templates write down.
struct FirstHour(PathBuf);

impl FirstHour {
    fn new() -> anyhow::Result<Self> {
        let folder = workspace().join("target/first_hour/steps");
        if folder.exists() {
            std::fs::remove_dir_all(&folder)?;
        }
        std::fs::create_dir_all(&folder)?;
        Ok(Self(folder))
    }

    /// Prints one list of all steps with their seconds.
    fn print(&self) -> anyhow::Result<()> {
        let mut files: Vec<_> = std::fs::read_dir(&self.0)?.flatten().map(|entry| entry.path()).collect();
        files.sort();
        anyhow::ensure!(!files.is_empty(), "no page was typed");
        let mut total = 0.0;
        for file in files {
            for line in std::fs::read_to_string(&file)?.lines() {
                total += line
                    .split_whitespace()
                    .next()
                    .and_then(|number| number.parse::<f64>().ok())
                    .unwrap_or(0.0);
                println!("{line}");
            }
        }
        println!("{total:>7.1} s  in all");
        Ok(())
    }
}

/// What the tests need of others.
pub(crate) struct Peers {
    python: PathBuf,
    kilted: Option<PathBuf>,
    node_modules: Option<PathBuf>,
}

impl Peers {
    pub(crate) fn install() -> anyhow::Result<Self> {
        let python = python::interpreter()?;
        let kilted = match python::kilted_interpreter() {
            Err(error) if !test_machine::is_strict() => {
                eprintln!("xtask: the tests with ROS 2 Kilted are skipped: {error:#}");
                None
            }
            interpreter => Some(interpreter?),
        };
        Ok(Self { python, kilted, node_modules: node::modules()? })
    }

    /// Tells tests where the peers are, and keeps both on this machine.
    pub(crate) fn tell<'a>(&self, tests: &'a mut Command) -> &'a mut Command {
        tests.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST").env("DOWNBEAT_PYTHON", &self.python);
        tests.envs(self.kilted.iter().map(|python| ("DOWNBEAT_KILTED_PYTHON", python)));
        tests.envs(self.node_modules.iter().map(|folder| ("DOWNBEAT_NODE_MODULES", folder)))
    }
}

/// The target folder of lints and documentation, since cargo locks that of the tests.
const LINTS: &str = "target/lints";

/// Lints, documentation, and what the packages of a release compile, in the time that tests spend waiting.
struct Aside(JoinHandle<Vec<(&'static str, anyhow::Result<()>)>>);

impl Aside {
    /// Begins once the tests are compiled: macros and build scripts are the same, and are not compiled twice.
    fn start(own: PathBuf) -> anyhow::Result<Self> {
        if let Err(error) = lend_to_lints() {
            eprintln!("xtask: lints compile macros and build scripts again: {error:#}");
        }
        let commands = move || {
            let others = ["--features", "benches/zenoh,benches-ros2/security,benches-ros2/zenoh"];
            let mut clippy = Self::lint(&["clippy", "--workspace", "--all-targets"]);
            clippy.args(ALL).args(others).args(["--", "--deny", "warnings"]);
            let mut documentation = Self::lint(&["doc", "--workspace", "--no-deps", "--quiet"]);
            documentation.args(ALL).env("RUSTDOCFLAGS", "--deny warnings");
            let bare = |package| {
                let mut clippy = Self::lint(&["clippy", "--package", package, "--no-default-features"]);
                clippy.args(["--", "--deny", "warnings"]);
                clippy
            };
            // This program once more, whose commands are as modest as it is.
            let mut packages = Self::modest(&own);
            packages.args(["crates", "--compile"]);
            [
                ("clippy", clippy),
                ("documentation", documentation),
                ("messages without optional features", bare("downbeat-msgs")),
                ("robots without optional features", bare("downbeat")),
                ("compiling the crates as they would be published", packages),
            ]
        };
        let run_all = move || {
            let results = commands().into_iter().map(|(name, mut command)| (name, output_of(&mut command)));
            results.map(|(name, printed)| (name, printed.map(drop))).collect()
        };
        let thread = std::thread::Builder::new().name("aside".to_owned()).spawn(run_all);
        Ok(Self(thread.context("cannot start a thread")?))
    }

    /// A command that leaves the processor to tests. Not wholly: tests that call cargo wait for its lock of
    /// packages.
    fn modest(program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new("nice");
        command.args(["-n", "19"]).arg(program);
        command
    }

    fn lint(arguments: &[&str]) -> Command {
        let mut command = Self::modest(env!("CARGO"));
        command.args(arguments).args(["--target-dir", LINTS]);
        command
    }

    /// Waits for the rest, and reports what came of it.
    fn finish(self, steps: &mut Steps) -> anyhow::Result<()> {
        eprintln!("\n== waiting for lints, documentation and packages");
        let results =
            self.0.join().map_err(|_| anyhow::anyhow!("what runs beside the tests has panicked"))?;
        for (name, result) in results {
            steps.step(name, || result);
        }
        Ok(())
    }
}

/// Makes what was compiled for tests known to cargo in the target folder of lints. Programs are linked, what
/// cargo writes into is copied.
fn lend_to_lints() -> anyhow::Result<()> {
    let [tests, lints] = ["target/debug", LINTS].map(|folder| workspace().join(folder));
    let lints = lints.join("debug");
    if lints.exists() || !tests.exists() {
        return Ok(());
    }
    std::fs::create_dir_all(&lints).with_context(|| lints.display().to_string())?;
    for (folder, how) in [("deps", "--link"), ("build", "--preserve"), (".fingerprint", "--preserve")] {
        run(Command::new("cp").args(["--archive", how]).arg(tests.join(folder)).arg(&lints))?;
    }
    Ok(())
}

/// The features that are not enabled by default. The library of MuJoCo is in the Python environment.
pub(crate) const ALL: &[&str] = &[
    "--features",
    "downbeat/football,downbeat/mqtt,downbeat/mujoco,downbeat/physics,downbeat/policy,downbeat/px4,downbeat/security,downbeat/sensors,downbeat/sqlite,downbeat/tables,downbeat/zenoh",
];

pub(crate) fn test() -> anyhow::Result<()> {
    // First, so that a missing Python is reported before minutes of building.
    python::find()?;
    let skips = skips::Run::new()?;
    // Now, because cargo will replace this program, and the system then adds "(deleted)" to its path.
    let own = std::env::current_exe().context("the path of xtask is not known")?;
    let cargo = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO"));
        command.args(arguments);
        command
    };
    let mut steps = Steps::default();
    steps.step("formatting", || run(&mut cargo(&["fmt", "--all", "--check"])));
    steps.step("the layout", tidy::tidy);
    steps.step("licences, versions and origins of crates", || audit::in_test_run(&skips));
    let has_nextest = cargo(&["nextest", "--version"]).output().is_ok_and(|output| output.status.success());
    // What waits for the network, beside what computes.
    let installed = std::thread::scope(|scope| {
        let installing = scope.spawn(Peers::install);
        if has_nextest {
            steps.step("compiling the tests", || {
                run(cargo(&["nextest", "run", "--workspace", "--no-run"]).args(ALL))
            });
        }
        installing.join()
    });
    let peers = installed.map_err(|_| anyhow::anyhow!("what installs Python packages has panicked"))??;
    let aside = Aside::start(own)?;
    let notes = Notes::new()?;
    let first_hour = FirstHour::new()?;
    let tests: &[&str] = if has_nextest {
        &["nextest", "run", "--workspace"]
    } else {
        // One at a time: robots at 125 Hz with real peers need all cores of the machine.
        &[
            "test",
            "--workspace",
            "--features",
            "downbeat/tables",
            "--lib",
            "--bins",
            "--tests",
            "--",
            "--test-threads=1",
        ]
    };
    steps.step("tests, with real ROS 2 and others' bag readers", || {
        let mut command = cargo(tests);
        command.args(if has_nextest { ALL } else { &[] });
        peers.tell(&mut command);
        // nextest says at its end how each failed test failed.
        run_and_repeat("Summary [", command.env("DOWNBEAT_MATRIX", notes.folder()).envs([skips.variable()]))
    });
    steps.step("the size of the default build", || {
        budget::check(if has_nextest { ALL } else { &["--features", "downbeat/tables"] })
    });
    steps.step("the Python package", || wheel::test(&skips));
    steps.step("what works with ROS 2", || notes.compare());
    steps.step("the first hour: what the pages say, typed in an empty home", || first_hour.print());
    steps.step("documentation tests", || run(cargo(&["test", "--workspace", "--doc", "--quiet"]).args(ALL)));
    // With what was compiled beside the tests.
    let packaged = aside.finish(&mut steps);
    steps.step("crates as they would be published, and a Debian package of them", || {
        packaged?;
        install::cargo_install().and_then(|program| install::debian_package(&program, &skips))
    });
    skips.print()?;
    steps.finish()
}
