//! `cargo xtask dist --test`: each way of installing, in a clean environment, up to the joint states of the
//! demo robot at a subscriber of ROS 2, and back.

use std::io::{BufRead, BufReader, Lines};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdout, Command, Stdio};
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

use super::release::{Release, fresh};
use crate::steps::{run, workspace};
use crate::{python, wheel};

/// How the program comes onto a machine.
#[derive(Clone, Copy)]
enum Way {
    Pip,
    Tarball,
}

/// What a way costs.
struct Figures {
    install: Duration,
    /// On the disk, in bytes.
    size: u64,
    first_joint_state: Duration,
    /// Resident memory of the robot, in kB.
    memory: u64,
}

/// At 125 Hz some seconds' worth of them, for memory to settle.
const MESSAGES: usize = 400;

/// Of a Darwin OP.
const JOINTS: &str = "20";

pub(super) fn test(release: &Release) -> anyhow::Result<()> {
    let subscriber = match std::env::var_os("DOWNBEAT_PYTHON") {
        Some(interpreter) => interpreter.into(),
        None => python::interpreter()?,
    };
    println!("{:<8}{:>12}{:>12}{:>20}{:>12}", "way", "install", "size", "first joint state", "memory");
    for way in [Way::Pip, Way::Tarball] {
        let figures = way.costs(release, &subscriber).with_context(|| way.name())?;
        println!(
            "{:<8}{:>10.1} s{:>9.1} MB{:>17} ms{:>9.1} MB",
            way.name(),
            figures.install.as_secs_f64(),
            figures.size as f64 / 1e6,
            figures.first_joint_state.as_millis(),
            figures.memory as f64 / 1e3,
        );
    }
    println!("removed again: nothing is left but the files of the robot in ~/.cache/downbeat");
    Ok(())
}

impl Way {
    fn name(self) -> &'static str {
        match self {
            Self::Pip => "pip",
            Self::Tarball => "tarball",
        }
    }

    fn costs(self, release: &Release, subscriber: &Path) -> anyhow::Result<Figures> {
        let place = release.scratch.join("from_nothing").join(self.name());
        fresh(&place)?;
        fresh(&place.join("home"))?;
        self.prepare(&place)?;
        let before = size(&files(&place)?);
        let started = Instant::now();
        self.install(release, &place)?;
        let install = started.elapsed();
        let size = size(&files(&place)?) - before;
        let program = self.program(release, &place);
        let (first_joint_state, memory) = joint_states(&program, &place.join("home"), subscriber)?;
        self.remove(release, &place)?;
        for file in files(&place)? {
            let path = file.path.strip_prefix(&place)?;
            let is_ours = path.to_string_lossy().contains("downbeat");
            let is_cache = path.starts_with("home/.cache/downbeat");
            ensure!(is_cache || !is_ours, "{} is left after removal", file.path.display());
        }
        Ok(Figures { install, size, first_joint_state, memory })
    }

    /// Makes what a user has before.
    fn prepare(self, place: &Path) -> anyhow::Result<()> {
        match self {
            Self::Pip => run(Command::new(wheel::tools()?).args(["-m", "venv"]).arg(place.join("venv"))),
            Self::Tarball => Ok(()),
        }
    }

    fn install(self, release: &Release, place: &Path) -> anyhow::Result<()> {
        match self {
            Self::Pip => {
                let package = format!("downbeat-robotics=={}", release.version);
                let mut pip = Command::new(place.join("venv/bin/python"));
                pip.args(["-m", "pip", "--quiet", "install", "--no-cache-dir", "--only-binary=:all:"]);
                run(pip.arg("--find-links").arg(&release.out).arg(package))
            }
            Self::Tarball => {
                let tarball = release.out.join(format!("{}.tar.gz", release.name()));
                run(Command::new("tar").arg("-xzf").arg(tarball).arg("-C").arg(place))
            }
        }
    }

    fn program(self, release: &Release, place: &Path) -> PathBuf {
        match self {
            Self::Pip => place.join("venv/bin/downbeat"),
            Self::Tarball => place.join(release.name()).join("bin/downbeat"),
        }
    }

    fn remove(self, release: &Release, place: &Path) -> anyhow::Result<()> {
        match self {
            Self::Pip => {
                let pip = ["-m", "pip", "--quiet", "uninstall", "--yes", "downbeat-robotics"];
                run(Command::new(place.join("venv/bin/python")).args(pip))
            }
            Self::Tarball => {
                let folder = place.join(release.name());
                std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())
            }
        }
    }
}

/// Starts the demo robot, and returns when its first joint state arrived and the memory it takes after some
/// seconds, in kB.
fn joint_states(program: &Path, home: &Path, subscriber: &Path) -> anyhow::Result<(Duration, u64)> {
    let domain = test_machine::free_domain().to_string();
    let network = [("ROS_DOMAIN_ID", domain.as_str()), ("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")];
    let script = workspace().join("xtask/src/dist/joint_states.py");
    let mut listener = Killed::start(Command::new(subscriber).arg(script).envs(network))?;
    let stdout = listener.0.stdout.take().context("the subscriber has no output")?;
    let mut lines = BufReader::new(stdout).lines();
    expect(&mut lines, "listening")?;

    let mut robot = Command::new(program);
    robot.args(["run", "darwin_op"]).env_clear().envs(network).current_dir(home);
    robot.env("HOME", home).env("PATH", "/usr/bin:/bin");
    let started = Instant::now();
    let mut robot = Killed::start(&mut robot)?;
    expect(&mut lines, JOINTS)?;
    let first = started.elapsed();
    for _ in 1..MESSAGES {
        expect(&mut lines, JOINTS)?;
    }
    let status = std::fs::read_to_string(format!("/proc/{}/status", robot.0.id()))?;
    let memory =
        status.lines().find_map(|line| line.strip_prefix("VmRSS:")?.strip_suffix("kB")?.trim().parse().ok());
    run(Command::new("kill").args(["-INT", &robot.0.id().to_string()]))?;
    let status = robot.0.wait()?;
    ensure!(status.success(), "after an interrupt the robot ended with {status}");
    Ok((first, memory.context("/proc does not list the memory of the robot")?))
}

fn expect(lines: &mut Lines<BufReader<ChildStdout>>, wanted: &str) -> anyhow::Result<()> {
    let line =
        lines.next().context("the subscriber has ended: it saw too few joint states in a minute")??;
    ensure!(line == wanted, "the subscriber printed {line:?} in place of {wanted:?}");
    Ok(())
}

/// A process that is killed when this is dropped.
struct Killed(Child);

impl Killed {
    fn start(command: &mut Command) -> anyhow::Result<Self> {
        let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).spawn();
        Ok(Self(child.with_context(|| format!("cannot run {command:?}"))?))
    }
}

impl Drop for Killed {
    fn drop(&mut self) {
        // Fails if the process has ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

struct File {
    path: PathBuf,
    size: u64,
}

fn size(files: &[File]) -> u64 {
    files.iter().map(|file| file.size).sum()
}

/// All files below a folder.
fn files(folder: &Path) -> anyhow::Result<Vec<File>> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).with_context(|| folder.display().to_string())? {
        let entry = entry?;
        let metadata = entry.metadata()?;
        match metadata.is_dir() {
            true => found.extend(files(&entry.path())?),
            false => found.push(File { path: entry.path(), size: metadata.len() }),
        }
    }
    Ok(found)
}
