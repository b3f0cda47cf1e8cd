//! A registry in a folder: the packages as `cargo package` wrote them, and what cargo has downloaded for this
//! checkout.
//!
//! Its format is that of cargo's sources of the kind `local-registry`.

use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail, ensure};
use serde_json::{Map, Value, json};
use sha2::{Digest, Sha256};

use crate::crates::{cargo_home, checksums};
use crate::steps::{run, workspace};

/// Packages everything that is published and returns the packages by their names.
pub(super) fn package() -> anyhow::Result<BTreeMap<String, PathBuf>> {
    let metadata = metadata(&["--no-deps"])?;
    let members = metadata["packages"].as_array().context("no packages")?;
    let name = |package: &Value| package["name"].as_str().unwrap_or_default().to_owned();
    let is_published = |package: &&Value| package["publish"] != json!([]);
    let mut command = Command::new(env!("CARGO"));
    // Each is compiled when it is installed, from the same file.
    command.args(["package", "--workspace", "--no-verify", "--allow-dirty", "--quiet"]);
    for package in members.iter().filter(|package| !is_published(package)) {
        command.args(["--exclude", &name(package)]);
    }
    run(&mut command)?;
    let folder = PathBuf::from(metadata["target_directory"].as_str().context("no target folder")?);
    let file = |package: &Value| {
        let version = package["version"].as_str().unwrap_or_default();
        let name = name(package);
        let path = folder.join(format!("package/{name}-{version}.crate"));
        (name, path)
    };
    Ok(members.iter().filter(is_published).map(file).collect())
}

/// Writes the registry and returns the checksums of our packages.
pub(super) fn write(folder: &Path, ours: &BTreeMap<String, PathBuf>) -> anyhow::Result<String> {
    if folder.exists() {
        fs::remove_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    fs::create_dir_all(folder.join("index"))?;
    let downloaded = downloaded()?;
    let lock = fs::read_to_string(workspace().join("Cargo.lock")).context("cannot read Cargo.lock")?;
    let checksums = checksums(&lock);
    let mut all = String::new();
    for package in metadata(&["--locked"])?["packages"].as_array().context("no packages")? {
        let text = |key: &str| package[key].as_str().unwrap_or_default();
        let (name, version) = (text("name"), text("version"));
        let file_name = format!("{name}-{version}.crate");
        let (file, checksum) = match (ours.get(name), text("source").is_empty()) {
            (Some(file), true) => {
                let content = fs::read(file).with_context(|| file.display().to_string())?;
                let checksum: String =
                    Sha256::digest(content).iter().map(|byte| format!("{byte:02x}")).collect();
                all += &format!("{checksum}  {file_name}\n");
                (Some(file), checksum)
            }
            (_, false) => {
                let checksum = checksums.get(&(name, version));
                let checksum = checksum.with_context(|| format!("Cargo.lock has no checksum of {name}"))?;
                (downloaded.get(&file_name), (*checksum).to_owned())
            }
            (None, true) => continue, // not published
        };
        // One for another system may not have been downloaded.
        if let Some(file) = file {
            std::os::unix::fs::symlink(file, folder.join(file_name))?;
        }
        let path = folder.join("index").join(place(name));
        fs::create_dir_all(path.parent().unwrap_or(folder))?;
        let mut index = fs::File::options().create(true).append(true).open(&path)?;
        writeln!(index, "{}", entry(package, &checksum))?;
    }
    Ok(all)
}

/// Where the index has a package, by cargo's rules.
fn place(name: &str) -> PathBuf {
    let name = name.to_lowercase();
    match name.len() {
        1 => PathBuf::from("1").join(name),
        2 => PathBuf::from("2").join(name),
        3 => PathBuf::from("3").join(&name[..1]).join(name),
        _ => PathBuf::from(&name[..2]).join(&name[2..4]).join(name),
    }
}

/// The line of a package in the index.
fn entry(package: &Value, checksum: &str) -> Value {
    let dependency = |dependency: &Value| {
        let is_renamed = !dependency["rename"].is_null();
        json!({
            "name": if is_renamed { &dependency["rename"] } else { &dependency["name"] },
            "package": if is_renamed { dependency["name"].clone() } else { Value::Null },
            "req": dependency["req"],
            "features": dependency["features"],
            "optional": dependency["optional"],
            "default_features": dependency["uses_default_features"],
            "target": dependency["target"],
            "kind": dependency["kind"].as_str().unwrap_or("normal"),
        })
    };
    let dependencies = package["dependencies"].as_array().map(Vec::as_slice).unwrap_or_default();
    // Those of tests: features may name them. Ours are partly packages that are not published.
    let is_of_tests = |dependency: &Value| dependency["kind"] == "dev" && package["source"].is_null();
    let dependencies = dependencies.iter().filter(|dependency| !is_of_tests(dependency));
    json!({
        "name": package["name"],
        "vers": package["version"],
        "deps": dependencies.map(dependency).collect::<Vec<_>>(),
        "cksum": checksum,
        "features": Map::new(),
        "features2": package["features"],
        "yanked": false,
        "links": package["links"],
        "v": 2,
    })
}

fn metadata(arguments: &[&str]) -> anyhow::Result<Value> {
    let mut command = Command::new(env!("CARGO"));
    // Not offline: cargo downloads what other platforms need, which a build has left out.
    command.args(["metadata", "--format-version", "1"]).args(arguments);
    let output = command.current_dir(workspace()).output().context("cannot run cargo metadata")?;
    ensure!(output.status.success(), "cargo metadata: {}", String::from_utf8_lossy(&output.stderr));
    Ok(serde_json::from_slice(&output.stdout)?)
}

/// The packages that cargo has downloaded, by the names of their files.
fn downloaded() -> anyhow::Result<BTreeMap<String, PathBuf>> {
    let cache = cargo_home()?.join("registry/cache");
    let mut found = BTreeMap::new();
    for registry in fs::read_dir(&cache).with_context(|| cache.display().to_string())? {
        for file in fs::read_dir(registry?.path())? {
            let file = file?;
            found.insert(file.file_name().to_string_lossy().into_owned(), file.path());
        }
    }
    if found.is_empty() {
        bail!("cargo has downloaded nothing into {}; run `cargo fetch`", cache.display());
    }
    Ok(found)
}
