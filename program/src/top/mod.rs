//! `downbeat top`

#[cfg(feature = "top")]
mod app;
#[cfg(feature = "top")]
mod choose;
#[cfg(feature = "top")]
mod graph;
// Sorting and highlighting are only used by the screen.
#[cfg_attr(not(feature = "top"), allow(dead_code))]
mod grid;
#[cfg(feature = "top")]
mod plot;

use downbeat_executor::Snapshot;
use downbeat_robot::inspect::Client;

use super::choose::choose;
use super::cli::TopArguments;
use grid::{Grid, Sort, summary};

pub(crate) fn top(arguments: &TopArguments) -> anyhow::Result<()> {
    let mut client = Client::connect(&choose(arguments.robot.as_deref())?)?;
    let snapshot = client.snapshot()?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&snapshot)?);
        return Ok(());
    }
    if arguments.once {
        print_once(&client, &snapshot);
        return Ok(());
    }
    #[cfg(feature = "top")]
    return app::show(client, snapshot, &arguments.plot);
    #[cfg(not(feature = "top"))]
    super::not_built("top", "--once prints a snapshot, --json all numbers")
}

/// Rates are averages since the robot's start.
fn print_once(client: &Client, snapshot: &Snapshot) {
    let start = Snapshot::default();
    for line in summary(&client.robot().to_string(), &start, snapshot, usize::MAX) {
        println!("{line}");
    }
    let tables = [Grid::of_modules, Grid::of_topics, Grid::of_outlets];
    for grid in tables.map(|table| table(&start, snapshot, Sort::Order)) {
        println!();
        grid.lines().for_each(|line| println!("{line}"));
    }
}
