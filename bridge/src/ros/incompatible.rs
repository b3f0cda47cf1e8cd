//! Warnings about endpoints of others that do not match, in the words of rclcpp.

use super::definition::{Definition, apart};
use super::{MessageType, TopicName};
use crate::middleware::{Direction, EndpointEvent, EventHandler, Gid, QosPolicyKind};
use downbeat_msgs::printable;
use parking_lot::Mutex;
use std::collections::HashSet;
use std::sync::Arc;

/// The most peers with another type that are logged for one endpoint.
const MOST_PEERS: usize = 64;

/// Logs the endpoints of others that do not match one of ours.
#[derive(Clone)]
pub(super) struct Warnings {
    topic: TopicName,
    message_type: MessageType,
    direction: Direction,
    definition: Definition,
    logged: Arc<Mutex<Logged>>,
}

/// What was logged already. A new handler receives the present state again.
#[derive(Default)]
struct Logged {
    qos: bool,
    types: HashSet<Gid>,
}

impl Warnings {
    pub(super) fn new(
        topic: &TopicName,
        message_type: &MessageType,
        direction: Direction,
        definition: Definition,
    ) -> Self {
        let (topic, message_type) = (topic.clone(), message_type.clone());
        Self { topic, message_type, direction, definition, logged: Arc::default() }
    }

    /// Logs the first endpoint with incompatible quality of service and each one with another type or
    /// definition, and passes all events to `then`.
    pub(super) fn and(&self, then: EventHandler) -> EventHandler {
        let warnings = self.clone();
        Box::new(move |event| {
            match event {
                EndpointEvent::IncompatibleQos { peer, policy } => warnings.warn_of_qos(*peer, *policy),
                EndpointEvent::IncompatibleType { peer, type_name } => {
                    warnings.warn_of_type(*peer, type_name)
                }
                EndpointEvent::IncompatibleDefinition { peer, type_hash } => {
                    warnings.warn_of_definition(*peer, type_hash.as_deref());
                }
                EndpointEvent::Matched { peer } => warnings.definition.compare(*peer),
                _ => {}
            }
            then(event);
        })
    }

    fn warn_of_qos(&self, peer: Gid, policy: QosPolicyKind) {
        if !std::mem::replace(&mut self.logged.lock().qos, true) {
            tracing::warn!(%peer, "{}", qos_warning(&self.topic, self.direction, policy));
        }
    }

    fn warn_of_type(&self, peer: Gid, theirs: &str) {
        if self.is_new(peer) {
            tracing::warn!(%peer, "{}", self.type_warning(theirs));
        }
    }

    fn warn_of_definition(&self, peer: Gid, theirs: Option<&str>) {
        if self.is_new(peer) {
            let of = format!("topic '{}'", self.topic);
            let ours = self.definition.hash().unwrap_or("unknown");
            let text =
                apart(&of, self.message_type.as_str(), ours, theirs, "No messages are exchanged with it");
            tracing::warn!(%peer, "{text}");
        }
    }

    fn is_new(&self, peer: Gid) -> bool {
        let types = &mut self.logged.lock().types;
        types.len() < MOST_PEERS && types.insert(peer)
    }

    /// The words are those of `default_incompatible_type_callback` (rclcpp, `publisher_base.cpp` and
    /// `subscription_base.cpp`, which have the same), followed by the types.
    fn type_warning(&self, theirs: &str) -> String {
        let Self { topic, message_type, direction, .. } = self;
        let (own, other) = match direction {
            Direction::Out => ("publisher", "subscription"),
            Direction::In => ("subscription", "publisher"),
        };
        let theirs = MessageType::from_wire(theirs)
            .map_or_else(|| printable(theirs).into_owned(), |theirs| theirs.to_string());
        format!(
            "Incompatible type on topic '{topic}', no messages will be sent to it. The {own} of this node has type \
             {message_type}, a {other} of another node has {theirs}"
        )
    }
}

/// The words are those of `default_incompatible_qos_callback` (rclcpp, branch jazzy, `publisher_base.cpp` and
/// `subscription_base.cpp`), and what can be done.
fn qos_warning(topic: &TopicName, direction: Direction, policy: QosPolicyKind) -> String {
    let (what, remedy) = match direction {
        Direction::Out => (
            format!(
                "New subscription discovered on topic '{topic}', requesting incompatible QoS. No messages will be sent to it."
            ),
            match policy {
                QosPolicyKind::Reliability => "offer reliability reliable, or let it request best_effort",
                QosPolicyKind::Durability => "offer durability transient_local, or let it request volatile",
                QosPolicyKind::Deadline => "offer a deadline as short as it requests, or let it request none",
                QosPolicyKind::Liveliness => {
                    "offer the liveliness and a lease as short as it requests, or let it request automatic and no lease"
                }
                QosPolicyKind::Other => "compare both with `ros2 topic info -v`",
            },
        ),
        Direction::In => (
            format!(
                "New publisher discovered on topic '{topic}', offering incompatible QoS. No messages will be received from it."
            ),
            match policy {
                QosPolicyKind::Reliability => "request reliability best_effort, or let it offer reliable",
                QosPolicyKind::Durability => "request durability volatile, or let it offer transient_local",
                QosPolicyKind::Deadline => "request no deadline, or let it offer one as short as requested",
                QosPolicyKind::Liveliness => {
                    "request liveliness automatic and no lease, or let it offer what is requested"
                }
                QosPolicyKind::Other => "compare both with `ros2 topic info -v`",
            },
        ),
    };
    format!("{what} Last incompatible policy: {policy}. To do: {remedy}; further events are only counted")
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crate::ros::NodeName;

    #[test]
    fn a_warning_has_the_words_of_rclcpp_and_says_what_to_do() {
        let topic = TopicName::expand("/scan", &NodeName::new("/", "n").unwrap()).unwrap();
        let text = qos_warning(&topic, Direction::In, QosPolicyKind::Reliability);
        let expected = "New publisher discovered on topic '/scan', offering incompatible QoS. No messages will be received \
                        from it. Last incompatible policy: RELIABILITY_QOS_POLICY. To do: request reliability best_effort";
        assert!(text.starts_with(expected), "{text}");
        let text = qos_warning(&topic, Direction::Out, QosPolicyKind::Durability);
        assert!(text.contains("requesting incompatible QoS") && text.contains("transient_local"), "{text}");
    }

    fn warnings(topic: &TopicName, ours: &MessageType, direction: Direction) -> Warnings {
        Warnings::new(topic, ours, direction, Definition::default())
    }

    #[test]
    fn a_warning_of_another_type_names_both() {
        let topic = TopicName::expand("/scan", &NodeName::new("/", "n").unwrap()).unwrap();
        let ours = MessageType::new("sensor_msgs/msg/LaserScan").unwrap();
        let text = warnings(&topic, &ours, Direction::Out).type_warning("std_msgs::msg::dds_::String_");
        let expected = "Incompatible type on topic '/scan', no messages will be sent to it. The publisher of this node has \
                        type sensor_msgs/msg/LaserScan, a subscription of another node has std_msgs/msg/String";
        assert_eq!(text, expected);
        let text = warnings(&topic, &ours, Direction::In).type_warning("Plain DDS");
        assert!(text.ends_with("a publisher of another node has Plain DDS"), "{text}");
        let text = warnings(&topic, &ours, Direction::In).type_warning("\x1b[2J\nfalse");
        assert!(text.ends_with("a publisher of another node has \\u001b[2J\\u000afalse"), "{text}");
    }
}
