//! The crates that are compiled into a program.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;
use std::process::Command;

use anyhow::Context;
use serde::Deserialize;

use crate::steps::{output_of, workspace};

/// A crate, ours or another's.
#[derive(Deserialize)]
pub(crate) struct Crate {
    pub(crate) name: String,
    pub(crate) version: String,
    /// An expression of SPDX.
    pub(crate) license: Option<String>,
    license_file: Option<PathBuf>,
    manifest_path: PathBuf,
    #[serde(default)]
    pub(crate) authors: Vec<String>,
    pub(crate) repository: Option<String>,
    /// `None` for ours.
    source: Option<String>,
    id: String,
}

impl Crate {
    pub(crate) fn is_ours(&self) -> bool {
        self.source.is_none()
    }

    /// The folder of its sources.
    pub(crate) fn folder(&self) -> PathBuf {
        self.manifest_path.parent().map(Into::into).unwrap_or_default()
    }

    /// The file with its licence, if the manifest names one.
    pub(crate) fn licence_file(&self) -> Option<PathBuf> {
        self.license_file.as_ref().map(|file| self.folder().join(file))
    }
}

/// Crates with what each of them uses, by index.
pub(crate) struct Crates {
    pub(crate) crates: Vec<Crate>,
    pub(crate) uses: Vec<Vec<usize>>,
}

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Crate>,
    resolve: Resolve,
}

#[derive(Deserialize)]
struct Resolve {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    id: String,
    dependencies: Vec<String>,
}

/// The folder in which cargo keeps what it downloads.
pub(crate) fn cargo_home() -> anyhow::Result<PathBuf> {
    match std::env::var_os("CARGO_HOME") {
        Some(home) => Ok(home.into()),
        None => Ok(std::env::home_dir().context("neither CARGO_HOME nor HOME is set")?.join(".cargo")),
    }
}

/// The version of the workspace.
pub(crate) fn version() -> anyhow::Result<String> {
    let text = output_of(Command::new(env!("CARGO")).args(["metadata", "--format-version=1", "--no-deps"]))?;
    let metadata: serde_json::Value = serde_json::from_str(&text).context("cargo metadata")?;
    let packages = metadata["packages"].as_array().context("cargo metadata lists no packages")?;
    let downbeat = packages.iter().find(|package| package["name"] == "downbeat");
    let version = downbeat.and_then(|package| package["version"].as_str());
    Ok(version.context("cargo metadata does not list downbeat")?.to_owned())
}

/// The address of the repository, as the workspace gives it.
pub(crate) fn repository() -> anyhow::Result<String> {
    let manifest =
        std::fs::read_to_string(workspace().join("Cargo.toml")).context("cannot read Cargo.toml")?;
    let line = manifest.lines().find_map(|line| line.strip_prefix("repository = \""));
    let address = line.and_then(|line| line.split('"').next()).context("Cargo.toml has no repository")?;
    Ok(address.to_owned())
}

/// The crates that are compiled into a package of the workspace, itself among them: no procedural macros, and
/// nothing that only build scripts or tests use. `target` is a triple.
pub(crate) fn of(package: &str, features: &str, target: &str) -> anyhow::Result<Crates> {
    let choice = ["--locked", "--target", target, "--features", features];
    let mut tree = Command::new(env!("CARGO"));
    tree.args(["tree", "--edges=normal,no-proc-macro", "--prefix=none", "--format={p}"]);
    let tree = output_of(tree.args(["--package", package]).args(choice))?;
    // `name vVERSION (folder) (*)`
    let compiled: BTreeSet<(&str, &str)> = tree
        .lines()
        .filter_map(|line| {
            let mut words = line.split(' ');
            Some((words.next()?, words.next()?.strip_prefix('v')?))
        })
        .collect();
    let mut metadata = Command::new(env!("CARGO"));
    metadata.args(["metadata", "--format-version=1", "--locked", "--filter-platform", target]);
    // Of all packages: `cargo tree` has chosen already.
    let text = output_of(metadata.arg("--all-features"))?;
    let Metadata { packages, resolve } = serde_json::from_str(&text).context("cargo metadata")?;
    let mut crates: Vec<Crate> = packages
        .into_iter()
        .filter(|one| compiled.contains(&(one.name.as_str(), one.version.as_str())))
        .collect();
    anyhow::ensure!(crates.len() == compiled.len(), "cargo metadata lacks crates that cargo tree lists");
    crates.sort_by(|a, b| (&a.name, &a.version).cmp(&(&b.name, &b.version)));
    let places: BTreeMap<&str, usize> =
        crates.iter().enumerate().map(|(place, one)| (one.id.as_str(), place)).collect();
    let mut uses = vec![Vec::new(); crates.len()];
    for node in &resolve.nodes {
        if let Some(place) = places.get(node.id.as_str()) {
            let used = node.dependencies.iter().filter_map(|id| places.get(id.as_str()).copied());
            uses[*place] = used.collect::<BTreeSet<_>>().into_iter().collect();
        }
    }
    Ok(Crates { crates, uses })
}

/// The checksums of a `Cargo.lock` by name and version.
pub(crate) fn checksums(lock: &str) -> BTreeMap<(&str, &str), &str> {
    let mut found = BTreeMap::new();
    for package in lock.split("[[package]]").skip(1) {
        let field = |key: &str| {
            package.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix(" = \"")?.strip_suffix('"'))
        };
        if let (Some(name), Some(version), Some(checksum)) =
            (field("name"), field("version"), field("checksum"))
        {
            found.insert((name, version), checksum);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_are_those_of_packages_from_a_registry() {
        let lock = "version = 4\n\n[[package]]\nname = \"ours\"\nversion = \"0.1.0\"\ndependencies = [\n \"theirs\",\n]\n\n\
                    [[package]]\nname = \"theirs\"\nversion = \"1.2.3\"\nsource = \"registry\"\nchecksum = \"abc\"\n";
        assert_eq!(checksums(lock), BTreeMap::from([(("theirs", "1.2.3"), "abc")]));
    }
}
