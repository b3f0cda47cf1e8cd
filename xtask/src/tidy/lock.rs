//! The lock file of the program: `cargo run` copies it from that of the workspace, colcon uses it as it is.

use std::fs;
use std::path::Path;

use anyhow::Context;

use crate::crates::checksums;

pub(super) fn problems(root: &Path) -> anyhow::Result<Vec<String>> {
    let read = |path: &str| fs::read_to_string(root.join(path)).with_context(|| path.to_owned());
    let [workspace, program] = [read("Cargo.lock")?, read("start/program/Cargo.lock")?];
    let known = checksums(&workspace);
    let differing = checksums(&program).into_keys().filter(|package| !known.contains_key(package));
    let problem = |(name, version)| {
        format!(
            "start/program/Cargo.lock: Cargo.lock has no {name} {version}: commit the copy that `cargo run -- --version` makes"
        )
    };
    Ok(differing.map(problem).collect())
}
