//! Measures the grid of the published platform's Table II in one run: downbeat, the published design, and the
//! lower limit.

use std::io::{IsTerminal, Write as _};
use std::num::NonZeroU64;
use std::time::Duration;

use benches::measure::Effort;
use benches::table_ii::{CellResult, Row, goals, grid, measure, table};
use clap::Parser;

/// One publisher sends messages to modules. Each delivery calls a callback that adds a field of the message
/// to the state of the module.
///
/// Measured from the first publish to the last delivery, without setup. A trial publishes its messages in
/// batches, one per cycle, for all contestants alike. ratio_to_limit is the time of downbeat divided by that
/// of a plain loop over the callbacks; ratio_to_queue_design and ratio_to_published are the time of the
/// published design, measured here in its faster form, and its published time, each divided by that of
/// downbeat.
#[derive(Parser)]
#[command(verbatim_doc_comment)]
struct Arguments {
    /// Print a list of objects instead of a table
    #[arg(long)]
    json: bool,
    /// Measure for seconds instead of minutes, with more noise
    #[arg(long)]
    quick: bool,
    /// The largest number of messages per cycle
    #[arg(long, value_name = "NUMBER", default_value_t = BATCH)]
    batch: NonZeroU64,
    /// Measure only cells with this number of modules
    #[arg(long, value_name = "NUMBER")]
    modules: Option<u64>,
    /// Measure only cells with this number of messages
    #[arg(long, value_name = "NUMBER")]
    messages: Option<u64>,
}

/// Bounds the memory of the queues: their entries for 1000 modules take about 20 MB.
const BATCH: NonZeroU64 = NonZeroU64::new(1000).unwrap();

const FULL: Effort = Effort { rounds: 9, turn: Duration::from_millis(20), budget: Duration::from_secs(30) };
const QUICK: Effort = Effort { rounds: 3, turn: Duration::from_millis(5), budget: Duration::from_secs(1) };

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let effort = if arguments.quick { QUICK } else { FULL };
    let is_asked_for = |load: &benches::Load| {
        arguments.modules.is_none_or(|modules| modules == load.modules)
            && arguments.messages.is_none_or(|messages| messages == load.messages)
    };
    let mut results = Vec::new();
    for load in grid(arguments.batch).filter(is_asked_for) {
        if std::io::stderr().is_terminal() {
            eprintln!("measuring {} modules x {} messages", load.modules, load.messages);
        }
        results.push(measure(load, effort)?);
    }
    let text = if arguments.json {
        let rows: Vec<Row> = results.iter().flat_map(CellResult::rows).collect();
        serde_json::to_string_pretty(&rows)? + "\n"
    } else {
        table(&results, &goals(&results))
    };
    std::io::stdout().write_all(text.as_bytes())?;
    Ok(())
}
