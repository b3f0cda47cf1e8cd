//! The Python environments of the tests: real ROS 2 Jazzy and Kilted, and other bag readers, from PyPI.

use std::path::PathBuf;
use std::process::Command;

use anyhow::{Context, bail};

use crate::steps::{run, workspace};

/// The only Python version for which there are wheels of ROS 2 Jazzy and Kilted.
const VERSION: &str = "3.11";

/// The same, which is also the oldest that the wheel supports.
const OLDEST: (u32, u32) = (3, 11);

/// Creates the environment of ROS 2 Jazzy if it is missing or its requirements have changed and returns the
/// path of its interpreter.
pub(crate) fn interpreter() -> anyhow::Result<PathBuf> {
    environment("target/venv", "xtask/requirements.txt")
}

/// The same for ROS 2 Kilted, whose packages cannot share an environment with those of Jazzy.
pub(crate) fn kilted_interpreter() -> anyhow::Result<PathBuf> {
    environment("target/venv_kilted", "xtask/requirements_kilted.txt")
}

/// Creates an environment of tools, in a folder of the workspace, if it is missing, and returns the path of
/// its interpreter. It needs none of ROS 2, and any Python that the wheel supports. `packages` are lines of a
/// requirements file.
pub(crate) fn tools(folder: &str, packages: &[&str]) -> anyhow::Result<PathBuf> {
    let venv = workspace().join(folder);
    let interpreter = venv.join("bin/python");
    let installed = venv.join("installed-requirements.txt");
    let wanted = packages.join("\n");
    if std::fs::read_to_string(&installed).is_ok_and(|text| text == wanted) {
        return Ok(interpreter);
    }
    let candidates = ["python3", "python3.13", "python3.12", "python3.11", "python"];
    let Some(python) = candidates.into_iter().find(|candidate| version_of(candidate) >= Some(OLDEST)) else {
        bail!("{} needs Python 3.11 or later, and none of {} is one", venv.display(), candidates.join(", "));
    };
    let names: Vec<&str> = packages.iter().filter_map(|package| package.split(' ').next()).collect();
    eprintln!("xtask: installing {} into {}", names.join(" and "), venv.display());
    run(Command::new(python).args(["-m", "venv", "--clear"]).arg(&venv))?;
    // Only a file may have hashes.
    let requirements = venv.join("requirements.txt");
    std::fs::write(&requirements, &wanted).with_context(|| requirements.display().to_string())?;
    let pip = ["-m", "pip", "install", "--quiet", "--requirement"];
    run(Command::new(&interpreter).args(pip).arg(&requirements))?;
    std::fs::write(&installed, wanted).with_context(|| installed.display().to_string())?;
    Ok(interpreter)
}

fn environment(venv: &str, requirements_path: &str) -> anyhow::Result<PathBuf> {
    let venv = workspace().join(venv);
    let interpreter = venv.join("bin/python");
    let requirements = std::fs::read_to_string(workspace().join(requirements_path))
        .with_context(|| requirements_path.to_owned())?;
    // Written last, so that an interrupted installation is repeated.
    let installed = venv.join("installed-requirements.txt");
    if std::fs::read_to_string(&installed).is_ok_and(|text| text == requirements) {
        return Ok(interpreter);
    }
    let python = find()?;
    eprintln!("xtask: installing the Python packages of the tests into {}", venv.display());
    run(Command::new(python).args(["-m", "venv", "--clear"]).arg(&venv))?;
    let pip = |arguments: &[&str]| {
        run(Command::new(&interpreter).args(["-m", "pip", "install", "--quiet"]).args(arguments))
    };
    pip(&["--upgrade", "pip"])?;
    let requirements_file = workspace().join(requirements_path);
    pip(&["--requirement", &requirements_file.to_string_lossy()])?;
    std::fs::write(&installed, requirements).with_context(|| installed.display().to_string())?;
    Ok(interpreter)
}

/// The Python of which the environments of the peers are made.
pub(crate) fn find() -> anyhow::Result<&'static str> {
    let candidates = ["python3.11", "python3", "python"];
    let Some(found) = candidates.into_iter().find(|candidate| is_right_version(candidate)) else {
        bail!(
            "Python {VERSION} is needed for the tests against real ROS 2 (its wheels on PyPI are for {VERSION} \
             only), and none of {} is it; install it, or run `cargo test`, which skips them and says so",
            candidates.join(", ")
        );
    };
    Ok(found)
}

fn is_right_version(python: &str) -> bool {
    version_of(python) == Some(OLDEST)
}

/// Major and minor version.
fn version_of(python: &str) -> Option<(u32, u32)> {
    let output = Command::new(python)
        .args(["-c", "import sys; print('%d.%d' % sys.version_info[:2])"])
        .output()
        .ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    let (major, minor) = text.trim().split_once('.')?;
    Some((major.parse().ok()?, minor.parse().ok()?))
}
