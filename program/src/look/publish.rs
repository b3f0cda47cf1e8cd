//! `downbeat topic pub`

use std::path::PathBuf;
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use clap::Args;
use downbeat_bridge::middleware::Direction;
use downbeat_bridge::ros::{MessageType, Publisher};
use downbeat_msgs::builtin_interfaces::msg::Time;
use downbeat_msgs::dynamic::DynamicMessage;

use super::clock::LookClock;
use super::definitions::{Types, full_name};
use super::network::{Environment, Look, LookArguments};
use super::qos::{Preset, QosArguments};
use super::values::{FieldArguments, period, positive, seconds};

#[derive(Args)]
pub(crate) struct PublishArguments {
    /// The topic.
    topic: String,
    /// The type of its messages, for example std_msgs/msg/String.
    #[arg(value_name = "TYPE")]
    type_name: String,
    #[command(flatten)]
    fields: FieldArguments,
    /// Publish this many messages per second.
    #[arg(short, long, value_name = "HZ", default_value = "1", value_parser = positive)]
    rate: f64,
    /// Print only every n-th message; 0 prints none.
    #[arg(short, long, value_name = "N", default_value_t = 1)]
    print: u64,
    /// Publish one message and exit.
    #[arg(short = '1', long, conflicts_with = "times")]
    once: bool,
    /// Publish this many messages and exit; 0 continues until Ctrl-C.
    #[arg(short, long, value_name = "N", default_value_t = 0)]
    times: u64,
    /// Wait until this many subscriptions match; default is 1 with --once and --times, else 0.
    #[arg(short, long, value_name = "N")]
    wait_matching_subscriptions: Option<usize>,
    /// Wait for them at most this long: seconds, or with a unit.
    #[arg(long, value_name = "SECONDS", value_parser = seconds)]
    max_wait_time_secs: Option<Duration>,
    /// Keep the node this long after the last message: seconds, or with a unit.
    #[arg(long, value_name = "SECONDS", default_value = "0.1", value_parser = seconds)]
    keep_alive: Duration,
    /// The name of the node.
    #[arg(short, long, value_name = "NAME")]
    node_name: Option<String>,
    /// Search definitions here first: an ament prefix, a folder of packages, or a package.
    #[arg(long, value_name = "PATH")]
    from: Vec<PathBuf>,
    #[command(flatten)]
    qos: QosArguments,
    #[command(flatten)]
    look: LookArguments,
}

const POLL: Duration = Duration::from_millis(20);
const SECOND: Duration = Duration::from_secs(1);

pub(super) fn publish(arguments: &PublishArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let times = if arguments.once { 1 } else { arguments.times };
    let wanted = arguments.wait_matching_subscriptions.unwrap_or(usize::from(times != 0));
    if wanted == 0 && arguments.max_wait_time_secs.is_some() {
        bail!(
            "--max-wait-time-secs option is only effective with --wait-matching-subscriptions, --once or --times"
        );
    }
    let (period, yaml) = (period(arguments.rate)?, arguments.fields.read()?);
    let LookArguments { network, spin_time, .. } = &arguments.look;
    let look = match &arguments.node_name {
        Some(name) => Look::join_as(name, network, *spin_time, environment)?,
        None => Look::join("topic", &arguments.look, environment)?,
    };
    let type_name = full_name(&arguments.type_name, "msg");
    let message_type = MessageType::new(&type_name).context("The passed message type is invalid")?;
    let types = Types::load(&look, &arguments.from)?;
    let of =
        types.message(&look, &arguments.topic, &type_name).context("The passed message type is invalid")?;
    let mut message = DynamicMessage::new(&of);
    let stamps = message.fill_yaml(&yaml).context("Failed to populate field")?;
    let (clock, _follower) = LookClock::new(&look, arguments.look.use_sim_time)?;
    let request = arguments.qos.request(Preset::Default);
    let qos = look.node.resolve_qos(&arguments.topic, Direction::Out, &request)?;
    let publisher = look.node.publish(&arguments.topic, &message_type, qos)?;
    wait_for_subscriptions(&look, &publisher, wanted, arguments.max_wait_time_secs)?;

    println!("publisher: beginning loop");
    let (mut count, mut next) = (0, Instant::now());
    while !look.stop.is_due() {
        stamps.set(&mut message, Time::from_nanos(clock.now()))?;
        count += 1;
        if arguments.print > 0 && count % arguments.print == 0 {
            println!("publishing #{count}: {}\n", message.as_message().to_python_repr());
        }
        publisher.publish(message.to_cdr().into())?;
        if count == times {
            break;
        }
        // Missed messages are not made up for.
        next = (next + period).max(Instant::now());
        look.stop.sleep(next.saturating_duration_since(Instant::now()));
    }
    look.stop.sleep(arguments.keep_alive);
    publisher.wait_for_all_acked(SECOND);
    Ok(())
}

fn wait_for_subscriptions(
    look: &Look,
    publisher: &Publisher,
    wanted: usize,
    longest: Option<Duration>,
) -> anyhow::Result<()> {
    let begin = Instant::now();
    let mut reported = None;
    while publisher.matched_subscriptions() < wanted && !look.stop.is_due() {
        if reported.is_none_or(|reported: Instant| reported.elapsed() >= SECOND) {
            println!("Waiting for at least {wanted} matching subscription(s)...");
            reported = Some(Instant::now());
        }
        if longest.is_some_and(|longest| begin.elapsed() >= longest) {
            let found = publisher.matched_subscriptions();
            bail!(
                "Timed out waiting for subscribers: Expected {wanted} subcribers but only got {found} subscribers"
            );
        }
        look.stop.sleep(POLL);
    }
    Ok(())
}
