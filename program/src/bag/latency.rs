//! `downbeat bag latency`

use std::path::PathBuf;
use std::time::Duration;

use anyhow::bail;
use clap::Args;
use downbeat_bags::Reader;
use downbeat_robot::Catalog;
use downbeat_robot::causes::{Ages, GuessedWay, Latency, Sample};
use serde_json::{Value, json};

use super::causes::{guess, offset, runs, topic};
use super::open;
use super::select::absolute;
use crate::statistics::short;

#[derive(Args)]
pub(crate) struct LatencyArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) bag: PathBuf,
    /// The topic at which the chain begins, such as that of a sensor.
    #[arg(long, value_name = "TOPIC")]
    pub(crate) from: String,
    /// The topic at which the chain ends, such as that of goals.
    #[arg(long, value_name = "TOPIC")]
    pub(crate) to: String,
    /// Also print how many messages have which age.
    #[arg(long)]
    pub(crate) histogram: bool,
    /// Print JSON.
    #[arg(long, conflicts_with = "histogram")]
    pub(crate) json: bool,
}

/// What is printed of the distribution, with the share of messages.
const QUANTILES: [(&str, f64); 5] = [("min", 0.0), ("p50", 0.5), ("p90", 0.9), ("p99", 0.99), ("max", 1.0)];

pub(crate) fn latency(arguments: &LatencyArguments, catalog: &Catalog) -> anyhow::Result<()> {
    let bag = open(&arguments.bag)?;
    let (from, to) = (absolute(&arguments.from), absolute(&arguments.to));
    if from == to {
        bail!("--from and --to are both {from}; a chain leads to another topic");
    }
    topic(&bag, &from)?;
    topic(&bag, &to)?;
    let Some(recorded) = runs(&bag, catalog)? else {
        let guess = guess(&bag, catalog)?;
        let (ages, without) = guess.ages(&from, &to);
        let worst = guess.oldest(&from, &to).map(Worst::Guessed);
        return print(arguments, &bag, &Measured { from, to, ages, reactions: None, without, worst });
    };
    let mut latency = Latency::new(&from[1..], &to[1..]);
    recorded.measure(&mut latency);
    let samples: Vec<_> = latency.take_samples().collect();
    let ages = Ages::new(samples.iter().map(|sample| (sample.age, sample.count)));
    let reactions = samples.iter().filter(|sample| sample.is_reaction).map(|sample| (sample.age, 1));
    let reactions = Some(Ages::new(reactions));
    let without = latency.without_origin();
    let worst = samples.into_iter().max_by_key(|sample| sample.age).map(Worst::Exact);
    print(arguments, &bag, &Measured { from, to, ages, reactions, without, worst })
}

struct Measured {
    from: String,
    to: String,
    ages: Ages,
    /// `None` if causes were guessed.
    reactions: Option<Ages>,
    /// Messages of `to` that depend on none of `from`.
    without: u64,
    worst: Option<Worst>,
}

/// The message with the greatest age.
enum Worst {
    Exact(Sample),
    Guessed(GuessedWay),
}

fn print(arguments: &LatencyArguments, bag: &Reader, measured: &Measured) -> anyhow::Result<()> {
    let Measured { from, to, ages, reactions, without, worst } = measured;
    if arguments.json {
        let worst = worst.as_ref().map(|worst| match worst {
            Worst::Exact(sample) => worst_as_json(sample),
            Worst::Guessed(way) => json!(way),
        });
        let output = json!({
            "from": from,
            "to": to,
            "is_exact": reactions.is_some(),
            "messages": ages.count() + without,
            "without_origin": without,
            "age_ns": as_json(ages),
            "reaction_ns": reactions.as_ref().map(as_json),
            "worst": worst,
        });
        println!("{}", serde_json::to_string_pretty(&output)?);
        return Ok(());
    }
    let messages = ages.count() + without;
    println!("{messages} messages on {to}, {without} of which come from none on {from}");
    if ages.count() == 0 {
        let reason = match reactions {
            Some(_) => "no chain of runs leads from one topic to the other",
            None => "no message of one topic has the header.stamp of one of the other",
        };
        bail!("nothing to measure: {reason}");
    }
    println!("age of the newest {from} in each   {}", shown(ages));
    if let Some(reactions) = reactions {
        println!("time until the first that has it  {}", shown(reactions));
    }
    if arguments.histogram {
        histogram(ages);
    }
    match worst {
        Some(Worst::Exact(sample)) => print_worst(bag, measured, sample),
        Some(Worst::Guessed(way)) => print_guessed(bag, measured, way),
        None => {}
    }
    Ok(())
}

fn shown(ages: &Ages) -> String {
    let shown = QUANTILES.map(|(name, share)| {
        ages.quantile(share).map(|age| format!("{name} {}", short(age))).unwrap_or_default()
    });
    shown.join("  ")
}

fn as_json(ages: &Ages) -> Value {
    let nanoseconds = |share| ages.quantile(share).map(|age| age.as_nanos() as u64);
    QUANTILES.iter().map(|&(name, share)| (name.to_owned(), json!(nanoseconds(share)))).collect()
}

fn worst_as_json(worst: &Sample) -> Value {
    let hops = worst.hops();
    let hops = hops.iter().map(|hop| {
        json!({
            "by": &*hop.by,
            "sent_ns": hop.sent.as_nanos(),
            "received_ns": hop.received.as_nanos(),
            "module": &*hop.module,
            "published_ns": hop.published.as_nanos(),
        })
    });
    json!({
        "time_ns": worst.time.as_nanos(),
        "age_ns": worst.age.as_nanos() as u64,
        "hops": hops.collect::<Vec<_>>(),
    })
}

/// The oldest message, and where the time went.
fn print_worst(bag: &Reader, Measured { to, .. }: &Measured, worst: &Sample) {
    println!("the oldest is in {to} at {}:", offset(bag, worst.time.as_nanos()));
    for hop in worst.hops() {
        let waited = short(hop.received.saturating_since(hop.sent));
        let held = short(hop.published.saturating_since(hop.received));
        let (by, module) = (&hop.by, &hop.module);
        println!(
            "  /{by} at {} waited {waited} for {module}, which kept it {held}",
            offset(bag, hop.sent.as_nanos())
        );
    }
}

/// The same by the times of recording, which do not tell waiting from work.
fn print_guessed(bag: &Reader, Measured { to, .. }: &Measured, way: &GuessedWay) {
    println!(
        "the oldest is in {to} at {}; where its stamp was, by the times of recording, in which waiting is not told from work:",
        offset(bag, way.time_ns)
    );
    for ((topic, time), (next, until)) in way.passed.iter().zip(way.passed.iter().skip(1)) {
        let took = short(Duration::from_nanos(until.saturating_sub(*time).unsigned_abs()));
        println!("  {topic} at {}, {took} until {next}", offset(bag, *time));
    }
}

/// How wide the longest bar of a histogram is.
const WIDTH: u64 = 50;
const BARS: u32 = 20;

/// Prints bars of equal width in time.
fn histogram(ages: &Ages) {
    let (Some(least), Some(most)) = (ages.quantile(0.0), ages.quantile(1.0)) else { return };
    let step = ((most - least) / BARS).max(Duration::from_nanos(1));
    let mut counts = [0_u64; BARS as usize + 1];
    for (age, count) in ages.iter() {
        let bar = (age - least).as_nanos() / step.as_nanos();
        let bar = usize::try_from(bar).unwrap_or(usize::MAX).min(counts.len() - 1);
        counts[bar] += u64::from(count);
    }
    let largest = counts.iter().copied().max().unwrap_or(1).max(1);
    let used = counts.iter().rposition(|count| *count > 0).unwrap_or(0);
    for (bar, count) in (0..).zip(&counts[..=used]) {
        let length = usize::try_from((count * WIDTH).div_ceil(largest)).unwrap_or(0);
        println!("  from {:>8} {count:>8} {}", short(least + step * bar), "#".repeat(length));
    }
}
