//! Recording topics of a core into a rosbag2 directory.

use std::any::TypeId;

use bytes::Bytes;
use downbeat_bags::metadata::Metadata;
use downbeat_bags::{self as bags, RecordError, Recording, RecordingSender, TopicId, WriterOptions};
use downbeat_edge::{CoreAccess, Interfaces, KnownType, RawMessage, Sink};
use downbeat_executor::{Core, Inbox, Outlet, OutletInbox, Received, SetupError, Time, TopicInfo};
use downbeat_msgs::encoding::{self, Codec, Encoding};
use downbeat_msgs::qos::QosProfile;
use serde::{Deserialize, Serialize};

use crate::encoding::topic_info;
use crate::unregistered;

/// Why a robot cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// A topic could not be taken out of the core.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The bag did not take a topic.
    #[error(transparent)]
    Bag(#[from] RecordError),
    /// A type cannot be in the encoding.
    #[error(transparent)]
    Encoding(#[from] encoding::Error),
}

/// What happens to a message while the disk is slower than the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// The message is lost and counted: a robot must not wait.
    Lose,
    /// The recorder waits: for input from a bag, which can wait too.
    Wait,
}

/// Records these topics of a core until it stops, through outlets that share a thread: serializing delays no
/// cycle, and the last messages of every module are recorded.
///
/// Messages are stamped with the time of the cycle that published them. Topics whose messages are not
/// registered are skipped; [`Unrecorded`] lists them. `qos_of` returns the offered QoS of a topic for the
/// bag. A message that the encoding cannot represent (a time before 1970 in FlatBuffers) is logged and
/// skipped.
///
/// # Errors
/// If the recording has ended, or this build lacks the encoding.
pub fn record(
    core: &mut Core,
    recording: &Recording,
    topics: &[TopicInfo],
    when_full: WhenFull,
    encoding: Encoding,
    interfaces: &Interfaces,
    qos_of: impl Fn(&str) -> QosProfile,
) -> Result<(), RecorderError> {
    let (core, recording) = (&mut CoreAccess::Idle(core), recording.sender());
    let outlets = record_while(core, &recording, topics, when_full, encoding, interfaces, qos_of)?;
    outlets.into_iter().for_each(Outlet::keep);
    Ok(())
}

/// As [`record`], of a core that may run, and while the returned outlets are there. More topics may be added
/// to a recording later.
///
/// # Errors
/// Those of [`record`], and if the core does not answer.
pub fn record_while(
    core: &mut CoreAccess<'_>,
    recording: &RecordingSender,
    topics: &[TopicInfo],
    when_full: WhenFull,
    encoding: Encoding,
    interfaces: &Interfaces,
    qos_of: impl Fn(&str) -> QosProfile,
) -> Result<Vec<Outlet>, RecorderError> {
    let bag = Bag { sender: recording.clone(), when_full };
    let inbox = OutletInbox::new("recorder", Inbox::KeepAll);
    let mut outlets = Vec::new();
    for topic in topics {
        let (name, qos) = (format!("/{}", topic.name), qos_of(&topic.name));
        // The definition of what comes from ROS 2 may become known later.
        let known = interfaces.message_in(topic).filter(|known| !known.hash().is_empty());
        let outlet = if let Some(message_type) = known {
            let (info, codec) = topic_info(name, message_type, vec![qos.into()], encoding)?;
            let to_bag = ToBag { bag: bag.clone(), codec, topic: bag.sender.add_topic(info)? };
            message_type.outlet(core, &topic.name, &inbox, to_bag)?
        } else if topic.message_type_id == TypeId::of::<RawMessage>() {
            let mut to_bag = RawToBag::new(bag.clone(), name, qos);
            core.outlet(&topic.name, &inbox, move |message: Received<'_, RawMessage>| {
                to_bag.take(message.time(), &message);
            })?
        } else {
            continue;
        };
        outlets.push(outlet);
    }
    Ok(outlets)
}

/// Whether the messages of a topic can be recorded.
pub(crate) fn is_recordable(topic: &TopicInfo, interfaces: &Interfaces) -> bool {
    topic.message_type_id == TypeId::of::<RawMessage>() || interfaces.message_in(topic).is_some()
}

/// Topics that a recording skips, since their Rust types are not registered as messages.
#[derive(Clone)]
pub struct Unrecorded {
    topics: Vec<TopicInfo>,
}

/// A topic that is missing in a bag, as the bag lists it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UnrecordedTopic {
    /// The name, with a leading slash.
    pub topic: String,
    /// The Rust path of its messages.
    pub rust_type: String,
    /// How many messages it carried.
    pub messages: u64,
}

impl Unrecorded {
    /// The key of a bag's custom data that has these topics, as JSON.
    const KEY: &str = "unrecorded_topics";

    /// Those of these topics that a recording skips, without the topics between executor and bridge.
    #[must_use]
    pub fn of(topics: &[TopicInfo], interfaces: &Interfaces) -> Self {
        let is_internal =
            |topic: &TopicInfo| topic.name.starts_with("executor/") || topic.name.starts_with("bridge/");
        let skipped = topics.iter().filter(|topic| !is_recordable(topic, interfaces) && !is_internal(topic));
        Self { topics: skipped.cloned().collect() }
    }

    /// Warns of each topic, with what to do.
    pub fn warn(&self) {
        self.topics.iter().for_each(|topic| tracing::warn!("{}", problem(topic)));
    }

    /// Why a topic is not recorded, and what to do; `None` if it is. The name may have a leading slash.
    #[must_use]
    pub fn problem_of(&self, topic: &str) -> Option<String> {
        let name = topic.trim_start_matches('/');
        self.topics.iter().find(|known| *known.name == *name).map(problem)
    }

    /// Makes a bag list the topics, and how many messages they carried.
    #[must_use]
    pub fn note(self, writer: WriterOptions) -> WriterOptions {
        if self.topics.is_empty() {
            return writer;
        }
        writer.counted_data(Self::KEY, move || {
            // Strings and numbers have a place in JSON.
            serde_json::to_string(&self.topics()).unwrap_or_default()
        })
    }

    /// The topics, and how many messages they have carried so far.
    #[must_use]
    pub fn topics(&self) -> Vec<UnrecordedTopic> {
        let topics = self.topics.iter().map(|topic| UnrecordedTopic {
            topic: format!("/{}", topic.name),
            rust_type: topic.message_type.to_owned(),
            messages: topic.counter.messages(),
        });
        topics.collect()
    }

    /// The topics that a bag lists as not recorded.
    #[must_use]
    pub fn in_bag(metadata: &Metadata) -> Vec<UnrecordedTopic> {
        let noted = metadata.custom_data.get(Self::KEY);
        noted.and_then(|noted| serde_json::from_str(noted).ok()).unwrap_or_default()
    }
}

fn problem(TopicInfo { name, message_type, .. }: &TopicInfo) -> String {
    let problem = unregistered(message_type, "ROS message");
    format!("\"{name}\" is not recorded: it carries {message_type}, {problem}")
}

/// A bag that is being recorded.
#[derive(Clone)]
struct Bag {
    sender: RecordingSender,
    when_full: WhenFull,
}

impl Bag {
    fn record(&self, topic: TopicId, time: Time, data: Bytes) {
        let time = time.as_nanos();
        let recorded = match self.when_full {
            WhenFull::Lose => self.sender.record(topic, time, time, data),
            WhenFull::Wait => self.sender.record_blocking(topic, time, time, data),
        };
        // The recording counts lost messages and reports them at its end; a warning for each would only add
        // to the load.
        if let Err(error) = recorded {
            tracing::debug!("{error}");
        }
    }
}

/// Records the messages of a registered type.
struct ToBag {
    bag: Bag,
    codec: Option<Codec>,
    topic: TopicId,
}

impl Sink for ToBag {
    fn take(&mut self, time: Time, cdr: Bytes) {
        match self.codec.as_ref().map(|codec| codec.encode(&cdr)) {
            None => self.bag.record(self.topic, time, cdr),
            Some(Ok(data)) => self.bag.record(self.topic, time, data.into()),
            Some(Err(error)) => tracing::warn!("a message is not recorded: {error}"),
        }
    }
}

/// How many raw messages wait until the definition of their type is known: a bag has it before the messages.
const MOST_WAITING: usize = 256;

/// Records a topic of raw messages. The first message decides on the type of the topic.
struct RawToBag {
    bag: Bag,
    name: String,
    qos: QosProfile,
    topic: Option<(KnownType, TopicId)>,
    waiting: Vec<(Time, RawMessage)>,
}

impl RawToBag {
    fn new(bag: Bag, name: String, qos: QosProfile) -> Self {
        Self { bag, name, qos, topic: None, waiting: Vec::new() }
    }

    fn take(&mut self, time: Time, message: &RawMessage) {
        let message_type = message.message_type();
        match self.topic {
            Some((of_topic, topic)) if of_topic == message_type => {
                self.bag.record(topic, time, message.cdr().clone());
            }
            Some(_) => {}
            None => {
                self.waiting.push((time, message.clone()));
                if !message_type.hash().is_empty() || self.waiting.len() >= MOST_WAITING {
                    self.write_waiting();
                }
            }
        }
    }

    /// Writes the messages that wait, whether the definition is known or not.
    fn write_waiting(&mut self) {
        let waiting = std::mem::take(&mut self.waiting);
        let Some((_, first)) = waiting.first() else { return };
        let message_type = first.message_type();
        if message_type.hash().is_empty() {
            tracing::warn!(
                topic = self.name,
                "the definition of {message_type} is not known, so the bag will not say how to decode it"
            );
        }
        let info = bags::TopicDescription {
            name: self.name.clone(),
            type_name: message_type.name().into(),
            definition: message_type.definition().into(),
            type_hash: message_type.hash().into(),
            offered_qos: vec![self.qos.into()],
            ..bags::TopicDescription::default()
        };
        match self.bag.sender.add_topic(info) {
            Ok(topic) => {
                self.topic = Some((message_type, topic));
                for (time, message) in
                    waiting.iter().filter(|(_, other)| other.message_type() == message_type)
                {
                    self.bag.record(topic, *time, message.cdr().clone());
                }
            }
            Err(error) => tracing::error!(topic = self.name, %error, "a topic is not recorded"),
        }
    }
}

impl Drop for RawToBag {
    fn drop(&mut self) {
        self.write_waiting();
    }
}
