//! What is exposed of a core's topics.

use super::Limits;
use crate::edge::KnownType;
use crate::middleware::Direction;
use crate::ros::{NodeError, NodeName, QosRequest};
use downbeat_executor::SetupError;
use thiserror::Error;

/// A topic to show to ROS 2, or to take from it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Exposure {
    /// The topic in the executor.
    pub topic: String,
    /// The topic in ROS 2 where it differs: absolute, relative to the node's namespace, or private (`~/…`).
    pub ros_topic: Option<String>,
    /// The type of the messages.
    pub message_type: KnownType,
    /// Out of the executor or into it.
    pub direction: Direction,
    /// What to offer or request.
    pub qos: QosRequest,
    /// How much of it passes.
    pub limits: Limits,
    /// The node that has the endpoint, where it is not the bridge's own.
    pub node: Option<NodeName>,
}

impl Exposure {
    /// All messages of a topic, under the same name, on the bridge's own node, with the QoS that is usual.
    #[must_use]
    pub fn new(topic: impl Into<String>, message_type: KnownType, direction: Direction) -> Self {
        Self {
            topic: topic.into(),
            ros_topic: None,
            message_type,
            direction,
            qos: QosRequest::default(),
            limits: Limits::default(),
            node: None,
        }
    }

    /// The topic in ROS 2, before it is expanded.
    #[must_use]
    pub fn ros_topic(&self) -> &str {
        self.ros_topic.as_deref().unwrap_or(&self.topic)
    }

    /// True if what one takes in the other would send out again.
    pub(super) fn is_reverse_of(&self, topic: &str, direction: Direction) -> bool {
        self.topic.trim_start_matches('/') == topic.trim_start_matches('/') && self.direction != direction
    }
}

/// A topic could not be exposed.
#[derive(Debug, Error)]
pub enum ExposeError {
    /// Its ROS 2 endpoint could not be created.
    #[error("exposing topic \"{topic}\": {error}")]
    Endpoint {
        /// The topic in the executor.
        topic: String,
        /// Why not.
        error: NodeError,
    },
    /// The ROS 2 endpoints of a service could not be created.
    #[error("exposing service \"{service}\": {error}")]
    Service {
        /// The service in the executor.
        service: String,
        /// Why not.
        error: NodeError,
    },
    /// A message that came in would go out again, and reach those who heard it already.
    #[error(
        "topic \"{0}\" is exposed in both directions: what comes in would go out again; expose one of them under \
         another topic of the executor"
    )]
    BothDirections(String),
    /// The node has an endpoint of that direction on the topic already.
    #[error("{0} is exposed already; remove it before, or give this one another name")]
    Twice(String),
    /// Two bridges would not know of each other's endpoints.
    #[error("this core has a bridge already; expose more through that one")]
    SecondBridge,
    /// The bridge's core has stopped.
    #[error("the robot has stopped")]
    Stopped,
    /// The executor refused.
    #[error(transparent)]
    Setup(#[from] SetupError),
}
