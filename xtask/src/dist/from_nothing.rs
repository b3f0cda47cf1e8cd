//! `cargo xtask dist --test`: each way of installing, in a clean environment, up to the joint states of the
//! demo robot at a subscriber of ROS 2, and back.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

use super::cross::Target;
use super::release::Release;
use crate::install::{Arrival, Home, deb};
use crate::wheel;

/// How the program comes onto a machine.
#[derive(Clone, Copy)]
enum Way {
    Pip,
    Deb,
    Tarball,
}

/// What a way costs.
struct Figures {
    install: Duration,
    /// On the disk, in bytes.
    size: u64,
    arrival: Arrival,
}

pub(super) fn test(release: &Release) -> anyhow::Result<()> {
    ensure!(
        release.target == Target::X86_64,
        "a release for {} runs on another machine only",
        release.target
    );
    println!("{:<8}{:>12}{:>12}{:>20}{:>12}", "way", "install", "size", "first joint state", "memory");
    for way in [Way::Pip, Way::Deb, Way::Tarball] {
        let Figures { install, size, arrival } = way.costs(release).with_context(|| way.name())?;
        println!(
            "{:<8}{:>10.1} s{:>9.1} MB{:>17} ms{:>9.1} MB",
            way.name(),
            install.as_secs_f64(),
            size as f64 / 1e6,
            arrival.first_joint_state.as_millis(),
            arrival.memory as f64 / 1e6,
        );
    }
    println!("removed again: nothing is left but the files of the robot in ~/.cache/downbeat");
    Ok(())
}

impl Way {
    fn name(self) -> &'static str {
        match self {
            Self::Pip => "pip",
            Self::Deb => "deb",
            Self::Tarball => "tarball",
        }
    }

    fn costs(self, release: &Release) -> anyhow::Result<Figures> {
        let home = Home::new()?;
        self.prepare(&home)?;
        let before = size(&files(home.path())?);
        let started = Instant::now();
        self.install(release, &home)?;
        let install = started.elapsed();
        let size = size(&files(home.path())?) - before;
        let arrival = Arrival::of(&self.program(release, &home), &home)?;
        self.remove(release, &home)?;
        for file in files(home.path())? {
            let path = file.path.strip_prefix(home.path())?;
            let is_ours = path.to_string_lossy().contains("downbeat");
            let is_cache = path.starts_with(".cache/downbeat");
            ensure!(is_cache || !is_ours, "{} is left after removal", path.display());
        }
        Ok(Figures { install, size, arrival })
    }

    /// Makes what a user has before.
    fn prepare(self, home: &Home) -> anyhow::Result<()> {
        match self {
            Self::Pip => user(home.command(wheel::tools()?).args(["-m", "venv", "venv"])),
            Self::Deb => deb::prepare(&home.path().join("root")),
            Self::Tarball => Ok(()),
        }
    }

    fn install(self, release: &Release, home: &Home) -> anyhow::Result<()> {
        match self {
            Self::Pip => {
                let package = format!("downbeat-robotics=={}", release.version);
                let mut pip = home.command(home.path().join("venv/bin/python"));
                pip.args(["-m", "pip", "--quiet", "install", "--no-cache-dir", "--only-binary=:all:"]);
                user(pip.arg("--find-links").arg(&release.out).arg(package))
            }
            Self::Deb => {
                let package = format!("downbeat_{}_{}.deb", release.version, release.target.of_debian());
                let package = release.out.join(package);
                user(deb::dpkg(&home.path().join("root")).arg("--install").arg(package))
            }
            Self::Tarball => {
                let tarball = release.out.join(format!("{}.tar.gz", release.name()));
                user(home.command("tar").arg("-xzf").arg(tarball))
            }
        }
    }

    fn program(self, release: &Release, home: &Home) -> PathBuf {
        match self {
            Self::Pip => home.path().join("venv/bin/downbeat"),
            Self::Deb => home.path().join("root/usr/bin/downbeat"),
            Self::Tarball => home.path().join(release.name()).join("bin/downbeat"),
        }
    }

    fn remove(self, release: &Release, home: &Home) -> anyhow::Result<()> {
        match self {
            Self::Pip => {
                let pip = ["-m", "pip", "--quiet", "uninstall", "--yes", "downbeat-robotics"];
                user(home.command(home.path().join("venv/bin/python")).args(pip))
            }
            Self::Deb => user(deb::dpkg(&home.path().join("root")).args(["--purge", "downbeat"])),
            Self::Tarball => user(home.command("rm").arg("-r").arg(release.name())),
        }
    }
}

/// Runs a command where it says, and fails if it does.
fn user(command: &mut Command) -> anyhow::Result<()> {
    let status = command.status().with_context(|| format!("cannot run {command:?}"))?;
    ensure!(status.success(), "{command:?} failed: {status}");
    Ok(())
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
