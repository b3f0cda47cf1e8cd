//! `cargo install downbeat`, and a project that depends on the version of the program.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, ensure};

use super::{Arrival, Home, registry};
use crate::steps::workspace;

/// Packages the crates, installs the program from the packages, runs the robot that it carries, and builds
/// and runs a project that it makes. Nothing of the checkout is used but the packages.
pub(crate) fn cargo_install() -> anyhow::Result<PathBuf> {
    let (cargo, program) = installed()?;
    let home = Home::new()?;
    let arrival = Arrival::of(home.command(&program))?;
    println!(
        "installed from packages: first joint state after {} ms, {} MB (development build)",
        arrival.first_joint_state.as_millis(),
        arrival.memory / 1_000_000
    );
    let user = |program: &Path, arguments: &[&str]| {
        let status = home.command(program).args(arguments).status();
        let status = status.with_context(|| program.display().to_string())?;
        ensure!(status.success(), "{} {} failed", program.display(), arguments.join(" "));
        anyhow::Ok(())
    };
    user(&program, &["new", "my_robot"])?;
    let project = home.path().join("my_robot");
    let manifest = fs::read_to_string(project.join("Cargo.toml"))?;
    ensure!(manifest.contains("downbeat = { version = \""), "the project depends on no version:\n{manifest}");
    cargo.run(home.command(env!("CARGO")).arg("build").current_dir(&project))?;
    let mut again = home.command(env!("CARGO"));
    again.args(["build", "--message-format", "json"]).current_dir(&project).stdout(Stdio::piped());
    let again = cargo.prepared(&mut again).output().context("cannot run cargo")?;
    let anew = String::from_utf8_lossy(&again.stdout)
        .lines()
        .filter(|line| line.contains("\"fresh\":false"))
        .count();
    ensure!(again.status.success() && anew == 0, "a second build compiles {anew} crates again");
    let robot = cargo.build.join("debug/my_robot");
    user(&robot, &["run", "my_robot/robot.toml", "--duration", "1s"])?;
    Ok(program)
}

/// Compiles what [`cargo_install`] installs, which takes less time from then on.
pub(crate) fn compile_packages() -> anyhow::Result<()> {
    installed().map(drop)
}

/// Packages the crates, and installs the program from the packages.
fn installed() -> anyhow::Result<(Cargo, PathBuf)> {
    let folder = workspace().join("target/install");
    let cargo = Cargo::new(&folder)?;
    let program = cargo.install(&folder.join("installed"), &["--debug"])?;
    Ok((cargo, program))
}

/// Installs the program as a user does, for release, from nothing but the packages, below a folder. Returns
/// its path.
pub(crate) fn cargo_install_for_release(folder: &Path) -> anyhow::Result<PathBuf> {
    Cargo::new(folder)?.install(&folder.join("installed"), &[])
}

/// Cargo as a machine without this checkout has it, with a registry of our packages in place of crates.io.
struct Cargo {
    home: PathBuf,
    build: PathBuf,
}

impl Cargo {
    /// All its files are below the folder. What was compiled from other packages than the present ones is
    /// removed: for cargo, packages of a registry never change.
    fn new(folder: &Path) -> anyhow::Result<Self> {
        let (home, build, registry) = (folder.join("cargo"), folder.join("build"), folder.join("registry"));
        let checksums = registry::write(&registry, &registry::package()?)?;
        let known = folder.join("packages.sha256");
        if fs::read_to_string(&known).ok().as_ref() != Some(&checksums) {
            remove_ours(&home.join("registry/src"), 1)?;
            remove_ours(&build, 2)?;
        }
        fs::create_dir_all(&home)?;
        // The same profile for the program, whose manifest has one, and for the project, so that nothing is
        // compiled twice.
        let config = format!(
            "[source.crates-io]\nreplace-with = \"packages\"\n[source.packages]\nlocal-registry = {:?}\n\
             [profile.dev]\ndebug = false\nstrip = \"symbols\"\n[profile.dev.package.\"*\"]\nopt-level = 0\n\
             [profile.dev.package.nalgebra]\nopt-level = 0\n",
            registry.display().to_string()
        );
        fs::write(home.join("config.toml"), config)?;
        fs::write(known, checksums)?;
        Ok(Self { home, build })
    }

    /// A command of cargo without the network.
    fn prepared<'a>(&self, command: &'a mut Command) -> &'a mut Command {
        command.args(["--offline", "--quiet"]);
        command
            .env("CARGO_HOME", &self.home)
            .env("CARGO_TARGET_DIR", &self.build)
            .env("CARGO_INCREMENTAL", "0")
    }

    /// Runs a command of cargo without the network.
    fn run(&self, command: &mut Command) -> anyhow::Result<()> {
        let status = self.prepared(command).status().context("cannot run cargo")?;
        ensure!(status.success(), "{command:?} failed");
        Ok(())
    }

    fn install(&self, installed: &Path, options: &[&str]) -> anyhow::Result<PathBuf> {
        let home = Home::new()?;
        let mut command = home.command(env!("CARGO"));
        command.args(["install", "downbeat", "--force"]).args(options).arg("--root").arg(installed);
        self.run(&mut command)?;
        Ok(installed.join("bin/downbeat"))
    }
}

/// Removes folders and files with the names of our packages, this deep below a folder.
fn remove_ours(folder: &Path, depth: usize) -> anyhow::Result<()> {
    let Ok(entries) = fs::read_dir(folder) else { return Ok(()) };
    for entry in entries {
        let path = entry?.path();
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        match (name.starts_with("downbeat"), path.is_dir()) {
            (true, true) => fs::remove_dir_all(&path)?,
            (true, false) => fs::remove_file(&path)?,
            (false, true) if depth > 0 => remove_ours(&path, depth - 1)?,
            (false, _) => {}
        }
    }
    Ok(())
}
