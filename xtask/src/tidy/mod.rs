//! `cargo xtask tidy`: the rules of the layout, which the compiler does not check.
//!
//! `layers.rs` holds the lists of what may use what.

mod layers;
mod lock;
mod packages;
mod pages;
mod safety;
mod sources;
mod texts;
mod tokens;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use anyhow::bail;

use crate::steps::workspace;
use packages::Workspace;

/// What is wrong, a line each.
pub(crate) type Problems = Vec<String>;

/// Checks the workspace and prints each problem.
///
/// # Errors
/// When there is a problem, or files cannot be read.
pub(crate) fn tidy() -> anyhow::Result<()> {
    let root = workspace();
    let problems = problems(&root, &Workspace::load(&root)?)?;
    for problem in &problems {
        println!("{problem}");
    }
    match problems.len() {
        0 => Ok(()),
        count => bail!("{count} problems of the layout"),
    }
}

fn problems(root: &Path, workspace: &Workspace) -> anyhow::Result<Problems> {
    let mut problems = workspace.arrows_between_packages(layers::PACKAGES);
    problems.extend(workspace.unknown_features());
    problems.extend(workspace.undocumented_features());
    problems.extend(workspace.unpublishable());
    let (mut circles, mut tied) = (BTreeSet::new(), BTreeMap::new());
    for package in &workspace.packages {
        for crate_root in &package.roots {
            let sources = sources::Sources::read(crate_root)?;
            let arrows = sources.arrows();
            let relative = |path: &Path| path.strip_prefix(root).unwrap_or(path).display().to_string();
            for circle in sources::circles(&arrows, &sources.declared_by()) {
                circles.insert(circle.iter().map(|file| relative(file)).collect::<Vec<_>>());
            }
            for ((from, to), names) in arrows {
                let (from, to) = (relative(&from), relative(&to));
                problems.extend(layers::upward(&from, &to, &names));
                tied.entry((from, to)).or_insert(names);
            }
        }
        problems.extend(texts::problems(root, package)?);
    }
    problems.extend(layers::circles(&circles, &tied));
    problems.extend(pages::problems(root)?);
    problems.extend(lock::problems(root)?);
    // The folders of some packages are in those of the root package.
    problems.sort();
    problems.dedup();
    Ok(problems)
}
