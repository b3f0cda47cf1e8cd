//! `downbeat bag record`

use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::Context;
use downbeat::bags::{Compression, Recording, TopicInfo, WriterOptions};
use downbeat::bridge::edge::KnownType;
use downbeat::bridge::middleware::{Direction, RemoteEndpoint, Sample};
use downbeat::bridge::ros::{MessageType, Node, Subscription, TopicName};
use downbeat::encoding::topic_info;
use downbeat::msgs::encoding::Encoding;
use downbeat::msgs::qos::QosProfile;
use downbeat::robot::{ClockChoice, RobotFile, RosArgs};

use crate::program::cli::RecordArguments;
use crate::program::run::node;
use crate::program::screen::Screen;
use crate::program::session::Session;
use crate::program::stop::Stop;

pub(crate) fn record(arguments: &RecordArguments, ros: &RosArgs, screen: &Screen) -> anyhow::Result<()> {
    let compression = if arguments.zstd { Compression::Zstd } else { Compression::None };
    match &arguments.robot {
        Some(robot) => {
            let mut file = RobotFile::read_with(robot, ros)?;
            // There is no node to hear `/clock` with.
            file.expose.features.clock = ClockChoice::Own;
            let mut session = Session::new(file)?;
            session.record(&arguments.output, arguments.zstd.then_some(compression), arguments.encoding)?;
            session.run(&Stop::new(arguments.duration)?, screen)
        }
        None => record_from_ros(arguments, compression, ros),
    }
}

/// How often new publishers are looked for until every topic has one: as `ros2 bag record`.
const POLL: Duration = Duration::from_millis(100);

/// Records topics as their publishers offer them. The type and the reliability of a topic are those of its first
/// publisher, which is waited for.
fn record_from_ros(
    arguments: &RecordArguments,
    compression: Compression,
    ros: &RosArgs,
) -> anyhow::Result<()> {
    let stop = Stop::new(arguments.duration)?;
    let (participant, node) = node("downbeat_bag_record", arguments.domain, ros)?;
    // As they were given, and as remapping rules have them.
    let names = arguments.topics.iter().map(|given| Ok((given, node.topic_name(given)?)));
    let mut awaited: Vec<(&String, TopicName)> = names.collect::<anyhow::Result<_>>()?;
    let writer = WriterOptions::new().compression(compression).create(&arguments.output)?;
    let recording = Recording::start(writer, Recording::DEFAULT_QUEUE_BYTES)
        .context("cannot start the thread that writes the bag")?;
    let encoding = arguments.encoding.unwrap_or_default();
    let mut subscriptions = Vec::new();
    while !stop.is_due() {
        let endpoints = if awaited.is_empty() { Vec::new() } else { participant.remote_endpoints() };
        for endpoint in endpoints.iter().filter(|endpoint| endpoint.direction == Direction::Out) {
            let position = awaited.iter().position(|(_, topic)| topic.to_wire() == endpoint.topic_name);
            if let Some((given, topic)) = position.map(|position| awaited.remove(position)) {
                match subscribe(&node, &recording, (given, &topic), endpoint, encoding) {
                    Ok(subscription) => subscriptions.push(subscription),
                    Err(error) => tracing::error!("{} is not recorded: {error:#}", topic.as_str()),
                }
            }
        }
        stop.sleep(POLL);
    }
    drop(subscriptions);
    for (_, topic) in &awaited {
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
    (given, topic): (&str, &TopicName),
    publisher: &RemoteEndpoint,
    encoding: Encoding,
) -> anyhow::Result<Subscription> {
    let name = topic.as_str();
    let message_type = MessageType::from_wire(&publisher.type_name)
        .with_context(|| format!("{name} has type {}, which is no ROS 2 message", publisher.type_name))?;
    let known = KnownType::named(message_type.as_str()).ok();
    if known.is_none() {
        tracing::warn!(
            "{name}: {} is not compiled in, so it is recorded as CDR and the bag will not say how to decode it",
            message_type.as_str()
        );
    }
    let hash = publisher.type_hash.clone().or_else(|| known.map(|known| known.hash().to_owned()));
    let (reliability, durability) = (publisher.reliability, publisher.durability);
    let qos = QosProfile { reliability, durability, ..QosProfile::DEFAULT.keep_last(DEPTH) };
    let sender = recording.sender();
    let (mut info, codec) = match known {
        Some(known) => topic_info(name.to_owned(), known, vec![qos.into()], encoding)?,
        None => {
            let (name, type_name) = (name.to_owned(), message_type.as_str().to_owned());
            (TopicInfo { name, type_name, offered_qos: vec![qos.into()], ..TopicInfo::default() }, None)
        }
    };
    info.type_hash = hash.unwrap_or_default();
    let id = sender.add_topic(info)?;
    tracing::info!("recording {name} [{}]", message_type.as_str());
    let on_sample = move |sample: Sample| {
        let received = system_time();
        let sent = sample.source_time_ns.unwrap_or(received);
        let data = match codec.as_ref().map(|codec| codec.encode(&sample.cdr)) {
            None => sample.cdr,
            Some(Ok(data)) => data.into(),
            Some(Err(error)) => return tracing::warn!("a message is not recorded: {error}"),
        };
        // Counted by the recording, which tells at the end.
        if let Err(error) = sender.record(id, received, sent, data) {
            tracing::debug!("{error}");
        }
    };
    Ok(node.subscribe(given, &message_type, qos, Box::new(on_sample))?)
}

/// Samples that wait in the middleware, for bursts.
const DEPTH: u32 = 1000;

fn system_time() -> i64 {
    let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(since_epoch.as_nanos()).unwrap_or(i64::MAX)
}
