//! An endpoint of ROS 2 for a topic of a core.

use super::exposure::{Exposure, Limits, OfACycle};
use crate::middleware::{Direction, Priority, SendOptions};
use crate::ros::{NodeName, TopicName};
use downbeat_msgs::qos::QosRequest;
use serde::{Deserialize, Serialize};
use std::fmt;

/// An endpoint of ROS 2 for a topic of a core, with all names as remapping rules make them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExposedEndpoint {
    /// The topic in the executor.
    pub topic: String,
    /// The topic in ROS 2, absolute.
    pub ros_topic: String,
    /// The node that has the endpoint, absolute.
    pub node: String,
    /// The network that has it; `None` for that of the bridge's node.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub network: Option<String>,
    /// Whether messages go out that came in from another network.
    #[serde(default, skip_serializing_if = "std::ops::Not::not", rename = "relay")]
    pub relays: bool,
    /// Out of the executor or into it.
    pub direction: Direction,
    /// As in `sensor_msgs/msg/Imu`.
    #[serde(rename = "type")]
    pub type_name: String,
    /// What it offers or requests.
    pub qos: QosRequest,
    /// Which messages pass.
    #[serde(flatten)]
    pub limits: Limits,
    /// How messages that go out go over a link.
    #[serde(flatten)]
    pub send: SendOptions,
}

impl ExposedEndpoint {
    /// The endpoint that an exposure gives a node.
    #[must_use]
    pub fn new(
        exposure: &Exposure,
        node: &NodeName,
        ros_topic: &TopicName,
        qos: impl Into<QosRequest>,
    ) -> Self {
        Self {
            topic: exposure.topic.clone(),
            ros_topic: ros_topic.to_string(),
            node: node.to_string(),
            network: exposure.network.clone(),
            relays: exposure.relays,
            direction: exposure.direction,
            type_name: exposure.message_type.name().to_owned(),
            qos: qos.into(),
            limits: exposure.limits,
            send: exposure.send,
        }
    }

    /// True if the same node has both, in the same direction.
    pub(super) fn is_same_as(&self, other: &Self) -> bool {
        (self.direction, &self.ros_topic, &self.node, &self.network)
            == (other.direction, &other.ros_topic, &other.node, &other.network)
    }
}

impl fmt::Display for ExposedEndpoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let arrow = match self.direction {
            Direction::Out => "->",
            Direction::In => "<-",
        };
        let Self { topic, ros_topic, type_name, qos, limits, send, .. } = self;
        write!(f, "{topic:<24} {arrow} {ros_topic:<28} {type_name:<32} {qos}")?;
        if let Some(rate) = limits.rate_hz() {
            write!(f, ", at most {rate} Hz")?;
        }
        if limits.every > 1 {
            write!(f, ", one of {}", limits.every)?;
        }
        if limits.of_a_cycle == OfACycle::Latest {
            f.write_str(", latest only")?;
        }
        if send.priority != Priority::default() {
            write!(f, ", {}", send.priority.name())?;
        }
        if send.is_express {
            f.write_str(", express")?;
        }
        if let Some(network) = &self.network {
            write!(f, ", on {network}")?;
        }
        Ok(())
    }
}
