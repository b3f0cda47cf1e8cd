//! `downbeat robots`

use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use downbeat_files::nearest;
use downbeat_robot::Catalog;
use downbeat_robot::features::missing_kinds;
use downbeat_robots::{Error, kinds_of, robots};
use serde_json::json;

#[derive(Subcommand)]
pub(crate) enum RobotsCommand {
    /// List the robots that this program carries, and what each is.
    List {
        /// Print JSON.
        #[arg(long)]
        json: bool,
    },
    /// Write the files of a carried robot into a folder, to change them: the robot file and what it names.
    Copy(CopyArguments),
}

#[derive(Args)]
pub(crate) struct CopyArguments {
    /// The robot, as `downbeat robots list` names it.
    #[arg(value_name = "NAME")]
    name: String,
    /// The folder; made if it does not exist.
    #[arg(value_name = "FOLDER", default_value = ".")]
    folder: PathBuf,
    /// Replace existing files.
    #[arg(long)]
    force: bool,
}

pub(crate) fn run(command: &RobotsCommand, catalog: &Catalog) -> anyhow::Result<()> {
    match command {
        RobotsCommand::List { json: true } => {
            let listed = robots().map(|robot| {
                let command = format!("downbeat {} {}", robot.command, robot.name);
                let missing = missing_features(robot.name, catalog)?;
                Ok(json!({ "name": robot.name, "about": robot.about, "command": command, "missing_features": missing }))
            });
            println!("{}", serde_json::to_string_pretty(&listed.collect::<Result<Vec<_>, Error>>()?)?);
        }
        RobotsCommand::List { json: false } => {
            for robot in robots() {
                println!("downbeat {} {}\n    {}", robot.command, robot.name, robot.about);
                let missing: Vec<_> = missing_features(robot.name, catalog)?.into_iter().collect();
                if !missing.is_empty() {
                    println!("    (Not in this program: build it with --features {}.)", missing.join(","));
                }
            }
        }
        RobotsCommand::Copy(arguments) => copy(arguments)?,
    }
    Ok(())
}

/// The features that this program lacks and a robot needs.
fn missing_features(robot: &str, catalog: &Catalog) -> Result<BTreeSet<&'static str>, Error> {
    let kinds = kinds_of(robot)?;
    let missing = missing_kinds(catalog).into_iter().filter(|(kind, _)| kinds.contains(kind));
    Ok(missing.map(|(_, feature)| feature).collect())
}

fn copy(arguments: &CopyArguments) -> anyhow::Result<()> {
    let CopyArguments { name, folder, force } = arguments;
    match downbeat_robots::copy(name, folder, *force) {
        Ok(paths) => paths.iter().for_each(|path| println!("{}", path.display())),
        Err(error @ Error::Unknown(_)) => {
            let nearest = nearest(name, robots().map(|robot| robot.name));
            let nearest = nearest.map(|nearest| format!("did you mean \"{nearest}\"? ")).unwrap_or_default();
            anyhow::bail!("{error}; {nearest}`downbeat robots list` names those that are")
        }
        Err(error @ Error::Exists(_)) => {
            anyhow::bail!("{error}; choose another folder, or replace it with --force")
        }
        Err(error) => return Err(error.into()),
    }
    Ok(())
}
