//! `downbeat view`: the page of a robot that runs.

mod layout;

use clap::{Args, Subcommand};

use super::choose::choose;
use downbeat_robot::inspect::Client;
use downbeat_robot::{Catalog, FOXGLOVE_PORT, RosArgs, ViewAccess, ViewEntry};
use layout::LayoutArguments;

/// Options of commands that run a robot, for who wants to see it.
#[derive(Args, Clone, Debug)]
pub(crate) struct ViewArguments {
    /// Show the robot in a browser, on this port: 7373, or a free one where that is in use, or that of the
    /// robot file's [view].
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true)]
    view: Option<Option<u16>>,
    /// Show the robot to Foxglove, Lichtblick and PlotJuggler on this port: 8765, or that of the robot file's
    /// [view].
    #[arg(long, value_name = "PORT", num_args = 0..=1, require_equals = true)]
    foxglove: Option<Option<u16>>,
    /// Let nobody change the robot through these.
    #[arg(long)]
    view_read_only: bool,
}

impl ViewArguments {
    /// Changes what the robot file says.
    pub(crate) fn apply(&self, entry: &mut ViewEntry) {
        if let Some(port) = self.view {
            entry.page = Some(port.or(entry.page.flatten()));
        }
        if let Some(port) = self.foxglove {
            entry.foxglove = port.or(entry.foxglove).or(Some(FOXGLOVE_PORT));
        }
        if self.view_read_only {
            entry.access = ViewAccess::ReadOnly;
        }
    }
}

/// Options of `downbeat view`.
#[derive(Args)]
#[command(args_conflicts_with_subcommands = true)]
pub(crate) struct ViewRobot {
    /// Name or process id of the robot, if several are running.
    robot: Option<String>,
    #[command(subcommand)]
    command: Option<ViewCommand>,
}

#[derive(Subcommand)]
enum ViewCommand {
    /// Write a layout for Lichtblick or Foxglove that shows the topics of a robot.
    Layout(LayoutArguments),
}

pub(crate) fn view(arguments: &ViewRobot, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<()> {
    if let Some(ViewCommand::Layout(arguments)) = &arguments.command {
        return layout::layout(arguments, catalog, ros);
    }
    let mut client = Client::connect(&choose(arguments.robot.as_deref())?)?;
    println!("open in a browser: {}", client.view()?);
    Ok(())
}
