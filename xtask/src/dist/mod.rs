//! `cargo xtask dist`: what a release consists of, for one target: tarball, Debian package, wheel and its
//! sources, with hashes, a list of parts (SBOM) and licences.
//!
//! The same commit is to give the same bytes, wherever the checkout is: times are those of the commit,
//! archives are sorted, and paths of this machine are replaced.

mod again;
pub(crate) mod cross;
mod from_nothing;
mod glibc;
mod program;
mod release;
mod sbom;
mod wheel;

use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::Context;
use clap::Args;

use crate::crates;
use crate::steps::output_of;
use cross::Target;
use program::Program;
pub(crate) use release::FEATURES;
use release::Release;

#[derive(Args)]
pub(crate) struct DistArguments {
    /// The platform that the release is for.
    #[arg(long, default_value_t = Target::X86_64)]
    target: Target,
    /// The folder of the files, one for all targets; target/dist if not given.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Only the tarball and its SBOM.
    #[arg(long)]
    program: bool,
    /// Once more in a clone of the commit: every file must have the same bytes.
    #[arg(long)]
    twice: bool,
    /// Only the sources of the wheel, for which nothing is compiled.
    #[arg(long, conflicts_with = "program")]
    sources: bool,
    /// Install from the files that are there already, each into a clean environment, run the demo robot, and
    /// remove it again.
    #[arg(long, conflicts_with_all = ["program", "sources", "twice"])]
    test: bool,
}

/// Builds the files of a release, or tries those that are there.
pub(crate) fn dist(arguments: DistArguments) -> anyhow::Result<()> {
    let release = Release::new(arguments.target, arguments.out)?;
    if arguments.test {
        return from_nothing::test(&release);
    }
    if arguments.twice {
        again::only_of_a_commit()?;
    }
    let (files, options) = match (arguments.sources, arguments.program) {
        (true, _) => (vec![wheel::sources(&release)?], ["--sources"].as_slice()),
        (false, true) => (of_program(&program::build(&release)?, &release)?, ["--program"].as_slice()),
        (false, false) => (all(&release)?, [].as_slice()),
    };
    sum(&release.out)?;
    print(&files)?;
    if arguments.twice {
        again::compare(&release, options, &files)?;
    }
    Ok(())
}

fn of_program(program: &Program, release: &Release) -> anyhow::Result<Vec<PathBuf>> {
    Ok(vec![program.tarball(release)?, sbom::write("downbeat", &program.crates, release)?])
}

fn all(release: &Release) -> anyhow::Result<Vec<PathBuf>> {
    let program = program::build(release)?;
    let mut files = of_program(&program, release)?;
    files.push(program.debian_package(release)?);
    files.push(wheel::build(release)?);
    let compiled_in = crates::of("downbeat-python", FEATURES, release.target.triple())?;
    files.push(sbom::write("downbeat-python", &compiled_in, release)?);
    // With the licences of that platform; one serves all.
    if release.target == Target::X86_64 {
        files.push(wheel::sources(release)?);
    }
    Ok(files)
}

/// Builds the program of a release and returns its path.
pub(crate) fn program(target: Target) -> anyhow::Result<PathBuf> {
    let release = Release::new(target, None)?;
    Ok(program::build(&release)?.folder.join("bin/downbeat"))
}

/// Writes SHA256SUMS for all files of the folder.
fn sum(out: &Path) -> anyhow::Result<()> {
    let mut names = Vec::new();
    for entry in std::fs::read_dir(out)? {
        let entry = entry?;
        if entry.file_type()?.is_file() && entry.file_name() != "SHA256SUMS" {
            names.push(entry.file_name());
        }
    }
    names.sort();
    let sums = output_of(Command::new("env").arg("--chdir").arg(out).args(["sha256sum", "--"]).args(&names))?;
    std::fs::write(out.join("SHA256SUMS"), sums).context("cannot write SHA256SUMS")
}

fn print(files: &[PathBuf]) -> anyhow::Result<()> {
    for file in files {
        let size = file.metadata().with_context(|| file.display().to_string())?.len();
        let sum = output_of(Command::new("sha256sum").arg(file))?;
        let sum = sum.split_whitespace().next().unwrap_or_default();
        println!("{:>7.2} MB  {sum}  {}", size as f64 / 1e6, file.display());
    }
    Ok(())
}
