//! The folders of packages with interfaces.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};

use downbeat_msgs::definitions::{Catalog, Kind};

/// The folders of packages at a path, sorted by name: the path itself if it is a package, those below its
/// `share` if it is an ament prefix, otherwise those at any depth in it, as in the folder `src` of a
/// workspace.
///
/// # Errors
/// Returns an error if the path cannot be read, there is no package, or two have one name.
pub(super) fn packages_at(path: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let packages: Vec<PathBuf> = Catalog::packages_below(path)?.into_values().collect();
    if packages.is_empty() {
        bail!(
            "{} has no interfaces: expected an ament prefix, a folder of packages, or a package with a folder msg, \
             srv or action",
            path.display()
        );
    }
    Ok(packages)
}

/// The packages with interfaces in each prefix of AMENT_PREFIX_PATH, in order. Like in ament, missing
/// prefixes are ignored.
///
/// # Errors
/// Returns an error if a prefix cannot be read.
pub(super) fn ament_packages() -> anyhow::Result<Vec<PathBuf>> {
    let Some(prefixes) = std::env::var_os("AMENT_PREFIX_PATH") else { return Ok(Vec::new()) };
    let mut packages = Vec::new();
    for prefix in std::env::split_paths(&prefixes) {
        let share = prefix.join("share");
        // An empty path would mean the current folder.
        if !prefix.as_os_str().is_empty() && share.is_dir() {
            packages.append(&mut packages_in(&share)?);
        }
    }
    Ok(packages)
}

fn packages_in(folder: &Path) -> anyhow::Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| cannot_read(folder))?;
    let mut packages = entries
        .map(|entry| entry.map(|entry| entry.path()))
        .filter(|path| path.as_ref().map_or(true, |path| is_package(path)))
        .collect::<Result<Vec<_>, _>>()
        .with_context(|| cannot_read(folder))?;
    packages.sort();
    Ok(packages)
}

fn is_package(folder: &Path) -> bool {
    Kind::ALL.into_iter().any(|kind| folder.join(kind.as_str()).is_dir())
}

fn cannot_read(path: &Path) -> String {
    format!("cannot read {}", path.display())
}
