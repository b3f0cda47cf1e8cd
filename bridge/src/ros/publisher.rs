//! Publishers of nodes.

use super::definition::Definition;
use super::incompatible::Warnings;
use super::membership::Shared;
use super::node::{Hold, Listed};
use super::{MessageType, Node, NodeError, TopicName};
use crate::middleware::{
    Direction, Endpoint, EventHandler, Gid, ReaderCounter, SendOptions, WriteError, Writer,
};
use bytes::Bytes;
use downbeat_msgs::qos::QosProfile;
use std::time::Duration;

/// Publishes serialized messages on one topic.
pub struct Publisher {
    topic: TopicName,
    message_type: MessageType,
    qos: QosProfile,
    warnings: Warnings,
    // Fields are dropped in this order: the entry in the graph, so that no tool sees an endpoint without a
    // node; the endpoint; and, with the last of them, the participant.
    _listed: Listed,
    writer: Box<dyn Writer>,
    _hold: Hold,
}

impl Publisher {
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

    /// The offered quality of service.
    #[must_use]
    pub fn qos(&self) -> QosProfile {
        self.qos
    }

    /// The number of matched subscriptions.
    #[must_use]
    pub fn matched_subscriptions(&self) -> usize {
        self.writer.matched()
    }

    /// Returns true if a subscription receives what is published now. It may be discovered only, and count as
    /// matched a moment later.
    #[must_use]
    pub fn is_subscribed(&self) -> bool {
        self.writer.readers() > 0
    }

    /// Returns a function that counts the subscriptions that receive what is published now, without keeping
    /// the publisher.
    pub(crate) fn reader_counter(&self) -> ReaderCounter {
        self.writer.reader_counter()
    }

    /// Registers a handler for events of the quality of service of this publisher: first the present state,
    /// then its changes. It runs on a thread of the middleware, so it must not block, and replaces the
    /// handler before.
    pub fn on_event(&self, handler: EventHandler) {
        self.writer.on_event(self.warnings.and(handler));
    }

    /// The identity of the endpoint.
    #[must_use]
    pub fn gid(&self) -> Gid {
        self.writer.gid()
    }

    /// Publishes one message, encapsulation header and body, without blocking.
    ///
    /// # Errors
    /// [`WriteError`] if the message was not sent.
    pub fn publish(&self, cdr: Bytes) -> Result<(), WriteError> {
        self.writer.write(cdr)
    }

    /// Asserts the liveliness of this publisher without a message, if it is `manual_by_topic`.
    pub fn assert_liveliness(&self) {
        self.writer.assert_liveliness();
    }

    /// Waits until all matched reliable subscriptions have acknowledged all messages; returns false if some
    /// have not after `timeout`.
    pub fn wait_for_all_acked(&self, timeout: Duration) -> bool {
        self.writer.flush(timeout)
    }
}

impl Node {
    /// Creates a publisher; `topic` may be absolute, relative or private (`~/…`).
    ///
    /// # Errors
    /// [`NodeError`] if the name is not valid, or the engine refuses the endpoint.
    pub fn publish(
        &self,
        topic: &str,
        message_type: &MessageType,
        qos: QosProfile,
    ) -> Result<Publisher, NodeError> {
        self.publish_with(topic, message_type, qos, SendOptions::default())
    }

    /// The same, and how messages go over a link.
    ///
    /// # Errors
    /// [`NodeError`] if the name is not valid, or the engine refuses the endpoint.
    pub fn publish_with(
        &self,
        topic: &str,
        message_type: &MessageType,
        qos: QosProfile,
        send: SendOptions,
    ) -> Result<Publisher, NodeError> {
        let topic = self.topic_name(topic)?;
        let shared = &self.membership.shared;
        let endpoint = Endpoint { send, ..endpoint(self, &topic, message_type, qos) };
        let writer = shared.middleware.create_writer(&endpoint)?;
        let warnings = warnings(shared, &topic, message_type, Direction::Out, &endpoint);
        writer.on_event(warnings.and(Box::new(|_| ())));
        let listed = Listed::new(self.hold(), Direction::Out, writer.gid());
        Ok(Publisher {
            topic,
            message_type: message_type.clone(),
            qos,
            warnings,
            _listed: listed,
            writer,
            _hold: self.hold(),
        })
    }
}

pub(super) fn warnings(
    shared: &Shared,
    topic: &TopicName,
    message_type: &MessageType,
    direction: Direction,
    endpoint: &Endpoint,
) -> Warnings {
    let hashes = endpoint.type_hash.clone().into_iter().collect();
    let definition = Definition::new(shared, format!("topic '{topic}'"), message_type.as_str(), hashes);
    Warnings::new(topic, message_type, direction, definition)
}

pub(super) fn endpoint(
    node: &Node,
    topic: &TopicName,
    message_type: &MessageType,
    qos: QosProfile,
) -> Endpoint {
    let type_hash = node.membership.shared.interfaces.message_hash(message_type.as_str());
    let node = Some(node.name().identity());
    Endpoint { type_hash, node, ..Endpoint::new(topic.to_wire(), message_type.to_wire(), qos) }
}
