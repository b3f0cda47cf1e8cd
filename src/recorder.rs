//! Recording topics of a core into a rosbag2 directory.

use bytes::Bytes;
use downbeat_bags::metadata::Metadata;
use downbeat_bags::{RecordError, Recording, RecordingSender, TopicId, WriterOptions};
use downbeat_bridge::edge::{CoreAccess, Interfaces, RawMessage, Sink};
use downbeat_executor::{Core, Inbox, OutletInbox, Received, SetupError, Time, TopicInfo};
use downbeat_msgs::encoding::{self, Codec, Encoding};
use downbeat_msgs::qos::QosProfile;

use crate::encoding::topic_info;
use crate::raw_recorder::RawToBag;
use crate::robot::unregistered;
use serde::{Deserialize, Serialize};
use std::any::TypeId;

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

/// What happens to a message when the disk is slower than the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// It is lost and counted: a robot must not wait.
    Lose,
    /// The recorder waits: for input from a bag, which can wait too.
    Wait,
}

/// Records these topics of a core until it stops: through outlets that share a thread, so that serialising delays no cycle and
/// the last messages of every module are recorded.
///
/// Messages are stamped with the time of the cycle that published them. A topic whose messages are not registered is passed
/// over; [`Unrecorded`] tells which these are. The offered QoS noted in the bag is what `qos_of` says of a topic. A message that has no place
/// in the encoding (a time before 1970 in FlatBuffers) is logged and left out.
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
    let sender = recording.sender();
    let inbox = OutletInbox::new("recorder", Inbox::KeepAll);
    for topic in topics {
        let (name, qos) = (format!("/{}", topic.name), qos_of(&topic.name));
        let outlet = if topic.message_type_id == TypeId::of::<RawMessage>() {
            let mut to_bag = RawToBag::new(sender.clone(), when_full, name, qos);
            core.outlet(&topic.name, &inbox, move |message: Received<'_, RawMessage>| {
                to_bag.take(message.time(), &message);
            })?
        } else if let Some(message_type) = interfaces.message_of(topic.message_type_id) {
            let (info, codec) = topic_info(name, message_type, vec![qos.into()], encoding)?;
            let to_bag = ToBag { sender: sender.clone(), when_full, codec, topic: sender.add_topic(info)? };
            message_type.outlet(&mut CoreAccess::Idle(core), &topic.name, &inbox, to_bag)?
        } else {
            continue;
        };
        outlet.keep();
    }
    Ok(())
}

/// Whether the messages of a topic have a place in a bag.
pub(crate) fn is_recordable(topic: &TopicInfo, interfaces: &Interfaces) -> bool {
    topic.message_type_id == TypeId::of::<RawMessage>()
        || interfaces.message_of(topic.message_type_id).is_some()
}

/// Topics that a recording passes over, since their Rust types are not registered as messages.
#[derive(Clone)]
pub struct Unrecorded {
    topics: Vec<TopicInfo>,
}

/// A topic that is not in a bag, as the bag tells it.
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

    /// Of these topics those that a recording passes over. What the executor and the bridge tell each other is not counted.
    #[must_use]
    pub fn of(topics: &[TopicInfo], interfaces: &Interfaces) -> Self {
        let is_internal =
            |topic: &TopicInfo| topic.name.starts_with("executor/") || topic.name.starts_with("bridge/");
        let passed_over =
            topics.iter().filter(|topic| !is_recordable(topic, interfaces) && !is_internal(topic));
        Self { topics: passed_over.cloned().collect() }
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

    /// Has a bag tell the topics, and how many messages they carried.
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
        let told = self.topics.iter().map(|topic| UnrecordedTopic {
            topic: format!("/{}", topic.name),
            rust_type: topic.message_type.to_owned(),
            messages: topic.counter.messages(),
        });
        told.collect()
    }

    /// What a bag tells of topics that were not recorded.
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

struct ToBag {
    sender: RecordingSender,
    when_full: WhenFull,
    codec: Option<Codec>,
    topic: TopicId,
}

impl Sink for ToBag {
    fn take(&mut self, time: Time, cdr: Bytes) {
        let time = time.as_nanos();
        let data = match self.codec.as_ref().map(|codec| codec.encode(&cdr)) {
            None => cdr,
            Some(Ok(data)) => data.into(),
            Some(Err(error)) => return tracing::warn!("a message is not recorded: {error}"),
        };
        // A full queue is counted by the recording and told with its numbers; a message in the log for each
        // lost one would only add to the load.
        let recorded = match self.when_full {
            WhenFull::Lose => self.sender.record(self.topic, time, time, data),
            WhenFull::Wait => self.sender.record_blocking(self.topic, time, time, data),
        };
        if let Err(error) = recorded {
            tracing::debug!("{error}");
        }
    }
}
