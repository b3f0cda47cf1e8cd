//! `cargo xtask dist --twice`: the same commit in another checkout gives the same bytes.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, ensure};

use super::release::{Release, fresh};
use super::wheel::with_stubs;
use crate::steps::{output_of, run, run_in, workspace};

/// Fails if there are changes, which a clone would not have.
pub(super) fn only_of_a_commit() -> anyhow::Result<()> {
    let changed = output_of(Command::new("git").args(["status", "--porcelain"]))?;
    ensure!(changed.is_empty(), "commit first, for a clone has not got these changes:\n{changed}");
    Ok(())
}

/// Builds the release once more, in a clone outside of this checkout, and compares every file with the one
/// that is here.
pub(super) fn compare(release: &Release, options: &[&str], files: &[PathBuf]) -> anyhow::Result<()> {
    let scratch = tempfile::Builder::new().prefix("built_again").tempdir()?;
    let (clone, out) = (scratch.path().join("checkout"), scratch.path().join("out"));
    run(Command::new("git").args(["clone", "--quiet"]).arg(workspace()).arg(&clone))?;
    fresh(&out)?;
    if let Some(wheel) = with_stubs(release)? {
        std::fs::copy(&wheel, out.join(wheel.file_name().context("a wheel without a name")?))?;
    }
    let mut again = Command::new(env!("CARGO"));
    again.args(["xtask", "dist", "--target", release.target.triple(), "--out"]).arg(&out).args(options);
    // All that it compiles is to be in the clone.
    run_in(&clone, again.env_remove("CARGO_TARGET_DIR"))?;
    let mut different = Vec::new();
    for file in files {
        let name = file.file_name().context("a file without a name")?;
        if read(file)? != read(&out.join(name))? {
            different.push(name.to_string_lossy().into_owned());
        }
    }
    if !different.is_empty() {
        // So that one can look into them.
        let kept = scratch.keep();
        anyhow::bail!(
            "built again, these have other bytes: {}; see {}",
            different.join(", "),
            kept.display()
        );
    }
    println!("built again in another checkout: the same bytes in {} files", files.len());
    Ok(())
}

fn read(file: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(file).with_context(|| file.display().to_string())
}
