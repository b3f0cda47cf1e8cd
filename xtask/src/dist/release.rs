//! A release for one target: what is built, and in which environment.

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;

use super::cross::{self, Target};
use crate::crates::{self, cargo_home};
use crate::steps::{output_of, run, workspace};

/// The features of the program and the wheel beside the default ones: all but `rustdds`, a second DDS engine
/// for comparison. SQLite and the TLS of Zenoh compile C.
pub(crate) const FEATURES: &str = "football,mqtt,mujoco,policy,px4,security,sensors,sqlite,tables,zenoh";

/// What is built, and for whom.
pub(crate) struct Release {
    pub(super) target: Target,
    pub(super) version: String,
    /// The time of the commit, in seconds since 1970, which all files get.
    pub(super) time: u64,
    /// Where the files of the release are written.
    pub(super) out: PathBuf,
    /// Where parts of it are prepared.
    pub(super) scratch: PathBuf,
}

impl Release {
    pub(super) fn new(target: Target, out: Option<PathBuf>) -> anyhow::Result<Self> {
        let out = out.map_or_else(|| Ok(workspace().join("target/dist")), std::path::absolute)?;
        std::fs::create_dir_all(&out).with_context(|| format!("cannot create {}", out.display()))?;
        let time = output_of(Command::new("git").args(["log", "-1", "--format=%ct"]))?;
        let time = time.trim().parse().with_context(|| format!("git gave {time:?} as time of the commit"))?;
        if !output_of(Command::new("git").args(["status", "--porcelain"]))?.is_empty() {
            eprintln!("xtask: there are changes that are not committed: these files cannot be reproduced");
        }
        let version = crates::version()?;
        Ok(Self {
            target,
            version,
            time,
            out,
            scratch: workspace().join("target/dist-scratch").join(target.triple()),
        })
    }

    /// `downbeat-VERSION-TARGET`
    pub(super) fn name(&self) -> String {
        format!("downbeat-{}-{}", self.version, self.target.triple())
    }

    /// Packs a folder into `file`, a `.tar.gz` with the same bytes for the same contents.
    pub(super) fn pack(&self, folder: &Path, file: &Path) -> anyhow::Result<()> {
        let mut tar = Command::new("tar");
        tar.args(["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--format=ustar"]);
        tar.args(["--mode=u=rwX,go=rX", "--use-compress-program=gzip -9 --no-name"]);
        tar.arg(format!("--mtime=@{}", self.time)).arg("--create").arg("--file").arg(file);
        let name = folder.file_name().context("a folder without a name")?;
        run(tar.arg("--directory").arg(folder.parent().unwrap_or(folder)).arg(name))
    }

    /// The environment in which cargo and maturin compile.
    pub(super) fn compiling<'a>(&self, command: &'a mut Command) -> anyhow::Result<&'a mut Command> {
        let home = cargo_home()?;
        // Where sources are is in messages of panics.
        let places = [(workspace(), "/downbeat"), (home, "/cargo")];
        let mut rust = Vec::new();
        let mut c = Vec::new();
        for (from, to) in &places {
            rust.push(format!("--remap-path-prefix={}={to}", from.display()));
            c.push(format!("-ffile-prefix-map={}={to}", from.display()));
        }
        command.env("CARGO_ENCODED_RUSTFLAGS", rust.join("\u{1f}"));
        command.env(format!("CFLAGS_{}", self.target.triple().replace('-', "_")), c.join(" "));
        // Without it `downbeat new` would contain the path of the checkout.
        command.env("DOWNBEAT_RELEASE", &self.version);
        command.env("SOURCE_DATE_EPOCH", self.time.to_string()).env("CARGO_INCREMENTAL", "0");
        command.env("CARGO_TARGET_DIR", workspace().join("target"));
        Ok(command.envs(cross::environment(self.target)?))
    }
}

/// An empty folder in place of one that may exist.
pub(super) fn fresh(folder: &Path) -> anyhow::Result<()> {
    if folder.exists() {
        std::fs::remove_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())
}
