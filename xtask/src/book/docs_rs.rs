//! The documentation of each crate as docs.rs writes it: of that crate alone, with the features that its
//! manifest names for docs.rs. In a build of the workspace, a crate has the features that others ask of it.

use std::process::Command;

use super::Package;
use crate::steps::{run, workspace};

/// Documents all packages.
///
/// # Errors
/// If one of them cannot be documented, or has a warning, such as a link to an item that is not there.
pub(super) fn document(packages: &[Package]) -> anyhow::Result<()> {
    for package in packages {
        let mut cargo = Command::new(env!("CARGO"));
        cargo
            .args(["doc", "--no-deps", "--quiet", "--lib", "--package", &package.name])
            .args(features(package));
        cargo
            .arg("--target-dir")
            .arg(workspace().join("target/docs_rs"))
            // Only macros and build scripts are compiled, once per set of features, and run for moments.
            .args(["--config", "profile.dev.package.'*'.opt-level=0"])
            .env("RUSTDOCFLAGS", "--deny warnings");
        run(&mut cargo)?;
    }
    println!("{} crates, each alone with its features for docs.rs", packages.len());
    Ok(())
}

/// The options of cargo for the features of a package on docs.rs.
fn features(package: &Package) -> Vec<String> {
    let settings = &package.metadata["docs"]["rs"];
    if settings["all-features"] == true {
        return vec!["--all-features".to_owned()];
    }
    let named = settings["features"].as_array().into_iter().flatten();
    let named: Vec<_> = named.filter_map(|feature| feature.as_str()).collect();
    if named.is_empty() { Vec::new() } else { vec![format!("--features={}", named.join(","))] }
}
