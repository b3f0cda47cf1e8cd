//! The destination of a topic's messages.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use anyhow::{Context, bail};
use bytes::Bytes;
use clap::ValueEnum;

use crate::stop::Stop;
use crate::system;
use downbeat_bags::metadata::RecordedQos;
use downbeat_bags::{Player, RecordedTopic, TopicDescription};
use downbeat_bridge::limiter::Limiter;
use downbeat_bridge::middleware::WriteError;
use downbeat_bridge::ros::{MessageType, Node, Publisher, RawClient, ServiceType};
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::service_msgs::msg::ServiceEventInfo;
use downbeat_robot::encoding::RecordedType;
use downbeat_robot::ros_recorder::QosOverrides;
use downbeat_robot::table::Decoder;

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
    let needed = OTHER_FILES + FILES_OF_PUBLISHER * wanted.min(MOST_TOPICS) as u64;
    let files = system::raise_open_files(needed).saturating_sub(OTHER_FILES);
    MOST_TOPICS.min(usize::try_from(files / FILES_OF_PUBLISHER).unwrap_or(usize::MAX))
}

/// The destination of one topic's messages.
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
        let recorded = (!info.is_cdr()).then(|| RecordedType::of(topic, node.participant().interfaces()));
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
    /// Returns whether a message would reach anyone now.
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
fn recorded_qos(info: &TopicDescription) -> QosProfile {
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

/// Which recorded requests are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
#[value(rename_all = "snake_case")]
pub(crate) enum RequestsSource {
    /// Those that the server received.
    #[default]
    ServiceIntrospection,
    /// Those that the clients sent.
    ClientIntrospection,
}

impl RequestsSource {
    fn event_type(self) -> u8 {
        match self {
            Self::ServiceIntrospection => ServiceEventInfo::REQUEST_RECEIVED,
            Self::ClientIntrospection => ServiceEventInfo::REQUEST_SENT,
        }
    }
}

/// Sends the requests in the events of a service.
pub(super) struct Requests {
    client: RawClient,
    decoder: Decoder,
    event_type: u8,
    unanswered: Arc<AtomicUsize>,
    /// Limits messages about requests that are not sent or not answered.
    failures: Arc<Limiter>,
    /// Whether the missing requests in events have been reported.
    has_told: AtomicBool,
}

/// The suffixes of the event topic and the event type of a service.
const TOPIC_ENDING: &str = "/_service_event";
const TYPE_ENDING: &str = "_Event";

/// How long to wait for responses, so that the last ones arrive before the player exits.
const TIMEOUT: Duration = Duration::from_secs(5);

impl Requests {
    /// The name and type of the service whose events a topic carries.
    pub(super) fn service(topic: &TopicDescription) -> Option<(&str, &str)> {
        Some((topic.name.strip_suffix(TOPIC_ENDING)?, topic.type_name.strip_suffix(TYPE_ENDING)?))
    }

    pub(super) fn new(topic: &RecordedTopic, source: RequestsSource, node: &Node) -> anyhow::Result<Self> {
        let (service, type_name) = Self::service(&topic.info).context("it has no service events")?;
        let client = node.client_raw(service, &ServiceType::new(type_name)?, QosProfile::SERVICES)?;
        Ok(Self {
            client,
            decoder: Decoder::of(topic, node.participant().interfaces())?,
            event_type: source.event_type(),
            unanswered: Arc::default(),
            failures: Arc::default(),
            has_told: AtomicBool::new(false),
        })
    }

    fn has_server(&self) -> bool {
        self.client.is_available()
    }

    /// Returns whether a response is pending.
    pub(super) fn is_unanswered(&self) -> bool {
        self.unanswered.load(Ordering::Relaxed) > 0
    }

    /// Sends the request in an event; returns false if the event has none from the selected source, or there
    /// is no server.
    pub(super) fn send(&self, event: Bytes) -> anyhow::Result<bool> {
        let event = self.decoder.decode(event)?;
        if event.get("info.event_type")?.as_u64() != Some(self.event_type.into()) {
            return Ok(false);
        }
        let service = self.client.name();
        let requests = event.get("request")?;
        let Some(request) = requests.as_array().and_then(|requests| requests.get(0)?.as_message()) else {
            if !self.has_told.swap(true, Ordering::Relaxed) {
                tracing::warn!(
                    "{service}: its events were recorded without requests; set introspection to \"contents\" for that"
                );
            }
            return Ok(false);
        };
        if !self.has_server() {
            if let Some(left_out) = self.failures.allow() {
                tracing::warn!("{service}: there is no server; a request is not sent{left_out}");
            }
            return Ok(false);
        }
        let (name, unanswered) = (service.to_string(), Arc::clone(&self.unanswered));
        let failures = Arc::clone(&self.failures);
        unanswered.fetch_add(1, Ordering::Relaxed);
        self.client.call(request.to_message().to_cdr().into(), TIMEOUT, move |answer| {
            unanswered.fetch_sub(1, Ordering::Relaxed);
            if let Err(error) = answer
                && let Some(left_out) = failures.allow()
            {
                tracing::warn!("{name}: {error}{left_out}");
            }
        });
        Ok(true)
    }
}
