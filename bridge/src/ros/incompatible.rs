//! Endpoints of others on a topic that do not match: logged as rclcpp logs them.

use super::TopicName;
use crate::middleware::{Direction, EndpointEvent, EventHandler, QosPolicyKind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Whether a warning was logged for an endpoint: later events are only counted.
#[derive(Clone, Default)]
pub(super) struct Warned(Arc<AtomicBool>);

impl Warned {
    /// Warns of what does not match an endpoint of ours, and passes all events on.
    pub(super) fn and(&self, topic: &TopicName, direction: Direction, then: EventHandler) -> EventHandler {
        let (warned, topic) = (self.clone(), topic.clone());
        Box::new(move |event| {
            if let EndpointEvent::IncompatibleQos { peer, policy } = *event
                && !warned.0.swap(true, Ordering::Relaxed)
            {
                tracing::warn!(%peer, "{}", warning(&topic, direction, policy));
            }
            then(event);
        })
    }
}

/// The words are those of `default_incompatible_qos_callback` (rclcpp, branch jazzy, `publisher_base.cpp` and
/// `subscription_base.cpp`), and what can be done.
fn warning(topic: &TopicName, direction: Direction, policy: QosPolicyKind) -> String {
    let (what, remedy) = match direction {
        Direction::Out => (
            format!(
                "New subscription discovered on topic '{topic}', requesting incompatible QoS. No messages will be sent to it."
            ),
            match policy {
                QosPolicyKind::Reliability => "offer reliability reliable, or have it ask for best_effort",
                QosPolicyKind::Durability => "offer durability transient_local, or have it ask for volatile",
                QosPolicyKind::Deadline => {
                    "offer a deadline as short as it asks for, or have it ask for none"
                }
                QosPolicyKind::Liveliness => {
                    "offer the liveliness and a lease as short as it asks for, or have it ask for automatic and no lease"
                }
                QosPolicyKind::Other => "compare both with `ros2 topic info -v`",
            },
        ),
        Direction::In => (
            format!(
                "New publisher discovered on topic '{topic}', offering incompatible QoS. No messages will be received from it."
            ),
            match policy {
                QosPolicyKind::Reliability => "ask for reliability best_effort, or have it offer reliable",
                QosPolicyKind::Durability => "ask for durability volatile, or have it offer transient_local",
                QosPolicyKind::Deadline => {
                    "ask for no deadline, or have it offer one as short as is asked for"
                }
                QosPolicyKind::Liveliness => {
                    "ask for liveliness automatic and no lease, or have it offer what is asked for"
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
        let text = warning(&topic, Direction::In, QosPolicyKind::Reliability);
        let expected = "New publisher discovered on topic '/scan', offering incompatible QoS. No messages will be received \
                        from it. Last incompatible policy: RELIABILITY_QOS_POLICY. To do: ask for reliability best_effort";
        assert!(text.starts_with(expected), "{text}");
        let text = warning(&topic, Direction::Out, QosPolicyKind::Durability);
        assert!(text.contains("requesting incompatible QoS") && text.contains("transient_local"), "{text}");
    }
}
