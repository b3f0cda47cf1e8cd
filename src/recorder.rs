//! Recording topics of a core into a rosbag2 directory.

use bytes::Bytes;
use downbeat_bags::{RecordError, Recording, RecordingSender, TopicId};
use downbeat_bridge::edge::{KnownType, Sink};
use downbeat_executor::{
    Core, Inbox, Module, ModuleOptions, Role, Setup, SetupError, Synchrony, Time, TopicInfo,
};
use downbeat_msgs::qos::QosProfile;

/// Why a robot cannot be recorded.
#[derive(Debug, thiserror::Error)]
pub enum RecorderError {
    /// The recorder could not join the core.
    #[error(transparent)]
    Setup(#[from] SetupError),
    /// The bag did not take a topic.
    #[error(transparent)]
    Bag(#[from] RecordError),
}

/// What happens to a message when the disk is slower than the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WhenFull {
    /// It is lost and counted: a robot must not wait.
    Lose,
    /// The recorder waits: for input from a bag, which can wait too.
    Wait,
}

/// Adds a recorder of these topics to a core: a detached observer, so that serialising delays no cycle and the
/// last messages of every module are recorded.
///
/// Messages are stamped with the time of the cycle that published them. A topic whose messages are no ROS
/// messages is passed over. The offered QoS noted in the bag is what `qos_of` says of a topic.
///
/// # Errors
/// If the core already has a recorder, or the recording has ended.
pub fn record(
    core: &mut Core,
    recording: &Recording,
    topics: &[TopicInfo],
    when_full: WhenFull,
    qos_of: impl Fn(&str) -> QosProfile,
) -> Result<(), RecorderError> {
    let sender = recording.sender();
    let mut recorder = Recorder { sender: sender.clone(), when_full, topics: Vec::new() };
    for topic in topics {
        let Some(message_type) = KnownType::of_rust_type(topic.message_type_id) else {
            tracing::debug!("{} is not recorded: {} is no ROS message", topic.name, topic.message_type);
            continue;
        };
        let id = sender.add_topic(downbeat_bags::TopicInfo {
            name: format!("/{}", topic.name),
            type_name: message_type.name().into(),
            definition: message_type.definition().into(),
            type_hash: message_type.hash().into(),
            offered_qos: vec![qos_of(&topic.name)],
        })?;
        recorder.topics.push((topic.name.to_string(), message_type, id));
    }
    let options = ModuleOptions {
        synchrony: Synchrony::Detached(Inbox::KeepAll),
        role: Role::Observer,
        ..ModuleOptions::default()
    };
    Ok(core.add_with("recorder", recorder, options)?)
}

struct Recorder {
    sender: RecordingSender,
    when_full: WhenFull,
    topics: Vec<(String, KnownType, TopicId)>,
}

impl Module for Recorder {
    fn setup(&mut self, setup: &mut Setup<'_, Self>) -> Result<(), SetupError> {
        for (topic, message_type, id) in self.topics.drain(..) {
            message_type.subscribe(
                setup,
                &topic,
                ToBag { sender: self.sender.clone(), when_full: self.when_full, topic: id },
            )?;
        }
        Ok(())
    }
}

struct ToBag {
    sender: RecordingSender,
    when_full: WhenFull,
    topic: TopicId,
}

impl Sink for ToBag {
    fn take(&mut self, time: Time, cdr: Bytes) {
        let time = time.as_nanos();
        // A full queue is counted by the recording and told with its numbers; a message in the log for each
        // lost one would only add to the load.
        let recorded = match self.when_full {
            WhenFull::Lose => self.sender.record(self.topic, time, time, cdr),
            WhenFull::Wait => self.sender.record_blocking(self.topic, time, time, cdr),
        };
        if let Err(error) = recorded {
            tracing::debug!("{error}");
        }
    }
}
