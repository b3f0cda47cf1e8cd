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
use downbeat_robot::ChainReport;
use downbeat_robot::inspect::Client;

use super::choose::choose;
use super::cli::TopArguments;
use grid::{Grid, Sort, summary};

pub(crate) fn top(arguments: &TopArguments) -> anyhow::Result<()> {
    let mut client = Client::connect(&choose(arguments.robot.as_deref())?)?;
    let snapshot = client.snapshot()?;
    if arguments.json {
        let mut numbers = serde_json::to_value(&snapshot)?;
        // A robot of an earlier version measures none.
        numbers["latencies"] = serde_json::to_value(client.latencies().unwrap_or_default())?;
        println!("{}", serde_json::to_string_pretty(&numbers)?);
        return Ok(());
    }
    // A robot of an earlier version measures none.
    let chains = client.latencies().unwrap_or_default();
    if arguments.once {
        print_once(&client, &snapshot, &chains);
        return Ok(());
    }
    #[cfg(feature = "top")]
    return app::show(client, snapshot, &arguments.plot);
    #[cfg(not(feature = "top"))]
    super::not_built("top", "--once prints a snapshot, --json all numbers")
}

/// Rates are averages since the robot's start.
fn print_once(client: &Client, snapshot: &Snapshot, chains: &[ChainReport]) {
    let start = Snapshot::default();
    for line in summary(&client.robot().to_string(), &start, snapshot, usize::MAX) {
        println!("{line}");
    }
    let tables = [Grid::of_modules, Grid::of_topics, Grid::of_outlets];
    let tables = tables.map(|table| table(&start, snapshot, Sort::Order)).into_iter();
    let chains = (!chains.is_empty()).then(|| Grid::of_latencies(chains));
    for grid in tables.chain(chains) {
        println!();
        grid.lines().for_each(|line| println!("{line}"));
    }
}
