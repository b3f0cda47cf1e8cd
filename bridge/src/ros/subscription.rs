//! Subscriptions of nodes.

use super::incompatible::Warnings;
use super::node::{Hold, Listed};
use super::publisher::{endpoint, warnings};
use super::{MessageType, Node, NodeError, TopicName};
use crate::middleware::{Direction, EventHandler, Reader, SampleHandler};
use downbeat_msgs::qos::QosProfile;

/// Keeps a subscription alive.
pub struct Subscription {
    topic: TopicName,
    message_type: MessageType,
    qos: QosProfile,
    warnings: Warnings,
    // Dropped in this order, as in a publisher.
    _listed: Listed,
    reader: Box<dyn Reader>,
    _hold: Hold,
}

impl Subscription {
    /// The absolute name of its topic.
    #[must_use]
    pub fn topic(&self) -> &TopicName {
        &self.topic
    }

    /// The type of its messages.
    #[must_use]
    pub fn message_type(&self) -> &MessageType {
        &self.message_type
    }

    /// The requested quality of service.
    #[must_use]
    pub fn qos(&self) -> QosProfile {
        self.qos
    }

    /// The number of matched publishers.
    #[must_use]
    pub fn matched_publishers(&self) -> usize {
        self.reader.matched()
    }

    /// Registers a handler for events of the quality of service of this subscription: first the present
    /// state, then its changes. It runs on a thread of the middleware, so it must not block, and replaces the
    /// handler before.
    pub fn on_event(&self, handler: EventHandler) {
        self.reader.on_event(self.warnings.and(handler));
    }
}

impl Node {
    /// Creates a subscription; `topic` may be absolute, relative or private (`~/…`). `on_sample` runs on the
    /// thread that all subscriptions of the participant share, so it must pass the sample on and return.
    ///
    /// # Errors
    /// [`NodeError`] if the name is not valid, or the engine refuses the endpoint.
    pub fn subscribe(
        &self,
        topic: &str,
        message_type: &MessageType,
        qos: QosProfile,
        on_sample: SampleHandler,
    ) -> Result<Subscription, NodeError> {
        let topic = self.topic_name(topic)?;
        let shared = &self.membership.shared;
        let endpoint = endpoint(self, &topic, message_type, qos);
        let reader = shared.middleware.create_reader(&endpoint, on_sample)?;
        let warnings = warnings(shared, &topic, message_type, Direction::In, &endpoint);
        reader.on_event(warnings.and(Box::new(|_| ())));
        let listed = Listed::new(self.hold(), Direction::In, reader.gid());
        Ok(Subscription {
            topic,
            message_type: message_type.clone(),
            qos,
            warnings,
            _listed: listed,
            reader,
            _hold: self.hold(),
        })
    }
}
