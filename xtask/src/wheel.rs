//! The Python package: built as a wheel, installed into an environment of its own, tested by pytest, which
//! calls mypy.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;
use tempfile::TempDir;

use crate::install::{Arrival, Home};
use crate::steps::{run, run_in, workspace};
use crate::{crates, notices, python, skips};

/// What the tests need beside the wheel and what it depends on.
const TOOLS: [&str; 3] = ["pytest==9.2.0", "mypy==2.4.1", "mcap-ros2-support==0.6.0"];
const TABLES: [&str; 2] = ["pandas==3.1.1", "pyarrow==26.0.1"];
const MATURIN: &str = "maturin==1.16.0";
/// The package needs it, and so does writing the stubs.
const NUMPY: &str = "numpy>=1.24";
/// The platform of a checkout's wheel.
const HERE: &str =
    if cfg!(target_arch = "aarch64") { "aarch64-unknown-linux-gnu" } else { "x86_64-unknown-linux-gnu" };

/// How a wheel is compiled.
pub(crate) struct Build<'a> {
    /// The profile of cargo.
    pub(crate) profile: &'a str,
    pub(crate) features: &'a str,
    /// A triple.
    pub(crate) target: &'a str,
    /// Further options of maturin.
    pub(crate) options: &'a [&'a str],
    /// The folder of `pyproject.toml` and the sources in Python, into which stubs and licences are written.
    pub(crate) project: PathBuf,
    /// A wheel of the same sources for this machine, if this one is for another: what writes the stubs of
    /// messages is compiled.
    pub(crate) stubs: Option<PathBuf>,
    /// The folder of the wheel, which has no other files.
    pub(crate) out: PathBuf,
    /// Sets the environment of the compilers.
    pub(crate) environment: &'a dyn Fn(&mut Command) -> anyhow::Result<()>,
}

/// Builds the wheel for release and returns its path. Without features cargo compiles it with what `cargo
/// run` in the checkout has compiled already; it shows its progress.
pub(crate) fn build(features: &[String]) -> anyhow::Result<PathBuf> {
    downbeat_start::lock(&workspace().join("start")).map_err(anyhow::Error::msg)?;
    let features = features.join(",");
    let project = sharing_project()?;
    let of_checkout = Build::of_checkout("release");
    pack(&Build { features: &features, project: project.path().to_owned(), ..of_checkout })
}

/// A copy of the project whose manifest is the one that shares what the program has compiled: a
/// `pyproject.toml` has to be above the manifest that an option of maturin names, or names it itself. It is
/// not below `target`, whose files maturin leaves out as git does.
fn sharing_project() -> anyhow::Result<TempDir> {
    let (sources, folder) = (workspace().join("python"), tempfile::tempdir()?);
    let parts = ["LICENSE", "NOTICE", "README.md", "pyproject.toml", "python"].map(|part| sources.join(part));
    run(Command::new("cp").arg("--recursive").args(parts).arg(folder.path()))?;
    let project = folder.path().join("pyproject.toml");
    let text = std::fs::read_to_string(&project).with_context(|| project.display().to_string())?;
    let own = workspace().join("start/program/wheel/Cargo.toml");
    let shared = text.replacen("manifest-path = \"Cargo.toml\"", &format!("manifest-path = {own:?}"), 1);
    anyhow::ensure!(shared != text, "python/pyproject.toml has no manifest-path");
    std::fs::write(&project, shared).with_context(|| project.display().to_string())?;
    Ok(folder)
}

impl Build<'_> {
    fn of_checkout(profile: &str) -> Build<'_> {
        let environment = &|command: &mut Command| {
            if std::env::var_os("CARGO_TARGET_DIR").is_none() {
                command.env("CARGO_TARGET_DIR", workspace().join("target"));
            }
            Ok(())
        };
        let (out, project) = (workspace().join("target/wheels").join(profile), workspace().join("python"));
        Build { profile, features: "", target: HERE, options: &[], project, stubs: None, out, environment }
    }

    fn maturin(&self, python: &Path, further: &[&str]) -> anyhow::Result<PathBuf> {
        remove(&self.out)?;
        let mut command = Command::new(python);
        command.args(["-m", "maturin", "build", "--profile", self.profile, "--features", self.features]);
        command.args(self.options).args(further).arg("--out").arg(&self.out);
        (self.environment)(&mut command)?;
        run_in(&self.project, &mut command)?;
        let mut built = std::fs::read_dir(&self.out).with_context(|| self.out.display().to_string())?;
        let wheel = built.next().context("maturin built no wheel")??.path();
        // Of a manifest without its `pyproject.toml`, maturin makes a wheel with the extension module alone.
        let name = wheel.file_name().unwrap_or_default().to_string_lossy();
        anyhow::ensure!(
            name.starts_with("downbeat_robotics-"),
            "maturin built {name}, not downbeat_robotics"
        );
        Ok(wheel)
    }
}

/// Builds a wheel and returns its path.
pub(crate) fn pack(build: &Build) -> anyhow::Result<PathBuf> {
    let python = tools()?;
    write_notices(build)?;
    if let Some(wheel) = &build.stubs {
        write_stubs(&python, wheel, &build.project)?;
        return build.maturin(&python, &[]);
    }
    let first = build.maturin(&python, &[])?;
    // The stubs are written by what was just built, and are part of the wheel: it is packed again, not
    // compiled again.
    write_stubs(&python, &first, &build.project)?;
    build.maturin(&python, &["--quiet"])
}

/// The interpreter that builds wheels.
pub(crate) fn tools() -> anyhow::Result<PathBuf> {
    python::tools("target/wheel-tools", &[MATURIN, NUMPY])
}

/// Writes the stubs of the messages that a wheel for this machine contains into the sources of the package.
fn write_stubs(python: &Path, wheel: &Path, project: &Path) -> anyhow::Result<()> {
    let unpacked = workspace().join("target/wheels/unpacked");
    remove(&unpacked)?;
    run(Command::new(python).args(["-m", "zipfile", "--extract"]).args([wheel, &unpacked]))?;
    let sources = project.join("python/downbeat/msgs");
    let arguments = ["-m", "downbeat.stubs", "--into"];
    run(Command::new(python).args(arguments).arg(&sources).env("PYTHONPATH", &unpacked))
}

/// Writes the licences of the crates that a wheel contains into the sources of the package.
fn write_notices(build: &Build) -> anyhow::Result<()> {
    let crates = crates::of("downbeat-python", build.features, build.target)?;
    let file = build.project.join("THIRD-PARTY.txt");
    std::fs::write(&file, notices::of(&crates)?).with_context(|| file.display().to_string())
}

fn remove(folder: &Path) -> anyhow::Result<()> {
    match folder.exists() {
        true => std::fs::remove_dir_all(folder).with_context(|| folder.display().to_string()),
        false => Ok(()),
    }
}

/// Builds the wheel, and tests it in a fresh environment.
pub(crate) fn test(skips: &skips::Run) -> anyhow::Result<()> {
    let peers = python::interpreter()?;
    // With what the tests of the workspace have compiled.
    let wheel = pack(&Build { features: "as_tested", ..Build::of_checkout("dev") })?;
    let environment = workspace().join("target/wheel-venv");
    run(Command::new(&peers).args(["-m", "venv", "--clear"]).arg(&environment))?;
    let python = environment.join("bin/python");
    let pip = |arguments: &[&str]| {
        run(Command::new(&python).args(["-m", "pip", "install", "--quiet"]).args(arguments))
    };
    pip(&[&wheel.to_string_lossy()])?;
    // With nothing but the wheel and its dependencies.
    let program = environment.join("bin/downbeat");
    run(Command::new(&program).args(["check", "--kinds"]))?;
    run(Command::new(&program).args(["robots", "list"]))?;
    let arrival = Arrival::of(Home::new()?.command(&program))?;
    println!("first joint state after {} ms (development build)", arrival.first_joint_state.as_millis());
    pip(&TOOLS)?;
    pip(&TABLES)?;
    let tests = workspace().join("python/tests");
    let pytest = || {
        let mut pytest = Command::new(&python);
        pytest.args(["-m", "pytest", "--quiet", "-p", "no:cacheprovider"]).envs([skips.variable()]);
        pytest
    };
    // What readers type, where nothing of ROS is found.
    const OF_READERS: [&str; 2] = ["test_pages.py", "test_templates.py"];
    run(pytest().args(OF_READERS.map(|file| tests.join(file))))?;
    share(&peers, &environment)?;
    let mut pytest = pytest();
    pytest.arg(&tests).args(OF_READERS.map(|file| format!("--ignore={}", tests.join(file).display())));
    // What the wheels of ROS set when their own environment starts.
    let libraries = output_of(&peers, "import ros_wheels_bootstrapper as ros; print(ros.get_ros_paths())")?;
    pytest.env("LD_LIBRARY_PATH", libraries).env("_ROS_WHEELS_BOOTSTRAP_COMPLETE", "1");
    run(pytest.env("DOWNBEAT_PYTHON", &peers).env("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST"))
}

/// Lets the environment find the packages of the peers, such as rclpy, behind its own.
fn share(peers: &Path, environment: &Path) -> anyhow::Result<()> {
    let packages = "import sysconfig; print(sysconfig.get_path('purelib'))";
    let own = output_of(&environment.join("bin/python"), packages)?;
    let path = Path::new(&own).join("peers.pth");
    let line = format!("import site; site.addsitedir({:?})\n", output_of(peers, packages)?);
    std::fs::write(&path, line).with_context(|| path.display().to_string())
}

/// Runs a line of Python and returns what it prints.
fn output_of(python: &Path, program: &str) -> anyhow::Result<String> {
    let output = Command::new(python).args(["-c", program]).output();
    let output = output.with_context(|| python.display().to_string())?;
    anyhow::ensure!(output.status.success(), "{program}: {}", String::from_utf8_lossy(&output.stderr));
    Ok(String::from_utf8(output.stdout)?.trim().to_owned())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn the_addresses_of_the_wheel_are_those_of_the_repository() {
        let project = std::fs::read_to_string(workspace().join("python/pyproject.toml")).unwrap();
        let urls = project.split("[project.urls]\n").nth(1).unwrap();
        let urls: Vec<&str> = urls.lines().take_while(|line| !line.is_empty()).collect();
        let repository = crates::repository().unwrap();
        assert!(urls.len() >= 4, "{urls:?}");
        for url in urls {
            assert!(url.contains(&format!("= \"{repository}")), "{url}: not of {repository}");
        }
    }
}
