//! `cargo xtask test`

use std::path::PathBuf;
use std::process::Command;

use crate::matrix::Notes;
use crate::steps::{Steps, run, run_and_repeat, workspace};
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
struct Peers {
    python: PathBuf,
    kilted: Option<PathBuf>,
    node_modules: Option<PathBuf>,
}

impl Peers {
    fn install() -> anyhow::Result<Self> {
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
}

/// The features that are not enabled by default. The library of MuJoCo is in the Python environment.
pub(crate) const ALL: &[&str] = &[
    "--features",
    "downbeat/football,downbeat/mqtt,downbeat/mujoco,downbeat/physics,downbeat/security,downbeat/sensors,downbeat/sqlite,downbeat/tables,downbeat/zenoh",
];

pub(crate) fn test() -> anyhow::Result<()> {
    // First, so that a missing Python is reported before minutes of building.
    python::find()?;
    let skips = skips::Run::new()?;
    let cargo = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO"));
        command.args(arguments);
        command
    };
    let mut steps = Steps::default();
    steps.step("formatting", || run(&mut cargo(&["fmt", "--all", "--check"])));
    steps.step("the layout", tidy::tidy);
    steps.step("licences, versions and origins of crates", || audit::in_test_run(&skips));
    // What waits for the network, beside what computes.
    let installed = std::thread::scope(|scope| {
        let installing = scope.spawn(Peers::install);
        steps.step("clippy", || {
            let mut command = cargo(&["clippy", "--workspace", "--all-targets"]);
            let others = "benches/zenoh,benches-ros2/security,benches-ros2/zenoh";
            run(command.args(ALL).args(["--features", others, "--", "--deny", "warnings"]))
        });
        installing.join()
    });
    let Peers { python, kilted, node_modules } =
        installed.map_err(|_| anyhow::anyhow!("what installs Python packages has panicked"))??;
    steps.step("messages and robots without optional features", || {
        for package in ["downbeat-msgs", "downbeat"] {
            let arguments = ["clippy", "--package", package, "--no-default-features"];
            run(cargo(&arguments).args(["--", "--deny", "warnings"]))?;
        }
        Ok(())
    });
    let notes = Notes::new()?;
    let first_hour = FirstHour::new()?;
    let has_nextest = cargo(&["nextest", "--version"]).output().is_ok_and(|output| output.status.success());
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
        command.env("DOWNBEAT_PYTHON", &python);
        command.envs(kilted.map(|python| ("DOWNBEAT_KILTED_PYTHON", python)));
        command.env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST");
        command.envs(node_modules.iter().map(|folder| ("DOWNBEAT_NODE_MODULES", folder)));
        // nextest says at its end how each failed test failed.
        run_and_repeat("Summary [", command.env("DOWNBEAT_MATRIX", notes.folder()).envs([skips.variable()]))
    });
    steps.step("the size of the default build", || {
        budget::check(if has_nextest { ALL } else { &["--features", "downbeat/tables"] })
    });
    steps.step("the Python package", || wheel::test(&skips));
    steps.step("crates as they would be published, and a Debian package of them", || {
        install::cargo_install().and_then(|program| install::debian_package(&program, &skips))
    });
    steps.step("what works with ROS 2", || notes.compare());
    steps.step("the first hour: what the pages say, typed in an empty home", || first_hour.print());
    steps.step("documentation tests", || run(cargo(&["test", "--workspace", "--doc", "--quiet"]).args(ALL)));
    steps.step("documentation", || {
        let arguments = ["doc", "--workspace", "--no-deps", "--quiet"];
        run(cargo(&arguments).args(ALL).env("RUSTDOCFLAGS", "--deny warnings"))
    });
    skips.print()?;
    steps.finish()
}
