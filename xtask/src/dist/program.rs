//! The program of a release, and the files that go with it.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use super::release::{FEATURES, Release, cargo_home, fresh};
use crate::crates::{self, Crates};
use crate::notices;
use crate::steps::{output_of, run, workspace};

/// A folder `downbeat-VERSION-TARGET` as it is in the tarball.
pub(crate) struct Program {
    /// It has `bin/downbeat`, `share/man/man1/`, `share/completions/` (`downbeat.bash`, `_downbeat` and
    /// `downbeat.fish`) and `share/doc/downbeat/` (LICENSE, NOTICE, THIRD-PARTY.txt and pages).
    pub(crate) folder: PathBuf,
    /// What is compiled into it.
    pub(super) crates: Crates,
}

pub(super) fn build(release: &Release) -> anyhow::Result<Program> {
    let crates = crates::of("downbeat", FEATURES, release.target.triple())?;
    let mut cargo = Command::new("cargo");
    cargo.args(["build", "--release", "--locked", "--package", "downbeat", "--bin", "downbeat"]);
    cargo.args(["--target", release.target.triple(), "--features", FEATURES]);
    run(release.compiling(&mut cargo)?)?;
    let built = workspace().join("target").join(release.target.triple()).join("release/downbeat");
    without_paths(&built)?;

    let folder = release.scratch.join(release.name());
    fresh(&folder)?;
    let program = folder.join("bin/downbeat");
    copy(&built, &program)?;
    let man = folder.join("share/man/man1");
    run(release.target.runs(&program).arg("man").arg(&man))?;
    for (shell, file) in [("bash", "downbeat.bash"), ("zsh", "_downbeat"), ("fish", "downbeat.fish")] {
        let script = output_of(release.target.runs(&program).args(["completions", shell]))?;
        write(&folder.join("share/completions").join(file), &script)?;
    }
    let documents = folder.join("share/doc/downbeat");
    write(&documents.join("THIRD-PARTY.txt"), &notices::of(&crates)?)?;
    for (from, to) in [
        ("LICENSE", "LICENSE"),
        ("msgs/NOTICE", "NOTICE"),
        ("docs/install.md", "README.md"),
        ("CHANGELOG.md", "CHANGELOG.md"),
    ] {
        copy(&workspace().join(from), &documents.join(to))?;
    }
    Ok(Program { folder, crates })
}

impl Program {
    /// Packs the folder as a tarball and returns its path: sorted, without owners, all with one time.
    pub(super) fn tarball(&self, release: &Release) -> anyhow::Result<PathBuf> {
        let file = release.out.join(format!("{}.tar.gz", release.name()));
        let mut tar = Command::new("tar");
        tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--format=ustar"]);
        tar.args(["--mode=u=rwX,go=rX", "--use-compress-program=gzip -9 --no-name"]);
        tar.arg(format!("--mtime=@{}", release.time)).arg("--create").arg("--file").arg(&file);
        run(tar.arg("--directory").arg(self.folder.parent().unwrap_or(&self.folder)).arg(release.name()))?;
        Ok(file)
    }
}

/// Checks that a program or library tells nothing about the machine that built it.
pub(super) fn without_paths(file: &Path) -> anyhow::Result<()> {
    let bytes = std::fs::read(file).with_context(|| file.display().to_string())?;
    for place in [workspace(), cargo_home()?] {
        let path = place.to_string_lossy();
        let found = bytes.windows(path.len()).position(|window| window == path.as_bytes());
        if let Some(start) = found {
            let end = bytes.len().min(start + 200);
            let text = String::from_utf8_lossy(&bytes[start..end]);
            anyhow::bail!("{} contains a path of this machine: {text:?}", file.display());
        }
    }
    Ok(())
}

fn copy(from: &Path, to: &Path) -> anyhow::Result<()> {
    let bytes = || {
        std::fs::create_dir_all(to.parent().unwrap_or(to))?;
        std::fs::copy(from, to)
    };
    bytes().map(drop).with_context(|| format!("cannot copy {} to {}", from.display(), to.display()))
}

fn write(file: &Path, text: &str) -> anyhow::Result<()> {
    let write = || {
        std::fs::create_dir_all(file.parent().unwrap_or(file))?;
        std::fs::write(file, text)
    };
    write().with_context(|| format!("cannot write {}", file.display()))
}
