//! The packages of the workspace and what they depend on, as Cargo sees them.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};
use serde::Deserialize;

use super::Problems;

/// Features that docs.rs leaves out on purpose: a second DDS engine, for comparison, which releases leave out
/// too.
const NOT_FOR_DOCS: [&str; 1] = ["rustdds"];

/// What `cargo metadata` says of this workspace.
pub(super) struct Workspace {
    pub(super) packages: Vec<Package>,
}

pub(super) struct Package {
    pub(super) name: String,
    pub(super) folder: PathBuf,
    /// The roots of its libraries and programs.
    pub(super) roots: Vec<PathBuf>,
    /// The packages of the workspace that it is built with; tests may use more.
    uses: Vec<String>,
    /// Features that its settings for docs.rs name, and that it does not have.
    unknown: Vec<String>,
    /// Features that docs.rs does not enable.
    undocumented: Vec<String>,
    /// The fields that registries show and its manifest lacks. Empty if it is not published.
    unsaid: Vec<&'static str>,
    is_published: bool,
}

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Described>,
}

#[derive(Deserialize)]
struct Described {
    name: String,
    manifest_path: PathBuf,
    targets: Vec<Target>,
    dependencies: Vec<Dependency>,
    features: BTreeMap<String, Vec<String>>,
    metadata: serde_json::Value,
    /// The registries it may go to: none of them, or any if this is not given.
    publish: Option<Vec<String>>,
    description: Option<String>,
    repository: Option<String>,
    readme: Option<PathBuf>,
    keywords: Vec<String>,
    categories: Vec<String>,
}

#[derive(Deserialize)]
struct Target {
    kind: Vec<String>,
    src_path: PathBuf,
}

#[derive(Deserialize)]
struct Dependency {
    name: String,
    kind: Option<String>,
    path: Option<PathBuf>,
}

impl Workspace {
    pub(super) fn load(root: &Path) -> anyhow::Result<Self> {
        let mut command = Command::new(env!("CARGO"));
        command.args(["metadata", "--no-deps", "--format-version", "1"]).current_dir(root);
        let output = command.output().context("cannot run cargo metadata")?;
        if !output.status.success() {
            bail!("cargo metadata failed: {}", String::from_utf8_lossy(&output.stderr));
        }
        Self::parse(&output.stdout)
    }

    fn parse(metadata: &[u8]) -> anyhow::Result<Self> {
        let Metadata { packages } =
            serde_json::from_slice(metadata).context("cargo metadata is not understood")?;
        Ok(Self { packages: packages.into_iter().map(Package::from).collect() })
    }

    /// Features for docs.rs that no package has: its build would fail, after the release.
    pub(super) fn unknown_features(&self) -> Problems {
        let unknown = |package: &Package| {
            let Package { name, unknown, .. } = package;
            let problem = |feature| {
                format!("{name}: docs.rs is to enable its feature {feature}, which it does not have")
            };
            unknown.iter().map(problem).collect::<Problems>()
        };
        self.packages.iter().flat_map(unknown).collect()
    }

    /// Features whose items would be missing on docs.rs.
    pub(super) fn undocumented_features(&self) -> Problems {
        let mut problems = Problems::new();
        for Package { name, undocumented, is_published, .. } in &self.packages {
            let forgotten = undocumented
                .iter()
                .filter(|feature| *is_published && !NOT_FOR_DOCS.contains(&feature.as_str()));
            problems.extend(forgotten.map(|feature| {
                format!(
                    "{name}: docs.rs does not enable its feature {feature}: name it in [package.metadata.docs.rs], or in \
                     NOT_FOR_DOCS of xtask/src/tidy/packages.rs"
                )
            }));
        }
        let is_left_out = |feature: &&str| {
            self.packages.iter().any(|package| package.undocumented.iter().any(|other| other == feature))
        };
        let gone = NOT_FOR_DOCS.iter().filter(|feature| !is_left_out(feature));
        problems.extend(gone.map(|feature| {
            format!(
                "{feature}: NOT_FOR_DOCS of xtask/src/tidy/packages.rs lists it, but no package leaves it out"
            )
        }));
        problems
    }

    /// What a package lacks that is to be published.
    pub(super) fn unpublishable(&self) -> Problems {
        let mut problems = Problems::new();
        for Package { name, folder, unsaid, is_published, .. } in &self.packages {
            problems.extend(unsaid.iter().map(|field| format!("{name}: its manifest has no {field}")));
            let licence = folder.join("LICENSE");
            if *is_published && !licence.is_file() {
                problems.push(format!(
                    "{name}: {} is missing: link it to that of the workspace",
                    licence.display()
                ));
            }
        }
        problems
    }

    /// Dependencies that `allowed` does not list: for each package those that it may use.
    pub(super) fn arrows_between_packages(&self, allowed: &[(&str, &[&str])]) -> Problems {
        let mut problems = Problems::new();
        for Package { name, uses, .. } in &self.packages {
            let Some((_, may_use)) = allowed.iter().find(|(package, _)| package == name) else {
                problems.push(format!("{name}: the list of packages in xtask/src/tidy/layers.rs lacks it"));
                continue;
            };
            let forbidden = uses.iter().filter(|used| !may_use.contains(&used.as_str()));
            problems.extend(forbidden.map(|used| {
                format!("{name}: depends on {used}, which xtask/src/tidy/layers.rs does not allow")
            }));
        }
        let exists = |name: &str| self.packages.iter().any(|package| package.name == name);
        let gone = allowed.iter().filter(|(package, _)| !exists(package));
        problems.extend(gone.map(|(name, _)| {
            format!("{name}: xtask/src/tidy/layers.rs lists it, but there is no such package")
        }));
        problems
    }
}

impl From<Described> for Package {
    fn from(described: Described) -> Self {
        let unsaid = described.unsaid();
        let is_published = described.is_published();
        let Described { name, manifest_path, targets, dependencies, features, metadata, .. } = described;
        let docs = &metadata["docs"]["rs"];
        let for_docs = docs["features"].as_array().into_iter().flatten();
        let for_docs: Vec<&str> = for_docs.filter_map(|feature| feature.as_str()).collect();
        let enabled = enabled(&features, &for_docs);
        let has_all = docs["all-features"].as_bool() == Some(true);
        let is_product = |target: &Target| {
            target.kind.iter().any(|kind| matches!(kind.as_str(), "lib" | "bin" | "cdylib" | "proc-macro"))
        };
        let used =
            |dependency: &Dependency| dependency.path.is_some() && dependency.kind.as_deref() != Some("dev");
        Self {
            name,
            folder: manifest_path.parent().unwrap_or(Path::new("")).to_owned(),
            roots: targets.into_iter().filter(is_product).map(|target| target.src_path).collect(),
            unknown: for_docs
                .iter()
                .filter(|feature| !features.contains_key(**feature))
                .map(|feature| (*feature).to_owned())
                .collect(),
            undocumented: features
                .keys()
                .filter(|feature| !has_all && !enabled.contains(feature.as_str()))
                .cloned()
                .collect(),
            uses: dependencies.into_iter().filter(used).map(|dependency| dependency.name).collect(),
            unsaid,
            is_published,
        }
    }
}

/// The default features of a package and some more, with all that they enable in it.
fn enabled<'a>(features: &'a BTreeMap<String, Vec<String>>, chosen: &[&'a str]) -> BTreeSet<&'a str> {
    let mut waiting = chosen.to_vec();
    waiting.push("default");
    let mut enabled = BTreeSet::new();
    while let Some(feature) = waiting.pop() {
        if enabled.insert(feature) {
            waiting.extend(features.get(feature).into_iter().flatten().map(String::as_str));
        }
    }
    enabled
}

impl Described {
    fn is_published(&self) -> bool {
        self.publish.as_ref().is_none_or(|registries| !registries.is_empty())
    }

    fn unsaid(&self) -> Vec<&'static str> {
        let said = [
            ("description", self.description.is_some()),
            ("repository", self.repository.is_some()),
            ("readme", self.readme.is_some()),
            ("keywords", !self.keywords.is_empty()),
            ("categories", !self.categories.is_empty()),
        ];
        let unsaid = said.into_iter().filter(|(_, is_said)| self.is_published() && !is_said);
        unsaid.map(|(field, _)| field).collect()
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use serde_json::json;

    use super::*;

    #[test]
    fn features_that_docs_rs_does_not_enable_are_problems() {
        let package = |name: &str, docs: serde_json::Value, publish: serde_json::Value| {
            json!({
                "name": name, "manifest_path": format!("/{name}/Cargo.toml"), "targets": [], "dependencies": [],
                "features": {
                    "default": ["view"], "view": ["dep:png"], "football": ["network", "wire/network"], "network": [],
                    "sqlite": [], "rustdds": [],
                },
                "metadata": {"docs": {"rs": docs}}, "publish": publish, "keywords": [], "categories": [],
            })
        };
        let metadata = json!({"packages": [
            package("robot", json!({"features": ["football"]}), json!(null)),
            package("wire", json!({"all-features": true}), json!(null)),
            package("tests", json!({}), json!([])),
        ]});
        let workspace = Workspace::parse(metadata.to_string().as_bytes()).unwrap();
        let problems = workspace.undocumented_features();
        assert_eq!(problems.len(), 1, "{problems:?}");
        assert!(
            problems[0].starts_with("robot: docs.rs does not enable its feature sqlite: "),
            "{problems:?}"
        );
        let problems = Workspace { packages: Vec::new() }.undocumented_features();
        assert!(problems[0].starts_with("rustdds: "), "{problems:?}");
    }

    #[test]
    fn what_a_package_may_not_use_and_what_it_lacks_are_problems() {
        let dependency =
            |name: &str, kind: Option<&str>| json!({"name": name, "kind": kind, "path": format!("/{name}")});
        let package = |name: &str, dependencies: Vec<serde_json::Value>| {
            json!({
                "name": name, "manifest_path": format!("/{name}/Cargo.toml"), "targets": [], "dependencies": dependencies,
                "features": {"can": []}, "metadata": {"docs": {"rs": {"features": ["can", name]}}},
                "description": "", "repository": "", "readme": "README.md", "keywords": ["robot"],
                "categories": if name == "wire" { json!([]) } else { json!(["robotics"]) },
                "publish": if name == "robot" { json!([]) } else { json!(null) },
            })
        };
        let metadata = json!({"packages": [
            package("engine", vec![dependency("wire", None), dependency("robot", None)]),
            package("wire", vec![dependency("robot", Some("dev"))]),
            package("robot", vec![]),
        ]});
        let workspace = Workspace::parse(metadata.to_string().as_bytes()).unwrap();
        let problems =
            workspace.arrows_between_packages(&[("engine", &["wire"]), ("wire", &[]), ("old", &[])]);
        assert_eq!(problems.len(), 3, "{problems:?}");
        assert!(problems[0].starts_with("engine: depends on robot"), "{problems:?}");
        assert!(problems[1].starts_with("robot: the list"), "{problems:?}");
        assert!(problems[2].starts_with("old: "), "{problems:?}");
        let features = workspace.unknown_features();
        assert_eq!(features.len(), 3, "{features:?}");
        assert!(features[1].contains("its feature wire,"), "{features:?}");
        let unpublishable = workspace.unpublishable();
        assert_eq!(unpublishable.len(), 3, "{unpublishable:?}");
        assert!(unpublishable[0].contains("/engine/LICENSE is missing"), "{unpublishable:?}");
        assert_eq!(unpublishable[1], "wire: its manifest has no categories");
    }
}
