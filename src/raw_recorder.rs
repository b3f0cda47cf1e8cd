//! Recording topics of a core that carry bytes: of types that are not compiled in.

use downbeat_bags::{RecordingSender, TopicId, TopicInfo};
use downbeat_bridge::edge::{KnownType, RawMessage};
use downbeat_executor::Time;
use downbeat_msgs::qos::QosProfile;

use crate::recorder::WhenFull;

/// Messages that wait until the definition of their type is known, which a bag has before them.
const MOST_WAITING: usize = 256;

/// Puts one topic into a bag. Its type, which the first message tells, is recorded with its definition where that is known by the
/// time that message is written: it is waited for, for a while.
pub(crate) struct RawToBag {
    sender: RecordingSender,
    when_full: WhenFull,
    name: String,
    qos: QosProfile,
    topic: Option<(KnownType, TopicId)>,
    waiting: Vec<(Time, RawMessage)>,
}

impl RawToBag {
    pub(crate) fn new(sender: RecordingSender, when_full: WhenFull, name: String, qos: QosProfile) -> Self {
        Self { sender, when_full, name, qos, topic: None, waiting: Vec::new() }
    }

    pub(crate) fn take(&mut self, time: Time, message: &RawMessage) {
        if let Some((message_type, topic)) = self.topic {
            if message_type == message.message_type() {
                self.record(topic, time, message);
            }
            return;
        }
        self.waiting.push((time, message.clone()));
        let message_type = message.message_type();
        if !message_type.definition().is_empty() || self.waiting.len() >= MOST_WAITING {
            self.write_waiting();
        }
    }

    /// Writes what waits, whether the definition is known or not.
    fn write_waiting(&mut self) {
        let waiting = std::mem::take(&mut self.waiting);
        let Some((_, first)) = waiting.first() else { return };
        let message_type = first.message_type();
        if message_type.definition().is_empty() {
            tracing::warn!(
                topic = self.name,
                "the definition of {message_type} is not known, so the bag will not say how to decode it"
            );
        }
        let info = TopicInfo {
            name: self.name.clone(),
            type_name: message_type.name().into(),
            definition: message_type.definition().into(),
            type_hash: message_type.hash().into(),
            offered_qos: vec![self.qos.into()],
            ..TopicInfo::default()
        };
        match self.sender.add_topic(info) {
            Ok(topic) => {
                self.topic = Some((message_type, topic));
                let of_type = waiting.iter().filter(|(_, message)| message.message_type() == message_type);
                of_type.for_each(|(time, message)| self.record(topic, *time, message));
            }
            Err(error) => tracing::error!(topic = self.name, %error, "a topic is not recorded"),
        }
    }

    fn record(&self, topic: TopicId, time: Time, message: &RawMessage) {
        let (time, cdr) = (time.as_nanos(), message.cdr().clone());
        let recorded = match self.when_full {
            WhenFull::Lose => self.sender.record(topic, time, time, cdr),
            WhenFull::Wait => self.sender.record_blocking(topic, time, time, cdr),
        };
        // Counted by the recording, which tells at the end.
        if let Err(error) = recorded {
            tracing::debug!("{error}");
        }
    }
}

impl Drop for RawToBag {
    fn drop(&mut self) {
        self.write_waiting();
    }
}
