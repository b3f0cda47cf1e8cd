//! Compares downbeat with other libraries that pass messages within a process, in one run and on one thread:
//! the cost of transport and dispatch, without the scheduler.

mod channels;
mod copper;
mod iceoryx;

use std::num::NonZeroU64;
use std::time::Duration;

use anyhow::ensure;
use benches::Load;
use benches::contestants::{Contestant, Downbeat, Limit};
use benches::launchers::{LAUNCHERS, LINEAR};
use benches::measure::{Effort, best_of_rounds};
use clap::Parser;

/// Fan-out and hop of downbeat (Linear) and of its peers.
#[derive(Parser)]
struct Arguments {
    /// Measure for seconds, with more noise
    #[arg(long)]
    quick: bool,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let effort = Effort {
        rounds: if arguments.quick { 3 } else { 15 },
        turn: Duration::from_millis(20),
        budget: Duration::from_secs(10),
    };
    let batch = NonZeroU64::new(1000).unwrap_or(NonZeroU64::MIN);
    for (title, modules, messages) in [
        ("hop, 1 message to 1 module", 1, 1),
        ("fan-out", 10, 100),
        ("fan-out", 10, 1000),
        ("fan-out", 100, 1000),
    ] {
        println!(
            "{title}: {modules} modules x {messages} messages of {} bytes",
            size_of::<benches::Reading>()
        );
        compare(Load { modules, messages, batch }, effort)?;
    }
    Ok(())
}

fn compare(load: Load, effort: Effort) -> anyhow::Result<()> {
    let mut names = vec!["limit"];
    let mut contestants: Vec<Box<dyn Contestant>> = vec![Box::new(Limit::new(load))];
    for launcher in LAUNCHERS.iter().filter(|launcher| launcher.name == LINEAR) {
        names.push("downbeat");
        contestants.push(Box::new(Downbeat::new(load, launcher)?));
    }
    names.extend(["crossbeam channels", "tokio broadcast", "iceoryx2, local"]);
    contestants.push(Box::new(channels::Crossbeam::new(load)));
    contestants.push(Box::new(channels::Tokio::new(load)));
    contestants.push(Box::new(iceoryx::Iceoryx::new(load)?));
    if let Some(copper) = copper::for_load(load)? {
        names.push("Copper");
        contestants.push(copper);
    }
    let times = best_of_rounds(&mut contestants, effort);
    let downbeat = times[1].as_secs_f64();
    println!("  {:<20} {:>12} {:>12} {:>12}", "", "µs", "ns/delivery", "to downbeat");
    for (name, time) in names.iter().zip(&times) {
        let seconds = time.as_secs_f64();
        let ns = seconds * 1e9 / load.deliveries() as f64;
        println!("  {name:<20} {:>12.3} {ns:>12.2} {:>11.2}x", seconds * 1e6, seconds / downbeat);
    }
    println!();
    for (name, contestant) in names.iter().zip(contestants) {
        let (sum, of_a_trial) = (contestant.finish(), load.expected_sum());
        let is_whole = sum > 0 && sum.is_multiple_of(of_a_trial);
        ensure!(
            is_whole,
            "{name}: the sums add up to {sum}, not to a multiple of {of_a_trial}: messages were lost"
        );
    }
    Ok(())
}
