//! `downbeat robots`

use std::path::PathBuf;

use clap::{Args, Subcommand};
use downbeat_files::suggestion;
use downbeat_robots::{Error, robots};
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

pub(crate) fn run(command: &RobotsCommand) -> anyhow::Result<()> {
    match command {
        RobotsCommand::List { json: true } => {
            let listed = robots().map(|robot| {
                json!({ "name": robot.name, "about": robot.about, "command": format!("downbeat {} {}", robot.command, robot.name) })
            });
            println!("{}", serde_json::to_string_pretty(&listed.collect::<Vec<_>>())?);
        }
        RobotsCommand::List { json: false } => {
            for robot in robots() {
                println!("downbeat {} {}\n    {}", robot.command, robot.name, robot.about);
            }
        }
        RobotsCommand::Copy(arguments) => copy(arguments)?,
    }
    Ok(())
}

fn copy(arguments: &CopyArguments) -> anyhow::Result<()> {
    let CopyArguments { name, folder, force } = arguments;
    match downbeat_robots::copy(name, folder, *force) {
        Ok(paths) => paths.iter().for_each(|path| println!("{}", path.display())),
        Err(error @ Error::Unknown(_)) => {
            anyhow::bail!("{error}{}", suggestion(name, robots().map(|robot| robot.name)))
        }
        Err(error @ Error::Exists(_)) => {
            anyhow::bail!("{error}; choose another folder, or replace it with --force")
        }
        Err(error) => return Err(error.into()),
    }
    Ok(())
}
