//! The destination of a topic's messages.

use std::time::{Duration, Instant};

use crate::bags::metadata::RecordedQos;
use crate::bags::{Player, RecordedTopic, TopicInfo};
use crate::bridge::middleware::WriteError;
use crate::bridge::ros::{MessageType, Node, Publisher};
use crate::encoding::RecordedType;
use crate::msgs::qos::{Durability, QosProfile};
use crate::ros_recorder::QosOverrides;
use anyhow::bail;
use bytes::Bytes;
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};

use super::requests::{Requests, RequestsSource};
use crate::program::stop::Stop;

/// How long a message waits for slow subscribers, as in rmw_fastrtps (`max_blocking_time`).
const PATIENCE: Duration = Duration::from_millis(100);

/// Each topic takes memory in every node of the network.
const MOST_TOPICS: usize = 1000;
/// Files that the DDS engine opens for each publisher (a little more than two), and other open files of the
/// program.
const FILES_OF_PUBLISHER: u64 = 3;
const OTHER_FILES: u64 = 200;

/// The number of topics that a process can publish, after raising the limit of open files for `wanted` of
/// them.
fn most_topics(wanted: usize) -> usize {
    let mut limit = getrlimit(Resource::Nofile);
    let needed = OTHER_FILES + FILES_OF_PUBLISHER * wanted.min(MOST_TOPICS) as u64;
    if limit.current.is_some_and(|current| current < needed) {
        let raised = Rlimit { current: Some(limit.maximum.unwrap_or(needed).min(needed)), ..limit };
        if setrlimit(Resource::Nofile, raised).is_ok() {
            limit.current = raised.current;
        }
    }
    let files = limit.current.unwrap_or(u64::MAX).saturating_sub(OTHER_FILES);
    MOST_TOPICS.min(usize::try_from(files / FILES_OF_PUBLISHER).unwrap_or(usize::MAX))
}

/// The destination of one topic's messages.
#[expect(clippy::large_enum_variant, reason = "there is one for each topic, not for each message")]
pub(super) enum Target {
    /// Publishes them; the type converts other encodings to CDR.
    Topic(Publisher, Option<RecordedType>),
    /// Sends the requests in the events.
    Service(Requests),
}

/// Creates one for each played topic, at the position of its id; `None` if that fails, which is logged. With
/// `requests`, service events become requests again.
pub(super) fn targets(
    player: &Player<'_>,
    node: &Node,
    overrides: &QosOverrides,
    requests: Option<RequestsSource>,
    stop: &Stop,
) -> anyhow::Result<Vec<Option<Target>>> {
    let count = player.topics().len();
    let most = most_topics(count);
    if count > most {
        bail!(
            "the bag has {count} topics, but at most {most} can be played at a time; choose some with --topics, --regex or \
             --exclude-regex"
        );
    }
    let create = |topic: &RecordedTopic| -> anyhow::Result<Target> {
        let info = &topic.info;
        if let (Some(source), Some(_)) = (requests, Requests::service(info)) {
            return Ok(Target::Service(Requests::new(topic, source, node)?));
        }
        // CDR is passed through, also for types that are not compiled in.
        let recorded = info.format.as_ref().map(|_| RecordedType::of(topic, node.participant().interfaces()));
        let recorded = recorded.transpose()?;
        let type_name = recorded.as_ref().map_or(&*info.type_name, |recorded| recorded.message_type().name());
        let message_type = MessageType::new(type_name)?;
        let qos = overrides.of(&info.name).unwrap_or_else(|| recorded_qos(info));
        Ok(Target::Topic(node.publish(&info.name, &message_type, qos)?, recorded))
    };
    let create_or_tell = |topic| {
        let created =
            create(topic).inspect_err(|error| tracing::warn!("{} is not played: {error:#}", topic.info.name));
        created.ok()
    };
    let topics = player.topics().iter();
    Ok(topics.map(|topic| if stop.is_due() { None } else { create_or_tell(topic) }).collect())
}

impl Target {
    /// Whether a message would reach anyone now.
    pub(super) fn is_matched(&self) -> bool {
        match self {
            Self::Topic(publisher, _) => publisher.matched_subscriptions() > 0,
            Self::Service(requests) => requests.has_server(),
        }
    }

    /// Delivers a message; returns false if there was nothing to do.
    pub(super) fn take(&self, data: Bytes) -> anyhow::Result<bool> {
        match self {
            Self::Topic(publisher, recorded) => {
                let data = recorded.as_ref().map_or(Ok(data.clone()), |recorded| recorded.to_cdr(data))?;
                publish_soon(publisher, &data)?;
                Ok(true)
            }
            Self::Service(requests) => requests.send(data),
        }
    }
}

/// The QoS offered by all publishers; if they differ, one that matches most subscribers.
fn recorded_qos(info: &TopicInfo) -> QosProfile {
    let mut offered = info.offered_qos.iter().map(RecordedQos::to_profile);
    let first = offered.next().unwrap_or(QosProfile::DEFAULT);
    if offered.all(|other| other == first) {
        return first;
    }
    tracing::warn!("{}: its publishers offered different QoS; it is played reliably", info.name);
    let depth = info.latched_depth();
    match u32::try_from(depth) {
        Ok(0) | Err(_) => QosProfile::DEFAULT,
        Ok(depth) => {
            QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT.keep_last(depth) }
        }
    }
}

/// Publishes, waiting briefly for slow subscribers.
fn publish_soon(publisher: &Publisher, data: &Bytes) -> Result<(), WriteError> {
    let started = Instant::now();
    loop {
        match publisher.publish(data.clone()) {
            Err(WriteError::WindowFull) if started.elapsed() < PATIENCE => {
                std::thread::sleep(Duration::from_millis(1));
            }
            result => return result,
        }
    }
}
