//! The Python package: built as a wheel, installed into an environment of its own, tested by pytest, which
//! calls mypy.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use crate::steps::{run, run_in, workspace};
use crate::{python, skips};

/// What the tests need beside the wheel and what it depends on.
const TOOLS: [&str; 3] = ["pytest==9.2.0", "mypy==2.4.1", "mcap-ros2-support==0.6.0"];
const TABLES: [&str; 2] = ["pandas==3.1.1", "pyarrow==26.0.1"];
const MATURIN: &str = "maturin==1.16.0";
/// The package needs it, and so does writing the stubs.
const NUMPY: &str = "numpy>=1.24";

/// Builds the wheel for release and returns its path. Without features cargo compiles it with what `cargo
/// run` in the checkout has compiled already; it shows its progress.
pub(crate) fn build(features: &[String]) -> anyhow::Result<PathBuf> {
    downbeat_start::lock(&workspace().join("start")).map_err(anyhow::Error::msg)?;
    let features = features.join(",");
    let options: &[&str] = if features.is_empty() { &[] } else { &["--features", &features] };
    pack("release", options)
}

/// Builds the wheel with a profile of cargo.
fn pack(profile: &str, options: &[&str]) -> anyhow::Result<PathBuf> {
    let python = python::tools(&[MATURIN, NUMPY])?;
    let first = maturin(&python, profile, options)?;
    // The stubs of messages are written by what was just built, and are part of the wheel: it is packed
    // again, not compiled again.
    let unpacked = workspace().join("target/wheels/unpacked");
    remove(&unpacked)?;
    run(Command::new(&python).args(["-m", "zipfile", "--extract"]).args([&first, &unpacked]))?;
    let sources = workspace().join("python/python/downbeat/msgs");
    let arguments = ["-m", "downbeat.stubs", "--into"];
    run(Command::new(&python).args(arguments).arg(&sources).env("PYTHONPATH", &unpacked))?;
    maturin(&python, profile, &[options, &["--quiet"]].concat())
}

fn maturin(python: &Path, profile: &str, options: &[&str]) -> anyhow::Result<PathBuf> {
    let wheels = workspace().join("target/wheels").join(profile);
    remove(&wheels)?;
    let mut command = Command::new(python);
    command.args(["-m", "maturin", "build", "--profile", profile]).args(options).arg("--out").arg(&wheels);
    if std::env::var_os("CARGO_TARGET_DIR").is_none() {
        command.env("CARGO_TARGET_DIR", workspace().join("target"));
    }
    run_in(&workspace().join("python"), &mut command)?;
    let mut built = std::fs::read_dir(&wheels).with_context(|| wheels.display().to_string())?;
    Ok(built.next().context("maturin built no wheel")??.path())
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
    let wheel = pack("dev", &["--manifest-path", "Cargo.toml", "--features", "as_tested"])?;
    let environment = workspace().join("target/wheel-venv");
    run(Command::new(&peers).args(["-m", "venv", "--clear"]).arg(&environment))?;
    let python = environment.join("bin/python");
    let pip = |arguments: &[&str]| {
        run(Command::new(&python).args(["-m", "pip", "install", "--quiet"]).args(arguments))
    };
    pip(&[&wheel.to_string_lossy()])?;
    // With nothing but the wheel and its dependencies.
    run(Command::new(environment.join("bin/downbeat")).args(["check", "--kinds"]))?;
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
