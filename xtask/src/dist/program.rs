//! The program of a release, and the files that go with it.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use super::glibc;
use super::release::{FEATURES, Release, fresh};
use crate::crates::{self, Crates, cargo_home};
use crate::packaging::debian::{self, About};
use crate::packaging::{arrange, write};
use crate::paths::normal;
use crate::steps::{run, workspace};
use crate::{files, markdown, notices};

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
    glibc::check(&built)?;
    let folder = release.scratch.join(release.name());
    fresh(&folder)?;
    arrange(&built, &|program| release.target.runs(program), &notices::of(&crates)?, &folder)?;
    write(&folder.join("share/doc/downbeat/README.md"), how_to_install()?.as_bytes())?;
    without_paths(&folder)?;
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

/// Checks that no file of a folder tells anything about the machine that built it.
pub(super) fn without_paths(folder: &Path) -> anyhow::Result<()> {
    let places = [workspace(), cargo_home()?];
    for file in files::below(folder)? {
        let path = folder.join(file.path);
        let bytes = std::fs::read(&path).with_context(|| path.display().to_string())?;
        if let Some(text) = places.iter().find_map(|place| path_in(&bytes, place)) {
            anyhow::bail!("{} contains a path of this machine: {text:?}", path.display());
        }
    }
    Ok(())
}

/// Where a path is in the bytes of a file, with what follows it.
fn path_in(bytes: &[u8], path: &Path) -> Option<String> {
    let path = path.as_os_str().as_encoded_bytes();
    let start = bytes.windows(path.len()).position(|window| window == path)?;
    let end = bytes.len().min(start + 200);
    Some(String::from_utf8_lossy(&bytes[start..end]).into_owned())
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    #[test]
    fn a_path_of_this_machine_is_found_in_any_file() {
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("bin/program"), b"\x7fELF /downbeat/src/lib.rs").unwrap();
        without_paths(folder.path()).unwrap();
        let list = format!("{{\"bom-ref\": \"path+file://{}/python#0.1.0\"}}", workspace().display());
        write(&folder.path().join("sboms/list.json"), list.as_bytes()).unwrap();
        let error = without_paths(folder.path()).unwrap_err().to_string();
        assert!(error.contains("sboms/list.json contains a path of this machine: "), "{error}");
        assert!(error.contains("/python#0.1.0"), "{error}");
    }
}
