//! What the default build may cost: `cargo xtask budget`, and a step of the test run.
//!
//! Seconds differ from machine to machine, and a release build takes minutes. Two numbers grow with the time
//! that a build from nothing takes, and cost only seconds to count: how many crates it compiles, and how much
//! machine code our own ones are. The code is that which the test run has compiled already, without
//! optimisation and with most features. Generic code that is instantiated too often shows in it as it does in
//! a release build.

mod machine_code;

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};

use crate::steps::workspace;

/// The numbers that were accepted last.
const RECORDED: &str = "xtask/budget.json";

/// How much more than recorded is tolerated.
const TOLERATED_PERCENT: u64 = 10;

/// What a package may grow by in addition, in kB, so that small ones may change.
const TOLERATED_KB: u64 = 50;

/// What a default build costs.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Costs {
    /// How many crates it compiles, procedural macros and those of build scripts included.
    crates: u64,
    /// The machine code of each package of ours, as the test run compiles it, in kB.
    code_kb: BTreeMap<String, u64>,
}

impl Costs {
    fn code_in_all(&self) -> u64 {
        self.code_kb.values().sum()
    }

    /// What these costs exceed, given the recorded ones.
    fn exceeded(&self, recorded: &Self) -> Vec<String> {
        let mut found = Vec::new();
        let mut compare = |of: &str, now: u64, recorded: u64, in_addition: u64| {
            if now > recorded * (100 + TOLERATED_PERCENT) / 100 + in_addition {
                found.push(format!("{of}: {now}, recorded: {recorded}"));
            }
        };
        compare("crates", self.crates, recorded.crates, 0);
        compare("kB of code in all", self.code_in_all(), recorded.code_in_all(), 0);
        for (package, now) in &self.code_kb {
            // A new package counts in the sum.
            if let Some(recorded) = recorded.code_kb.get(package) {
                compare(&format!("kB of code in {package}"), *now, *recorded, TOLERATED_KB);
            }
        }
        found
    }
}

/// Compares with the recorded costs.
pub(crate) fn check(features: &[&str]) -> anyhow::Result<()> {
    if !machine_code::IS_COUNTED {
        println!("the code is counted on Linux only");
        return Ok(());
    }
    let path = workspace().join(RECORDED);
    let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {RECORDED}"))?;
    let recorded: Costs =
        serde_json::from_str(&text).with_context(|| format!("{RECORDED} is not understood"))?;
    let now = measure(features)?;
    let code = (now.code_in_all(), recorded.code_in_all());
    println!("crates: {}, recorded: {}", now.crates, recorded.crates);
    println!("kB of code in all: {}, recorded: {}", code.0, code.1);
    let exceeded = now.exceeded(&recorded);
    if !exceeded.is_empty() {
        bail!(
            "the default build costs more than {TOLERATED_PERCENT} % above what {RECORDED} says:\n  {}\nBuild less (see \
             \"The default build\" in CONTRIBUTING.md), or accept it: `cargo xtask budget --record`",
            exceeded.join("\n  ")
        );
    }
    Ok(())
}

/// Accepts what the default build costs now.
pub(crate) fn record(features: &[&str]) -> anyhow::Result<()> {
    if !machine_code::IS_COUNTED {
        bail!("the code is counted on Linux only");
    }
    let mut text = serde_json::to_string_pretty(&measure(features)?)?;
    text.push('\n');
    std::fs::write(workspace().join(RECORDED), text)?;
    println!("{RECORDED} is written");
    Ok(())
}

fn measure(features: &[&str]) -> anyhow::Result<Costs> {
    let crates = crates_of_default_build()?;
    let folder = workspace();
    let is_ours = |line: &&String| line.contains(&format!("({}", folder.display()));
    let ours: BTreeSet<&str> =
        crates.iter().filter(is_ours).filter_map(|line| line.split_whitespace().next()).collect();
    let code_kb = libraries_of_tests(features)?
        .into_iter()
        .filter(|(package, _)| ours.contains(package.as_str()))
        .map(|(package, path)| {
            let bytes = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
            let code = machine_code::size(&bytes).with_context(|| format!("{}", path.display()))?;
            Ok((package, code / 1000))
        })
        .collect::<anyhow::Result<_>>()?;
    Ok(Costs { crates: crates.len() as u64, code_kb })
}

/// The crates that a default build compiles, as `cargo tree` names them: name, version, folder.
fn crates_of_default_build() -> anyhow::Result<BTreeSet<String>> {
    let arguments = [
        "tree",
        "--offline",
        "--package",
        "downbeat",
        "--edges",
        "normal,build",
        "--prefix",
        "none",
        "--format",
        "{p}",
        "--target",
        "x86_64-unknown-linux-gnu",
    ];
    let tree = output(&arguments)?;
    let name = |line: &str| line.trim_end_matches(" (*)").replace(" (proc-macro)", "");
    Ok(tree.lines().filter(|line| !line.is_empty()).map(name).collect())
}

/// The libraries that the tests are built with, by package. Nothing is compiled if the tests have run.
fn libraries_of_tests(features: &[&str]) -> anyhow::Result<BTreeMap<String, PathBuf>> {
    #[derive(Deserialize)]
    struct Message {
        reason: String,
        manifest_path: Option<PathBuf>,
        target: Option<Target>,
        profile: Option<Profile>,
        #[serde(default)]
        filenames: Vec<PathBuf>,
    }
    #[derive(Deserialize)]
    struct Target {
        kind: Vec<String>,
    }
    #[derive(Deserialize)]
    struct Profile {
        test: bool,
        opt_level: String,
    }
    let mut arguments =
        vec!["test", "--workspace", "--lib", "--no-run", "--quiet", "--message-format", "json"];
    arguments.extend(features);
    let mut libraries = BTreeMap::new();
    for line in output(&arguments)?.lines() {
        let Ok(message) = serde_json::from_str::<Message>(line) else { continue };
        let (Some(target), Some(profile), Some(manifest)) =
            (message.target, message.profile, message.manifest_path)
        else {
            continue;
        };
        let is_library = target.kind.iter().any(|kind| kind == "lib") && !profile.test;
        // Libraries of build scripts are compiled a second time; dependencies of others with optimisation.
        if message.reason != "compiler-artifact" || !is_library || profile.opt_level != "0" {
            continue;
        }
        let library =
            message.filenames.into_iter().find(|path| path.extension().is_some_and(|it| it == "rlib"));
        if let (Some(library), Some(package)) = (library, package_name(&manifest)) {
            libraries.entry(package).or_insert(library);
        }
    }
    Ok(libraries)
}

fn package_name(manifest: &Path) -> Option<String> {
    let text = std::fs::read_to_string(manifest).ok()?;
    let name = text.lines().find_map(|line| line.strip_prefix("name = \""))?;
    Some(name.split('"').next()?.to_owned())
}

fn output(arguments: &[&str]) -> anyhow::Result<String> {
    let mut command = Command::new(env!("CARGO"));
    command.args(arguments).current_dir(workspace()).stderr(std::process::Stdio::inherit());
    let output = command.output().with_context(|| format!("cannot run {command:?}"))?;
    if !output.status.success() {
        bail!("{command:?} failed: {}", output.status);
    }
    Ok(String::from_utf8(output.stdout)?)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;

    fn costs(crates: u64, code: &[(&str, u64)]) -> Costs {
        let code_kb = code.iter().map(|(package, kb)| ((*package).to_owned(), *kb)).collect();
        Costs { crates, code_kb }
    }

    #[test]
    fn ten_percent_more_are_tolerated_and_not_more() {
        let recorded = costs(200, &[("edge", 4000), ("bags", 100), ("top", 2000)]);
        let exceeded = |now: &Costs| now.exceeded(&recorded);
        assert!(exceeded(&recorded).is_empty());
        assert!(exceeded(&costs(220, &[("edge", 4400), ("bags", 110), ("top", 2200)])).is_empty());
        assert_eq!(exceeded(&costs(221, &[])), ["crates: 221, recorded: 200"]);
        assert_eq!(
            exceeded(&costs(200, &[("edge", 4451), ("bags", 100), ("top", 2000)])),
            ["kB of code in edge: 4451, recorded: 4000"]
        );
        let with_another = costs(200, &[("edge", 4000), ("bags", 150), ("top", 2000), ("new", 700)]);
        assert_eq!(exceeded(&with_another), ["kB of code in all: 6850, recorded: 6100"]);
    }

    #[test]
    fn the_recorded_costs_are_read_and_are_of_packages_that_exist() {
        let text = std::fs::read_to_string(workspace().join(RECORDED)).unwrap();
        let recorded: Costs = serde_json::from_str(&text).unwrap();
        let crates = crates_of_default_build().unwrap();
        assert!(recorded.crates > 0);
        for package in recorded.code_kb.keys() {
            assert!(
                crates.iter().any(|line| line.split(' ').next() == Some(package)),
                "{package}: record again"
            );
        }
    }
}
