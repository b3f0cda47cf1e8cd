//! The list of what a program consists of (SBOM), in the form of CycloneDX 1.5.
//!
//! Written here, for `cargo-cyclonedx` lists what a workspace may use, not what is compiled into one program
//! with given features for one target.

use std::path::PathBuf;
use std::process::Command;

use anyhow::Context;
use serde_json::{Value, json};

use super::release::Release;
use crate::crates::{Crate, Crates, checksums};
use crate::steps::{output_of, workspace};

/// Writes the SBOM of what is compiled into a package of the workspace, and returns its path.
pub(super) fn write(package: &str, crates: &Crates, release: &Release) -> anyhow::Result<PathBuf> {
    let name = format!("{package}-{}-{}", release.version, release.target.triple());
    let file = release.out.join(format!("{name}.cdx.json"));
    let sbom = of(package, &name, crates, release)?;
    std::fs::write(&file, sbom).with_context(|| format!("cannot write {}", file.display()))?;
    Ok(file)
}

fn of(package: &str, name: &str, crates: &Crates, release: &Release) -> anyhow::Result<String> {
    let lock = std::fs::read_to_string(workspace().join("Cargo.lock")).context("cannot read Cargo.lock")?;
    let checksums = checksums(&lock);
    let components: Vec<Value> = crates
        .crates
        .iter()
        .map(|one| component(one, checksums.get(&(one.name.as_str(), one.version.as_str())).copied()))
        .collect();
    let dependencies: Vec<Value> = crates
        .crates
        .iter()
        .zip(&crates.uses)
        .map(|(one, uses)| {
            let uses: Vec<String> = uses.iter().map(|place| reference(&crates.crates[*place])).collect();
            json!({ "ref": reference(one), "dependsOn": uses })
        })
        .collect();
    let time = output_of(
        Command::new("date")
            .args(["--utc", "+%Y-%m-%dT%H:%M:%SZ", "--date"])
            .arg(format!("@{}", release.time)),
    )?;
    let sbom = json!({
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {
            "timestamp": time.trim(),
            "component": {
                "type": "application",
                "bom-ref": name,
                "name": package,
                "version": release.version,
                "properties": [{ "name": "cdx:rustc:sbom:target:triple", "value": release.target.triple() }],
            },
        },
        "components": components,
        "dependencies": dependencies,
    });
    Ok(format!("{:#}\n", sbom))
}

fn component(one: &Crate, checksum: Option<&str>) -> Value {
    let mut component = json!({
        "type": "library",
        "bom-ref": reference(one),
        "name": one.name,
        "version": one.version,
    });
    if !one.is_ours() {
        component["purl"] = json!(reference(one));
    }
    if let Some(license) = &one.license {
        // Before SPDX, `/` stood for `OR`.
        component["licenses"] = json!([{ "expression": license.replace('/', " OR ") }]);
    }
    if let Some(checksum) = checksum {
        component["hashes"] = json!([{ "alg": "SHA-256", "content": checksum }]);
    }
    if let Some(repository) = &one.repository {
        component["externalReferences"] = json!([{ "type": "vcs", "url": repository }]);
    }
    component
}

fn reference(one: &Crate) -> String {
    format!("pkg:cargo/{}@{}", one.name, one.version)
}
