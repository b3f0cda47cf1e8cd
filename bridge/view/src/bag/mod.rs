//! Recorded bags as what viewers look at: the topics of all bags on one timeline, which viewers play, pause
//! and seek.

mod playback;

use crate::client::Client;
use crate::feed::Feed;
use crate::options::ViewOptions;
use crate::protocol::PlaybackControl;
use crate::subscribed::{Subscribed, no_channel};
use base64::prelude::{BASE64_STANDARD, Engine};
use downbeat_bags::metadata::RecordedQos;
use downbeat_bags::{MergedBags, PlayerError, Rate, Reader, RecordedTopic, TopicDescription};
use downbeat_edge::Interfaces;
use downbeat_msgs::dynamic::Definitions;
use downbeat_msgs::qos::Durability;
use parking_lot::Mutex;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::time::Duration;

pub(crate) use playback::play;

/// How bags are played to viewers, until one of them decides otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BagPlayback {
    /// How fast.
    pub rate: Rate,
    /// The offset into the bags at which to start.
    pub start_offset: Duration,
    /// Whether to start again at the end.
    pub repeats: bool,
    /// Whether to wait for a viewer that plays. Otherwise playback starts with the first viewer.
    pub starts_paused: bool,
}

impl Default for BagPlayback {
    fn default() -> Self {
        Self { rate: Rate::ORIGINAL, start_offset: Duration::ZERO, repeats: false, starts_paused: false }
    }
}

/// Bags, and what of them viewers see.
pub(crate) struct BagSource {
    bags: Arc<[Reader]>,
    /// By the position of the topics in the merged bags.
    channels: Vec<Channel>,
    playback: BagPlayback,
    /// The times of the first and the last message, in nanoseconds since the epoch.
    pub(crate) start: i64,
    pub(crate) end: i64,
    /// What is missing in the bags and not shown, for every viewer.
    losses: Vec<String>,
    requests: Sender<Request>,
    /// For the thread that plays.
    received: Mutex<Option<Receiver<Request>>>,
}

struct Channel {
    topic: Arc<str>,
    announcement: Value,
    /// How many last messages a viewer receives when it subscribes, and after a seek.
    kept: usize,
    feed: Arc<Feed>,
}

/// What the thread that plays is asked for.
enum Request {
    Control(PlaybackControl),
    /// A viewer has subscribed to the channel at this position.
    Subscribed {
        position: usize,
        client: u64,
        subscription: u32,
    },
    Unsubscribed,
    /// This viewer is new.
    Joined(u64),
    Stop,
}

/// Messages of a latched topic that a viewer receives when it subscribes; others have one.
const MOST_LATCHED: usize = 100;

impl BagSource {
    /// Topics whose messages viewers cannot read are left out, which is logged.
    ///
    /// # Errors
    /// If the bags have a topic with different types, or end before the start.
    pub(crate) fn new(
        bags: Arc<[Reader]>,
        interfaces: &Interfaces,
        playback: BagPlayback,
        options: &ViewOptions,
    ) -> Result<Self, PlayerError> {
        let mut shown = BTreeSet::new();
        let mut described = Vec::new();
        for topic in bags.iter().flat_map(|bag| bag.topics()) {
            let name = &topic.info.name;
            if !(options.topics)(name.trim_start_matches('/')) || shown.contains(name) {
                continue;
            }
            match description(topic, interfaces) {
                Ok(_) if described.len() >= options.limits.channels => {
                    let most = options.limits.channels;
                    tracing::warn!("viewers see only {most} topics, the bag has more; choose some");
                    break;
                }
                Ok(description) => {
                    shown.insert(name.clone());
                    described.push(description);
                }
                Err(reason) => tracing::warn!("{name} is not shown: {reason}"),
            }
        }
        let merged = MergedBags::new(&bags, |topic| shown.contains(&topic.name))?;
        let channel = |(position, topic): (usize, &RecordedTopic)| {
            let mut announcement =
                described.iter().find(|other| other["topic"] == topic.info.name.as_str())?.clone();
            announcement["id"] = json!(position + 1);
            let (topic, kept) = (topic.info.name.trim_start_matches('/').into(), kept(&topic.info));
            Some(Channel { topic, announcement, kept, feed: Arc::new(Feed::new(0)) })
        };
        let channels = merged.topics().iter().enumerate().filter_map(channel).collect();
        let start = bags.iter().filter_map(Reader::start_time).min().unwrap_or(0);
        let end = bags.iter().filter_map(Reader::end_time).max().unwrap_or(0);
        let length = Duration::from_nanos(end.abs_diff(start));
        if playback.start_offset > length {
            return Err(PlayerError::StartOffset { offset: playback.start_offset, length });
        }
        let losses = bags.iter().flat_map(Reader::truncation).map(ToString::to_string).collect();
        let (requests, received) = channel_of_requests();
        drop(merged);
        Ok(Self { bags, channels, playback, start, end, losses, requests, received })
    }

    pub(crate) fn channels(&self) -> Vec<Value> {
        self.channels.iter().map(|channel| channel.announcement.clone()).collect()
    }

    /// Subscribes a viewer, which receives the last message before the present time of the bags.
    ///
    /// # Errors
    /// If there is no such channel.
    pub(crate) fn subscribe(
        &self,
        &Client { id: client, ref outbox, .. }: &Client,
        subscription: u32,
        id: u32,
    ) -> Result<Subscribed, String> {
        let position = usize::try_from(id).ok().and_then(|id| id.checked_sub(1));
        let found = position.and_then(|position| Some((position, self.channels.get(position)?)));
        let (position, channel) = found.ok_or_else(|| no_channel(id))?;
        channel.feed.add(client, subscription, outbox);
        self.ask(Request::Subscribed { position, client, subscription });
        let (feed, requests) = (Arc::clone(&channel.feed), self.requests.clone());
        Ok(Subscribed::new(Arc::clone(&channel.topic), move || {
            feed.remove(client, subscription);
            let _ = requests.send(Request::Unsubscribed);
        }))
    }

    /// Sends a new viewer the state of playback and what is missing.
    pub(crate) fn greet(&self, client: u64) {
        self.ask(Request::Joined(client));
    }

    pub(crate) fn control(&self, control: PlaybackControl) {
        self.ask(Request::Control(control));
    }

    /// Ends the thread that plays.
    pub(crate) fn stop(&self) {
        self.ask(Request::Stop);
    }

    fn ask(&self, request: Request) {
        // Fails after the thread has ended, when nothing more is shown.
        let _ = self.requests.send(request);
    }

    /// The bags as one; the topics are in the order of the channels.
    fn merged(&self) -> Result<MergedBags<'_>, PlayerError> {
        let shown: BTreeSet<_> = self.channels.iter().map(|channel| &*channel.topic).collect();
        Ok(MergedBags::new(&self.bags, |topic| shown.contains(topic.name.trim_start_matches('/')))?)
    }
}

fn channel_of_requests() -> (Sender<Request>, Mutex<Option<Receiver<Request>>>) {
    let (requests, received) = channel();
    (requests, Mutex::new(Some(received)))
}

/// Each publisher of a latched topic has messages of its own, as `/tf_static` does.
fn kept(topic: &TopicDescription) -> usize {
    let depth = |qos: &RecordedQos| match qos.to_profile() {
        profile if profile.durability == Durability::Volatile => 0,
        _ => TopicDescription { offered_qos: vec![*qos], ..TopicDescription::default() }.latched_depth(),
    };
    let depths = topic.offered_qos.iter().map(depth);
    depths.fold(0, usize::saturating_add).clamp(1, MOST_LATCHED)
}

/// A topic as the protocol announces it, without its id.
///
/// # Errors
/// In words, if viewers cannot read its messages.
fn description(topic: &RecordedTopic, interfaces: &Interfaces) -> Result<Value, String> {
    let info = &topic.info;
    let (encoding, name, schema_encoding, schema) = match info.format.as_ref().filter(|_| !info.is_cdr()) {
        Some(format) => {
            let schema = &format.schema;
            let text = match std::str::from_utf8(&schema.data) {
                Ok(text) if !["protobuf", "flatbuffer"].contains(&schema.encoding.as_str()) => {
                    text.to_owned()
                }
                _ => BASE64_STANDARD.encode(&schema.data),
            };
            (format.message_encoding.as_str(), schema.name.as_str(), schema.encoding.as_str(), text)
        }
        None => {
            // Usually a bag says it all.
            let found = info.definition_with(&Definitions::new().with_carried());
            let found = found.or_else(|_| info.definition_with(&interfaces.definitions()));
            let found = found.map_err(|error| error.to_string())?;
            if let Some(taken) = found.taken {
                tracing::warn!("{}: {taken}", info.name);
            }
            let definition = found.definition.text;
            ("cdr", info.type_name.as_str(), "ros2msg", definition)
        }
    };
    let mut description = json!({
        "topic": info.name,
        "encoding": encoding,
        "schemaName": name,
        "schema": schema,
    });
    // A channel of JSON may have none.
    if !schema_encoding.is_empty() {
        description["schemaEncoding"] = json!(schema_encoding);
    }
    Ok(description)
}
