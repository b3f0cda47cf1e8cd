//! `downbeat bag record`

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::Context;
use downbeat::bags::{Compression, Recording, TopicInfo, WriterOptions};
use downbeat::bridge::edge::KnownType;
use downbeat::bridge::middleware::{Direction, RemoteEndpoint, Sample};
use downbeat::bridge::ros::{MessageType, Node, NodeName, Participant, Subscription, TopicName};
use downbeat::msgs::qos::QosProfile;
use downbeat::robot::RobotFile;

use crate::program::cli::RecordArguments;
use crate::program::run::participant_options;
use crate::program::screen::Screen;
use crate::program::session::Session;
use crate::program::stop::Stop;

pub(crate) fn record(arguments: &RecordArguments, screen: &Screen) -> anyhow::Result<()> {
    let compression = if arguments.zstd { Compression::Zstd } else { Compression::None };
    match &arguments.robot {
        Some(robot) => {
            let mut session = Session::new(RobotFile::read(robot)?)?;
            session.record(&arguments.output, arguments.zstd.then_some(compression))?;
            session.run(&Stop::new(arguments.duration)?, screen)
        }
        None => record_from_ros(arguments, compression),
    }
}

/// How often new publishers are looked for until every topic has one: as `ros2 bag record`.
const POLL: Duration = Duration::from_millis(100);

/// Records topics as their publishers offer them. The type and the reliability of a topic are those of its first
/// publisher, which is waited for.
fn record_from_ros(arguments: &RecordArguments, compression: Compression) -> anyhow::Result<()> {
    let stop = Stop::new(arguments.duration)?;
    let participant = Participant::join(&participant_options(arguments.domain)?)?;
    let node = participant.create_node(NodeName::new("/", "downbeat_bag_record")?)?;
    let mut awaited: Vec<TopicName> = arguments
        .topics
        .iter()
        .map(|topic| TopicName::expand(topic, node.name()))
        .collect::<Result<_, _>>()?;
    let writer = WriterOptions::new().compression(compression).create(&arguments.output)?;
    let recording = Recording::start(writer, Recording::DEFAULT_QUEUE_BYTES)
        .context("cannot start the thread that writes the bag")?;
    let mut subscriptions = Vec::new();
    while !stop.is_due() {
        let endpoints = if awaited.is_empty() { Vec::new() } else { participant.remote_endpoints() };
        for endpoint in endpoints.iter().filter(|endpoint| endpoint.direction == Direction::Out) {
            let position = awaited.iter().position(|topic| topic.to_wire() == endpoint.topic_name);
            if let Some(topic) = position.map(|position| awaited.remove(position)) {
                match subscribe(&node, &recording, &topic, endpoint) {
                    Ok(subscription) => subscriptions.push(subscription),
                    Err(error) => tracing::error!("{} is not recorded: {error:#}", topic.as_str()),
                }
            }
        }
        stop.sleep(POLL);
    }
    drop(subscriptions);
    for topic in &awaited {
        tracing::warn!("nothing is recorded of {}: nobody published it", topic.as_str());
    }
    let summary = recording.finish()?;
    let (messages, lost) = (summary.message_count(), summary.lost_count());
    println!("recorded {messages} messages, lost {lost}, in {}", summary.path.display());
    Ok(())
}

fn subscribe(
    node: &Node,
    recording: &Recording,
    topic: &TopicName,
    publisher: &RemoteEndpoint,
) -> anyhow::Result<Subscription> {
    let name = topic.as_str();
    let message_type = MessageType::from_wire(&publisher.type_name)
        .with_context(|| format!("{name} has type {}, which is no ROS 2 message", publisher.type_name))?;
    let known = KnownType::named(message_type.as_str()).ok();
    if known.is_none() {
        tracing::warn!(
            "{name}: {} is not compiled in, so the bag will not say how to decode it",
            message_type.as_str()
        );
    }
    let hash = publisher.type_hash.clone().or_else(|| known.map(|known| known.hash().to_owned()));
    let (reliability, durability) = (publisher.reliability, publisher.durability);
    let qos = QosProfile { reliability, durability, ..QosProfile::DEFAULT.keep_last(DEPTH) };
    let sender = recording.sender();
    let id = sender.add_topic(TopicInfo {
        name: name.to_owned(),
        type_name: message_type.as_str().to_owned(),
        definition: known.map(KnownType::definition).unwrap_or_default().to_owned(),
        type_hash: hash.unwrap_or_default(),
        offered_qos: vec![qos],
    })?;
    tracing::info!("recording {name} [{}]", message_type.as_str());
    let on_sample = move |sample: Sample| {
        let received = system_time();
        let sent = sample.source_time_ns.unwrap_or(received);
        // Counted by the recording, which tells at the end.
        if let Err(error) = sender.record(id, received, sent, sample.cdr) {
            tracing::debug!("{error}");
        }
    };
    Ok(node.subscribe(name, &message_type, qos, Box::new(on_sample))?)
}

/// Samples that wait in the middleware, for bursts.
const DEPTH: u32 = 1000;

fn system_time() -> i64 {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX)
}
