//! `downbeat bag diff`

use std::path::PathBuf;

use anyhow::bail;
use clap::Args;
use serde_json::{Value, json};

use super::open;
use super::output::Progress;
use downbeat_bags::{
    BagDiff, DiffOptions, FieldDifference, FieldRule, MessageDiff, MessageDiffKind, Reader, TopicDiff,
    diff as diff_bags,
};
use downbeat_executor::Time;

#[derive(Args)]
pub(crate) struct DiffArguments {
    /// A rosbag2 directory or a single file.
    pub(crate) first: PathBuf,
    /// The one to compare it with, topic by topic, message by message.
    pub(crate) second: PathBuf,
    /// Tolerance for numbers: "joint_states:position=1e-6", "imu/*=0.1%"; without a topic it applies
    /// everywhere. May be given more than once; the last one that matches a field applies.
    #[arg(long, value_name = "[TOPIC][:FIELD]=AMOUNT", value_parser = FieldRule::tolerance)]
    pub(crate) tolerance: Vec<FieldRule>,
    /// Do not compare this: "diagnostics", "imu/data_raw:header.stamp", ":header.stamp". May be given more
    /// than once.
    #[arg(long, value_name = "[TOPIC][:FIELD]", value_parser = FieldRule::ignore)]
    pub(crate) ignore: Vec<FieldRule>,
    /// Also compare the receive times of messages.
    #[arg(long)]
    pub(crate) times: bool,
    /// Print what was found as JSON.
    #[arg(long)]
    pub(crate) json: bool,
}

pub(crate) fn diff(arguments: &DiffArguments) -> anyhow::Result<()> {
    let [first, second] = [open(&arguments.first)?, open(&arguments.second)?];
    let rules = arguments.tolerance.iter().chain(&arguments.ignore).cloned().collect();
    let options = DiffOptions { rules, compares_times: arguments.times };
    let mut progress = Progress::new("comparing", first.message_count() + second.message_count());
    let found = diff_bags(&first, &second, &options, |read| progress.at(read))?;
    drop(progress);
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&as_json(&found))?);
    } else {
        print_text(&found, &first);
    }
    if !found.is_same() {
        bail!("the bags differ");
    }
    Ok(())
}

fn print_text(found: &BagDiff, first: &Reader) {
    for unreadable in &found.unreadable {
        println!("{unreadable}");
    }
    for topic in found.topics.iter().filter(|topic| !topic.is_same()) {
        println!("{topic}");
    }
    if let Some((TopicDiff { topic, .. }, MessageDiff { number, time, what })) = found.first_difference() {
        let into = time.saturating_sub(first.start_time().unwrap_or(0)) as f64 / 1e9;
        println!("\nfirst difference: {}, {into:.6} s into the first bag", Time::from_nanos(*time));
        println!("  {topic} message {number}");
        match what {
            MessageDiffKind::Field(FieldDifference { path, first, second }) => {
                println!("  {path}\n    first  {first}\n    second {second}");
            }
            MessageDiffKind::Time(other) => {
                let (first, second) = (Time::from_nanos(*time), Time::from_nanos(*other));
                println!("  receive time\n    first  {first}\n    second {second}");
            }
        }
    }
    if found.is_same() {
        let messages: u64 = found.topics.iter().map(|topic| topic.compared).sum();
        println!("{messages} messages on {} topics are the same", found.topics.len());
    }
}

fn as_json(found: &BagDiff) -> Value {
    let side = |side: &Option<(String, u64)>| {
        side.as_ref().map(|(type_name, messages)| json!({ "type": type_name, "messages": messages }))
    };
    let difference = |difference: &MessageDiff| {
        let what = match &difference.what {
            MessageDiffKind::Field(FieldDifference { path, first, second }) => {
                json!({ "field": path, "first": first, "second": second })
            }
            MessageDiffKind::Time(time) => json!({ "second_time_ns": time }),
        };
        json!({ "message": difference.number, "time_ns": difference.time, "what": what })
    };
    let topics = found.topics.iter().map(|topic| {
        json!({
            "topic": topic.topic,
            "first": side(&topic.first),
            "second": side(&topic.second),
            "compared": topic.compared,
            "different": topic.different,
            "first_difference": topic.difference.as_ref().map(difference),
        })
    });
    json!({
        "is_same": found.is_same(),
        "topics": topics.collect::<Vec<_>>(),
        "unreadable": found.unreadable,
    })
}
