//! The program of a release, and the files that go with it.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use super::release::{FEATURES, Release, fresh};
use crate::crates::{self, Crates, cargo_home};
use crate::packaging::debian::{self, About};
use crate::packaging::{arrange, write};
use crate::paths::normal;
use crate::steps::{run, workspace};
use crate::{markdown, notices};

/// A folder `downbeat-VERSION-TARGET` as it is in the tarball.
pub(crate) struct Program {
    /// It has what [`arrange`] puts there, and the licences of the crates.
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
    arrange(&built, &|program| release.target.runs(program), &notices::of(&crates)?, &folder)?;
    write(&folder.join("share/doc/downbeat/README.md"), how_to_install()?.as_bytes())?;
    Ok(Program { folder, crates })
}

/// docs/install.md for readers who have no checkout: its links lead to the address of the repository.
fn how_to_install() -> anyhow::Result<String> {
    let page = Path::new("docs/install.md");
    let text = std::fs::read_to_string(workspace().join(page)).with_context(|| page.display().to_string())?;
    let repository = crates::repository()?;
    Ok(markdown::with_targets(&text, |link| {
        let anchor = link.anchor.map(|anchor| format!("#{anchor}")).unwrap_or_default();
        let path = normal(&page.with_file_name(link.path));
        (!link.path.is_empty()).then(|| format!("{repository}/blob/main/{}{anchor}", path.display()))
    }))
}

impl Program {
    /// Makes the Debian package, lets lintian look at it where it is installed, and returns its path.
    pub(super) fn debian_package(&self, release: &Release) -> anyhow::Result<PathBuf> {
        let about = About {
            version: &release.version,
            architecture: release.target.of_debian(),
            time: release.time,
            compression: &["-Zxz"],
        };
        let package = debian::package(&self.folder, &about, &release.out)?;
        if !debian::lint(&package)? {
            eprintln!("xtask: lintian is missing, and did not look at {}", package.display());
        }
        Ok(package)
    }

    /// Packs the folder as a tarball and returns its path: sorted, without owners, all with one time.
    pub(super) fn tarball(&self, release: &Release) -> anyhow::Result<PathBuf> {
        let file = release.out.join(format!("{}.tar.gz", release.name()));
        release.pack(&self.folder, &file)?;
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
