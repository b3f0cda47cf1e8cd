//! The Python environment of the tests: real ROS 2 Jazzy and other bag readers, from PyPI.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};

use crate::steps::{run, workspace};

/// The only Python version for which there are wheels of ROS 2 Jazzy.
const VERSION: &str = "3.11";

const REQUIREMENTS: &str = "xtask/requirements.txt";

/// Creates the environment if it is missing or its requirements have changed and returns the path of its
/// interpreter.
pub(crate) fn interpreter() -> anyhow::Result<PathBuf> {
    let venv = workspace().join("target/venv");
    let interpreter = venv.join("bin/python");
    let requirements = std::fs::read_to_string(workspace().join(REQUIREMENTS)).context(REQUIREMENTS)?;
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
    let requirements_file = workspace().join(REQUIREMENTS);
    pip(&["--requirement", &requirements_file.to_string_lossy()])?;
    std::fs::write(&installed, requirements).with_context(|| installed.display().to_string())?;
    Ok(interpreter)
}

fn find() -> anyhow::Result<&'static str> {
    let candidates = ["python3.11", "python3", "python"];
    let Some(found) = candidates.into_iter().find(|candidate| is_right_version(Path::new(candidate))) else {
        bail!(
            "Python {VERSION} is needed for the tests against real ROS 2 (its wheels on PyPI are for {VERSION} \
             only), and none of {} is it; install it, or run `cargo test`, which skips them and says so",
            candidates.join(", ")
        );
    };
    Ok(found)
}

fn is_right_version(python: &Path) -> bool {
    let program = "import sys; print('%d.%d' % sys.version_info[:2])";
    let output = Command::new(python).args(["-c", program]).output();
    output.is_ok_and(|output| output.status.success() && output.stdout.trim_ascii() == VERSION.as_bytes())
}
