//! The wheel and the source distribution of a release.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, ensure};

use super::cross::Target;
use super::glibc;
use super::program::without_paths;
use super::release::{FEATURES, Release, fresh};
use crate::python;
use crate::steps::{run, run_in, workspace};
use crate::wheel::{Build, pack, tools};

/// What checks wheels and their sources: that wheels run on the systems that their name promises, and that
/// PyPI takes the files.
const CHECKS: [&str; 3] = ["abi3audit==0.0.26", "auditwheel==6.8.2", "twine==7.0.0"];

/// The largest that a wheel may be, in bytes: robots are on slow lines.
const LARGEST: u64 = 45_000_000;

/// Builds the wheel of a release, checks it, and returns its path.
pub(super) fn build(release: &Release) -> anyhow::Result<PathBuf> {
    let triple = release.target.triple();
    let environment = |command: &mut Command| release.compiling(command).map(drop);
    let stubs = with_stubs(release)?;
    let wheel = pack(&Build {
        profile: "release",
        features: FEATURES,
        target: triple,
        options: &["--locked", "--target", triple, "--compatibility", "manylinux_2_28"],
        project: workspace().join("python"),
        stubs,
        out: release.scratch.join("wheel"),
        environment: &environment,
    })?;
    check(&wheel, release)?;
    let file = release.out.join(wheel.file_name().context("a wheel without name")?);
    std::fs::copy(&wheel, &file).with_context(|| format!("cannot write {}", file.display()))?;
    Ok(file)
}

/// The wheel whose stubs one for another platform gets, since nothing of that one runs here.
pub(super) fn with_stubs(release: &Release) -> anyhow::Result<Option<PathBuf>> {
    if release.target == Target::X86_64 {
        return Ok(None);
    }
    let name = format!("downbeat_robotics-{}-cp311-abi3-manylinux_2_28_x86_64.whl", release.version);
    let wheel = release.out.join(name);
    ensure!(wheel.exists(), "{} is missing: build for x86_64-unknown-linux-gnu first", wheel.display());
    Ok(Some(wheel))
}

fn check(wheel: &Path, release: &Release) -> anyhow::Result<()> {
    let size = wheel.metadata()?.len();
    ensure!(size <= LARGEST, "{} has {size} bytes, more than {LARGEST}", wheel.display());
    let unpacked = release.scratch.join("unpacked");
    fresh(&unpacked)?;
    let python = python::tools("target/wheel-checks", &CHECKS)?;
    run(Command::new(&python).args(["-m", "zipfile", "--extract"]).args([wheel, &unpacked]))?;
    without_paths(&unpacked)?;
    glibc::check(&unpacked.join("downbeat/_core.abi3.so"))?;
    for tool in
        [["auditwheel", "show"].as_slice(), &["abi3audit", "--strict"], &["twine", "check", "--strict"]]
    {
        run(Command::new(&python).arg("-m").args(tool).arg(wheel))?;
    }
    Ok(())
}

/// Packs the sources of the wheel, with those of all crates of ours, and returns the path.
pub(super) fn sources(release: &Release) -> anyhow::Result<PathBuf> {
    let folder = release.scratch.join("sdist");
    fresh(&folder)?;
    let mut maturin = Command::new(tools()?);
    maturin.args(["-m", "maturin", "sdist", "--out"]).arg(&folder);
    run_in(&workspace().join("python"), maturin.env("SOURCE_DATE_EPOCH", release.time.to_string()))?;
    let name = format!("downbeat_robotics-{}.tar.gz", release.version);
    run(Command::new("tar").arg("-xzf").arg(folder.join(&name)).arg("-C").arg(&folder))?;
    let unpacked = folder.join(format!("downbeat_robotics-{}", release.version));
    // Cargo reads all manifests in it, as whoever builds from it does. Its lock file loses what only benches
    // use, which are not in it: with that, nobody could build with --locked.
    for lock in ["--offline", "--locked"] {
        let mut cargo = Command::new("cargo");
        cargo.args(["metadata", "--format-version", "1", lock]).stdout(Stdio::null());
        run_in(&unpacked, &mut cargo)?;
    }
    let file = release.out.join(&name);
    release.pack(&unpacked, &file)?;
    let python = python::tools("target/wheel-checks", &CHECKS)?;
    run(Command::new(&python).args(["-m", "twine", "check", "--strict"]).arg(&file))?;
    Ok(file)
}
