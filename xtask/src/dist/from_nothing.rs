//! `cargo xtask dist --test`: each way of installing, in a clean environment, up to the joint states of the
//! demo robot at a subscriber of ROS 2, and back; after `pip install` also up to the robot in a browser.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, ensure};

use super::cross::Target;
use super::release::Release;
use crate::crates::cargo_home;
use crate::files;
use crate::install::{
    Arrival, Figures, Home, cargo_install_for_release, deb, first_look, ros_workspace_for_release,
};
use crate::wheel;

/// How long it may take, from `pip install` on, until a subscriber has a joint state, and until the robot
/// moves in a browser. Other figures depend on the machine.
const PATIENCE_OF_NEWCOMERS: Duration = Duration::from_secs(60);

/// How the program comes onto a machine.
#[derive(Clone, Copy)]
enum Way {
    Cargo,
    Pip,
    /// By pip, from the source distribution.
    Sources,
    Deb,
    Tarball,
}

pub(super) fn test(release: &Release) -> anyhow::Result<()> {
    ensure!(
        release.target == Target::X86_64,
        "a release for {} runs on another machine only",
        release.target
    );
    Figures::print_header();
    for way in [Way::Pip, Way::Deb, Way::Tarball, Way::Sources, Way::Cargo] {
        way.costs(release).with_context(|| way.name())?.print(way.name());
    }
    ros_workspace_for_release().context("colcon")?.print("colcon");
    println!("removed again: nothing is left but the files of the robot in ~/.cache/downbeat");
    Ok(())
}

impl Way {
    fn name(self) -> &'static str {
        match self {
            Self::Cargo => "cargo",
            Self::Pip => "pip",
            Self::Sources => "sdist",
            Self::Deb => "deb",
            Self::Tarball => "tarball",
        }
    }

    fn costs(self, release: &Release) -> anyhow::Result<Figures> {
        let home = Home::new()?;
        self.prepare(&home)?;
        let before = files::below(home.path())?;
        let started = Instant::now();
        self.install(release, &home)?;
        let install = started.elapsed();
        let size = self.size(&home)? - files::size(&before);
        let arrival = Arrival::of(self.program(release, &home)?)?;
        if let Self::Pip = self {
            in_time("a joint state", install + arrival.first_joint_state)?;
            let seen = install + first_look(self.program(release, &home)?)?;
            println!("from `pip install` to a robot that moves in a browser: {:.1} s", seen.as_secs_f64());
            in_time("a robot that moves in a browser", seen)?;
        }
        self.remove(release, &home)?;
        let before: BTreeSet<_> = before.into_iter().map(|file| file.path).collect();
        let left = files::below(home.path())?.into_iter().map(|file| file.path);
        let left: Vec<_> = left.filter(|path| !before.contains(path) && !self.keeps(path)).collect();
        ensure!(left.is_empty(), "these are left after removal: {left:?}");
        Ok(Figures { install, size, arrival })
    }

    /// What it needs on the disk, with what was there before, in bytes.
    fn size(self, home: &Home) -> anyhow::Result<u64> {
        // Not what cargo downloaded and compiled on the way.
        let folder =
            if let Self::Cargo = self { home.path().join("installed") } else { home.path().to_owned() };
        Ok(files::size(&files::below(&folder)?))
    }

    /// True for a file that may be left, for it is not of downbeat alone.
    fn keeps(self, path: &Path) -> bool {
        let is_cache_of_robots = path.starts_with(".cache/downbeat");
        let is_of_others = match self {
            Self::Cargo => {
                // What cargo downloaded and compiled, and its lists of installed programs, which are empty.
                let of_cargo = ["cargo", "build", "registry", "packages.sha256"];
                of_cargo.iter().any(|known| path.starts_with(known))
                    || path.file_name().is_some_and(|name| name.to_string_lossy().starts_with(".crates"))
            }
            // What Python compiled of pip when it ran.
            Self::Pip | Self::Sources => path.extension().is_some_and(|extension| extension == "pyc"),
            Self::Deb => path.strip_prefix("root").is_ok_and(deb::is_left),
            Self::Tarball => false,
        };
        is_cache_of_robots || is_of_others
    }

    /// Makes what a user has before.
    fn prepare(self, home: &Home) -> anyhow::Result<()> {
        match self {
            Self::Pip | Self::Sources => user(home.command(wheel::tools()?).args(["-m", "venv", "venv"])),
            Self::Deb => deb::prepare(&home.path().join("root")),
            Self::Cargo | Self::Tarball => Ok(()),
        }
    }

    fn install(self, release: &Release, home: &Home) -> anyhow::Result<()> {
        match self {
            Self::Cargo => cargo_install_for_release(home.path()).map(drop),
            Self::Pip | Self::Sources => {
                let package = format!("downbeat-robotics=={}", release.version);
                let mut pip = home.command(home.path().join("venv/bin/python"));
                pip.args(["-m", "pip", "--quiet", "install", "--no-cache-dir"]);
                if let Self::Sources = self {
                    // Maturin comes from PyPI. All crates are those that the release was compiled from.
                    pip.arg("--no-binary=downbeat-robotics");
                    pip.env("CARGO_HOME", cargo_home()?).env("CARGO_NET_OFFLINE", "true");
                    // The pip that fetches maturin looks for a later pip, and would keep what it found.
                    pip.env("PIP_DISABLE_PIP_VERSION_CHECK", "1");
                } else {
                    pip.arg("--only-binary=:all:");
                }
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

    fn program(self, release: &Release, home: &Home) -> anyhow::Result<Command> {
        let path = match self {
            Self::Cargo => home.path().join("installed/bin/downbeat"),
            Self::Pip | Self::Sources => home.path().join("venv/bin/downbeat"),
            Self::Deb => return deb::installed(&home.path().join("root"), home),
            Self::Tarball => home.path().join(release.name()).join("bin/downbeat"),
        };
        Ok(home.command(path))
    }

    fn remove(self, release: &Release, home: &Home) -> anyhow::Result<()> {
        match self {
            Self::Cargo => {
                let mut cargo = home.command("cargo");
                user(cargo.args(["uninstall", "--quiet", "downbeat", "--root", "installed"]))
            }
            Self::Pip | Self::Sources => {
                let pip = ["-m", "pip", "--quiet", "uninstall", "--yes", "downbeat-robotics", "numpy"];
                user(home.command(home.path().join("venv/bin/python")).args(pip))
            }
            Self::Deb => user(deb::dpkg(&home.path().join("root")).args(["--purge", "downbeat"])),
            Self::Tarball => user(home.command("rm").arg("-r").arg(release.name())),
        }
    }
}

fn in_time(what: &str, since_install: Duration) -> anyhow::Result<()> {
    ensure!(
        since_install <= PATIENCE_OF_NEWCOMERS,
        "from the start of `pip install` to {what} it took {:.1} s, more than {} s",
        since_install.as_secs_f64(),
        PATIENCE_OF_NEWCOMERS.as_secs()
    );
    Ok(())
}

/// Runs a command where it says, and fails if it does.
fn user(command: &mut Command) -> anyhow::Result<()> {
    let status = command.status().with_context(|| format!("cannot run {command:?}"))?;
    ensure!(status.success(), "{command:?} failed: {status}");
    Ok(())
}
