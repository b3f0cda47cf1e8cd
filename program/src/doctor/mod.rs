//! `downbeat doctor`

mod devices;
mod facts;
mod finding;
mod machine;
mod network;
mod real_time;
mod wanted;

use std::path::{Path, PathBuf};

use anyhow::bail;
use clap::Args;
use serde_json::json;

use super::parameters::ParameterArguments;
use downbeat_robot::{Catalog, RobotFileError, RosArgs};
use facts::Facts;
use finding::{Finding, Verdict};
use wanted::Wanted;

#[derive(Args)]
pub(crate) struct DoctorArguments {
    /// The robot file: its devices, priorities, networks and ports are looked at. Without one, all serial
    /// ports and cameras that are present.
    #[arg(value_name = "ROBOT.toml")]
    pub(crate) robot: Option<PathBuf>,
    /// Print what was found as JSON.
    #[arg(long)]
    pub(crate) json: bool,
    #[command(flatten)]
    pub(crate) parameters: ParameterArguments,
}

pub(crate) fn doctor(arguments: &DoctorArguments, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<()> {
    let (robot, wanted) = match arguments.robot.as_deref().map(|path| wanted(path, arguments, catalog, ros)) {
        None => (None, Wanted::default()),
        Some(Ok(wanted)) => (None, wanted),
        // What is wrong with the machine is worth knowing all the same.
        Some(Err(error)) => (Some(Finding::explained("robot", error.to_string())), Wanted::default()),
    };
    let facts = Facts::of_this_machine(wanted.is_robot.then_some(&*wanted.devices));
    let findings: Vec<_> = robot.into_iter().chain(diagnose(&facts, &wanted)).collect();
    let problems = findings.iter().filter(|finding| finding.verdict == Verdict::Problem).count();
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&json!({ "findings": findings, "problems": problems }))?);
    } else {
        findings.iter().for_each(|finding| println!("{finding}"));
    }
    if problems > 0 {
        bail!("{problems} of {} findings are problems", findings.len());
    }
    Ok(())
}

fn wanted(
    path: &Path,
    arguments: &DoctorArguments,
    catalog: &Catalog,
    ros: &RosArgs,
) -> Result<Wanted, RobotFileError> {
    Wanted::of(arguments.parameters.read_robot(path, catalog, ros)?)
}

/// What these facts mean for a robot with these wants.
fn diagnose(facts: &Facts, wanted: &Wanted) -> Vec<Finding> {
    let parts = [
        devices::examine(facts),
        real_time::examine(facts, wanted),
        network::examine(facts, wanted),
        machine::examine(facts),
    ];
    parts.into_iter().flatten().collect()
}

#[cfg(test)]
mod tests;
