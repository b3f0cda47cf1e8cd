//! Measures pairs of processes, one pair after the other.

use anyhow::Context;

use crate::contestant::{Contestant, Kind, Task};
use crate::peer::Outcome;
use crate::role::Role;

#[derive(clap::Args)]
pub struct Options {
    /// How long each pair sends.
    #[arg(long, default_value_t = 5.0)]
    seconds: f64,
    /// Number of rounds; the median of the rounds counts.
    #[arg(long, default_value_t = 3)]
    rounds: usize,
    /// Bytes of a message.
    #[arg(long, value_delimiter = ',', default_values_t = [100, 10_000, 1_000_000])]
    sizes: Vec<usize>,
    /// The ROS domain.
    #[arg(long, default_value_t = 100)]
    domain: u16,
    /// Print a list of objects instead of a table.
    #[arg(long)]
    json: bool,
}

/// The end that sends and the end that answers.
const PAIRS: [(Kind, Kind); 5] = [
    (Kind::Downbeat, Kind::Downbeat),
    (Kind::Downbeat, Kind::Rclpy),
    (Kind::Rclpy, Kind::Downbeat),
    (Kind::Rclpy, Kind::Rclpy),
    (Kind::Cyclone, Kind::Cyclone),
];

/// Number of messages in flight when throughput is measured.
const WINDOW: usize = 16;

/// The results of one pair with one message size.
#[derive(serde::Serialize)]
struct Row {
    bytes: usize,
    from: &'static str,
    to: &'static str,
    round_trip_p50_us: f64,
    round_trip_p99_us: f64,
    messages_per_second: f64,
    lost: u64,
    /// Processor time of both processes for 1000 sequential round trips.
    processor_ms_per_1000: f64,
}

struct Turn {
    outcome: Outcome,
    processor_ms: f64,
}

pub fn run(options: &Options) -> anyhow::Result<()> {
    anyhow::ensure!(options.rounds > 0, "--rounds must be at least 1");
    let mut rows = Vec::new();
    if !options.json {
        print_head();
    }
    for &bytes in &options.sizes {
        for pair in PAIRS {
            let row = measure(pair, bytes, options)
                .with_context(|| format!("{} to {}, {bytes} bytes", pair.0.name(), pair.1.name()))?;
            if !options.json {
                print_row(&row);
            }
            rows.push(row);
        }
    }
    if options.json {
        println!("{}", serde_json::to_string_pretty(&rows)?);
    }
    Ok(())
}

fn measure(pair: (Kind, Kind), size: usize, options: &Options) -> anyhow::Result<Row> {
    let task = |window| Task { size, window, seconds: options.seconds, domain_id: options.domain };
    let turns = |role, window| -> anyhow::Result<Vec<Turn>> {
        (0..options.rounds).map(|_| turn(pair, role, &task(window))).collect()
    };
    let (trips, streams) = (turns(Role::Echo, 1)?, turns(Role::Acknowledge, WINDOW)?);
    let of_trips = |figure: fn(&Turn) -> f64| median(trips.iter().map(figure));
    let rate = |turn: &Turn| turn.outcome.messages as f64 / turn.outcome.seconds.max(f64::MIN_POSITIVE);
    Ok(Row {
        bytes: size,
        from: pair.0.name(),
        to: pair.1.name(),
        round_trip_p50_us: of_trips(|turn| turn.outcome.p50_us),
        round_trip_p99_us: of_trips(|turn| turn.outcome.p99_us),
        messages_per_second: median(streams.iter().map(rate)),
        lost: trips.iter().chain(&streams).map(|turn| turn.outcome.lost).sum(),
        processor_ms_per_1000: of_trips(|turn| {
            turn.processor_ms * 1000.0 / turn.outcome.messages.max(1) as f64
        }),
    })
}

fn turn((from, to): (Kind, Kind), role: Role, task: &Task) -> anyhow::Result<Turn> {
    let other = Contestant::start(to, role, task)?;
    let mut sender = Contestant::start(from, Role::Ping, task)?;
    sender.wait_for_go()?;
    let processor_time =
        |sender: &Contestant| anyhow::Ok((sender.processor_time()? + other.processor_time()?).as_secs_f64());
    let before = processor_time(&sender)?;
    let outcome = sender.outcome()?;
    // The sender has printed its outcome and does no more work: it waits for the end of its input, or is
    // about to end.
    let after = processor_time(&sender).unwrap_or(before);
    sender.end()?;
    other.end()?;
    Ok(Turn { outcome, processor_ms: (after - before) * 1e3 })
}

fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or_default()
}

fn print_head() {
    println!(
        "| bytes | from | to | round trip p50 | p99 | messages/s, {WINDOW} in flight | lost | processor ms per 1000 round trips |"
    );
    println!("| --- | --- | --- | --- | --- | --- | --- | --- |");
}

fn print_row(row: &Row) {
    let Row { bytes, from, to, round_trip_p50_us, round_trip_p99_us, messages_per_second, lost, .. } = row;
    // There is no time if nothing came back.
    let time = |us: &f64| if *us > 0.0 { format!("{us:.0} µs") } else { "none".to_owned() };
    let (p50, p99) = (time(round_trip_p50_us), time(round_trip_p99_us));
    println!(
        "| {bytes} | {from} | {to} | {p50} | {p99} | {messages_per_second:.0} | {lost} | {:.0} |",
        row.processor_ms_per_1000
    );
}
