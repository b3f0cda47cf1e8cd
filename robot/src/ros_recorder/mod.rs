//! Recording ROS 2 topics from the network, of types that this program may never have seen.
//!
//! A [`RosRecorder`] looks which topics there are ([`TopicFilter`]), subscribes to each as its publishers
//! offer it ([`QosOverrides`] aside), finds the definition of its type, and gives its messages to a
//! [`Recording`](downbeat_bags::Recording). [`serve`] lets others pause and split it, as they do with the
//! recorder of rosbag2.

mod channel;
mod definitions;
mod filter;
mod offers;
mod qos_overrides;
mod services;
mod watch;

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicI64, Ordering};
use std::time::{Duration, Instant};

use downbeat_bags::{RecordError, RecordingControl, RecordingSender, TopicDescription};
use downbeat_bridge::middleware::{Direction, RemoteEndpoint, Sample};
use downbeat_bridge::ros::{MessageType, Node, NodeError, Participant, Subscription, TopicName};
use downbeat_msgs::encoding::{self, Encoding};
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rosgraph_msgs::msg::Clock;
use downbeat_msgs::{Message, cdr};

use crate::encoding::described_topic_info;
use channel::{Channel, RecorderClock};

use definitions::{Definition, Inquiry};
pub use filter::{SeenTopic, TopicFilter};
pub use qos_overrides::{QosOverrides, QosOverridesError};
pub use services::{RecorderServices, ServeError, SteeredRecording, serve, serve_robot, split_events};
use watch::Watch;

/// Options of a recording from ROS 2.
#[derive(Clone, Debug, Default)]
pub struct RosRecorderOptions {
    /// Which topics are recorded.
    pub filter: TopicFilter,
    /// The QoS to request in place of what publishers offer.
    pub qos_overrides: QosOverrides,
    /// How messages are serialised in the bag.
    pub encoding: Encoding,
    /// Whether messages are stamped with the time of `/clock`; until that is heard, nothing is recorded.
    pub uses_sim_time: bool,
    /// Whether who brings a message waits for room in the recording's cache, instead of losing the message.
    pub waits_for_room: bool,
}

/// Why nothing can be recorded from ROS 2, or not a topic.
#[derive(Debug, thiserror::Error)]
pub enum RosRecorderError {
    /// The node could not subscribe.
    #[error(transparent)]
    Node(#[from] NodeError),
    /// The bag did not take a topic.
    #[error(transparent)]
    Bag(#[from] RecordError),
    /// A type cannot be in the encoding.
    #[error(transparent)]
    Encoding(#[from] encoding::Error),
}

/// Records topics from the network. [`RosRecorder::discover`] looks for new ones.
pub struct RosRecorder {
    participant: Participant,
    node: Node,
    sender: RecordingSender,
    options: RosRecorderOptions,
    clock: RecorderClock,
    _clock_subscription: Option<Subscription>,
    topics: BTreeMap<String, Recorded>,
    /// Topics that could not be subscribed to, or have several types: logged once.
    refused: HashSet<String>,
    watch: Option<Watch>,
}

struct Recorded {
    type_name: String,
    requested: QosProfile,
    channel: Channel,
    /// While the definition of its type is asked for.
    inquiry: Option<(Inquiry, TopicDescription)>,
    is_mismatch_told: bool,
    _subscription: Subscription,
}

/// The state of a topic at one moment.
#[derive(Default)]
struct Seen<'a> {
    types: BTreeSet<String>,
    publishers: Vec<&'a RemoteEndpoint>,
    has_subscription: bool,
}

impl RosRecorder {
    /// A recorder on that node, which records nothing yet.
    ///
    /// # Errors
    /// If time is to be that of `/clock`, and the node cannot subscribe to it.
    pub fn new(
        participant: &Participant,
        node: &Node,
        sender: RecordingSender,
        options: RosRecorderOptions,
    ) -> Result<Self, RosRecorderError> {
        let (clock, subscription) = if options.uses_sim_time {
            let (clock, subscription) = follow_clock(node)?;
            (clock, Some(subscription))
        } else {
            (RecorderClock::System, None)
        };
        Ok(Self {
            participant: participant.clone(),
            node: node.clone(),
            sender,
            options,
            clock,
            _clock_subscription: subscription,
            topics: BTreeMap::new(),
            refused: HashSet::new(),
            watch: None,
        })
    }

    /// Takes snapshots whenever an expression over the latest messages of topics becomes true. They go on for
    /// `after` that. The topics need not be recorded, nor be there yet.
    ///
    /// # Errors
    /// Returns a sentence if the expression is none, or this program has no expressions.
    pub fn watch(
        &mut self,
        expression: &str,
        control: RecordingControl,
        after: Duration,
    ) -> Result<(), String> {
        self.watch = Some(Watch::new(expression, control, after, self.clock.clone())?);
        Ok(())
    }

    /// Looks which topics there are now, and subscribes to those that are to be recorded.
    pub fn discover(&mut self) {
        let endpoints = self.participant.remote_endpoints();
        let seen = seen_topics(&endpoints);
        for (name, seen) in &seen {
            if let Some(recorded) = self.topics.get_mut(name) {
                recorded.warn_about_mismatch(name, seen);
            } else {
                self.consider(name, seen);
            }
        }
        if let Some(watch) = &mut self.watch {
            watch.discover(&self.participant, &seen);
        }
        self.describe();
    }

    /// Goes on finding out what types look like, without looking for new topics.
    pub fn describe(&mut self) {
        let now = Instant::now();
        for (name, recorded) in &mut self.topics {
            let Some((inquiry, _)) = &mut recorded.inquiry else { continue };
            let found = inquiry.poll(&self.participant, &self.node, name, now);
            let found = found.or_else(|| {
                let too_much = || Err("too many messages wait for it".to_owned());
                recorded.channel.is_full().then(too_much)
            });
            let Some(found) = found else { continue };
            if let Some((_, info)) = recorded.inquiry.take() {
                open(&self.sender, &recorded.channel, info, found, self.options.encoding);
            }
        }
        if let Some(watch) = &mut self.watch {
            watch.describe(&self.participant, &self.node);
        }
    }

    /// The topics that are recorded.
    pub fn topics(&self) -> impl Iterator<Item = &str> {
        self.topics.keys().map(String::as_str)
    }

    /// Whether all topics that were asked for by name are recorded, and nothing else was asked for.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.options.filter.is_complete_with(&self.topics().collect())
            && self.watch.as_ref().is_none_or(Watch::is_complete)
    }

    /// What the condition of snapshots names and is not there.
    pub fn missing_for_condition(&self) -> impl Iterator<Item = &str> {
        self.watch.iter().flat_map(Watch::missing)
    }

    /// The topics that were asked for by name and are not there.
    pub fn missing(&self) -> impl Iterator<Item = &str> {
        let asked_for = self.options.filter.topics.iter().map(String::as_str);
        asked_for.filter(|topic| !self.topics.contains_key(*topic))
    }

    fn consider(&mut self, name: &str, seen: &Seen<'_>) {
        let mut types = seen.types.iter();
        let (Some(type_name), other) = (types.next(), types.next()) else { return };
        let topic = SeenTopic {
            name,
            type_name,
            has_publisher: !seen.publishers.is_empty(),
            has_subscription: seen.has_subscription,
        };
        if !self.options.filter.takes(&topic) || self.refused.contains(name) {
            return;
        }
        if let Some(other) = other {
            tracing::error!(
                "Topic '{name}' has more than one type associated ({type_name}, {other}). Only topics with one type are \
                 supported"
            );
            self.refused.insert(name.to_owned());
            return;
        }
        match self.subscribe(name, type_name, seen) {
            Ok(recorded) => {
                tracing::info!("Subscribed to topic '{name}'");
                self.topics.insert(name.to_owned(), recorded);
            }
            Err(error) => {
                tracing::error!("{name} is not recorded: {error}");
                self.refused.insert(name.to_owned());
            }
        }
    }

    fn subscribe(&self, name: &str, type_name: &str, seen: &Seen<'_>) -> Result<Recorded, RosRecorderError> {
        let requested = self.options.qos_overrides.of(name).unwrap_or_else(|| {
            // A warning is logged for later publishers that offer less.
            offers::request_for(name, &seen.publishers)
        });
        if self.options.qos_overrides.of(name).is_some() {
            tracing::info!("Overriding subscription profile for {name}");
        }
        let hash = offers::common_hash(name, &seen.publishers);
        let info = TopicDescription {
            name: name.to_owned(),
            type_name: type_name.to_owned(),
            type_hash: hash.unwrap_or_default().to_owned(),
            offered_qos: seen.publishers.iter().map(|publisher| offers::noted(publisher)).collect(),
            ..TopicDescription::default()
        };
        let channel = Channel::new(self.sender.clone(), self.clock.clone(), self.options.waits_for_room);
        let inquiry = match (definitions::at_hand(self.participant.interfaces(), type_name, hash), hash) {
            (Err(_), Some(hash)) => Some((Inquiry::new(type_name, hash, Instant::now()), info)),
            (found, _) => {
                open(&self.sender, &channel, info, found, self.options.encoding);
                None
            }
        };
        let message_type = MessageType::new(type_name).map_err(NodeError::from)?;
        let taking = channel.clone();
        let on_sample = Box::new(move |sample: Sample| taking.take(sample));
        let subscription = self.node.subscribe(name, &message_type, requested, on_sample)?;
        Ok(Recorded {
            type_name: type_name.to_owned(),
            requested,
            channel,
            inquiry,
            is_mismatch_told: false,
            _subscription: subscription,
        })
    }
}

impl Recorded {
    fn warn_about_mismatch(&mut self, topic: &str, seen: &Seen<'_>) {
        if self.is_mismatch_told {
            return;
        }
        let mismatch = |publisher: &&RemoteEndpoint| offers::mismatch(&self.requested, publisher);
        let found = seen.publishers.iter().find_map(mismatch).map(str::to_owned).or_else(|| {
            let other = seen.types.iter().find(|other| **other != self.type_name)?;
            Some(format!("type {other}, but it is recorded with type {}", self.type_name))
        });
        if let Some(found) = found {
            self.is_mismatch_told = true;
            tracing::warn!(
                "A new publisher for subscribed topic {topic} was found offering {found}. Messages from this new \
                 publisher will not be recorded."
            );
        }
    }
}

/// Adds the topic to the bag, described as well as can be, and lets its messages in.
fn open(
    sender: &RecordingSender,
    channel: &Channel,
    mut info: TopicDescription,
    found: Result<Definition, String>,
    encoding: Encoding,
) {
    let (name, type_name) = (info.name.clone(), info.type_name.clone());
    match found {
        Ok(Definition { text, hash }) => {
            info.definition = text;
            // Of an endpoint that does not announce its own.
            if info.type_hash.is_empty() {
                info.type_hash = hash;
            }
        }
        Err(problem) => tracing::warn!(
            "{name}: no definition of {type_name} was found, so the bag will not say how to decode it: {problem}"
        ),
    }
    let described = match described_topic_info(info.clone(), encoding) {
        Ok(described) => described,
        Err(error) => {
            tracing::error!("{name} is recorded as CDR: {error}");
            (info, None)
        }
    };
    let (info, codec) = described;
    match sender.add_topic(info) {
        Ok(topic) => channel.open(topic, codec),
        Err(error) => tracing::error!("{name} is not recorded: {error}"),
    }
}

/// The topics of ROS 2 by name.
fn seen_topics(endpoints: &[RemoteEndpoint]) -> BTreeMap<String, Seen<'_>> {
    let mut topics: BTreeMap<String, Seen<'_>> = BTreeMap::new();
    for endpoint in endpoints {
        let (Some(name), Some(message_type)) =
            (TopicName::from_wire(&endpoint.topic_name), MessageType::from_wire(&endpoint.type_name))
        else {
            continue;
        };
        let seen = topics.entry(name.as_str().to_owned()).or_default();
        seen.types.insert(message_type.as_str().to_owned());
        match endpoint.direction {
            Direction::Out => seen.publishers.push(endpoint),
            Direction::In => seen.has_subscription = true,
        }
    }
    topics
}

fn follow_clock(node: &Node) -> Result<(RecorderClock, Subscription), RosRecorderError> {
    let time = Arc::new(AtomicI64::new(0));
    let message_type = MessageType::new(Clock::TYPE_NAME).map_err(NodeError::from)?;
    let heard = Arc::clone(&time);
    let on_sample = Box::new(move |sample: Sample| match cdr::from_slice::<Clock>(&sample.cdr) {
        Ok(clock) => {
            let nanoseconds = i64::from(clock.clock.sec) * 1_000_000_000 + i64::from(clock.clock.nanosec);
            if heard.swap(nanoseconds, Ordering::Relaxed) == 0 && nanoseconds > 0 {
                tracing::info!("Sim time /clock found, starting recording.");
            }
        }
        Err(error) => tracing::debug!("a message on /clock is none: {error}"),
    });
    let subscription = node.subscribe("/clock", &message_type, QosProfile::CLOCK, on_sample)?;
    tracing::info!("use_sim_time set, waiting for /clock before starting recording...");
    Ok((RecorderClock::Simulated(time), subscription))
}
