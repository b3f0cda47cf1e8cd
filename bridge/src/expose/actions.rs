//! Actions of modules offered to ROS 2, and actions of ROS 2 that modules use.
//!
//! An action is three services and two topics, and nothing else: what exposes those exposes it. Names and
//! quality of service are those of `rcl_action` (branch jazzy: `names.c`, `default_qos.h`).

use super::{Exposure, ServiceExposure};
use crate::edge::KnownAction;
use crate::middleware::Direction;
use downbeat_msgs::qos::{Durability, QosProfile};
use std::time::Duration;

/// How long a goal may take from its acceptance to its end: ten years, since no action says how long.
const RESULT_TIMEOUT: Duration = Duration::from_secs(10 * 365 * 86_400);

/// The quality of service of the topic `status`: those that come late have the last message.
const STATUS: QosProfile =
    QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT.keep_last(1) };

/// An action that passes between the executor and ROS 2.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ActionExposure {
    /// The action in the executor.
    pub action: String,
    /// The action in ROS 2 where it differs: absolute, relative to the node's namespace, or private (`~/…`).
    pub ros_action: Option<String>,
    /// The type of the action.
    pub action_type: KnownAction,
    /// How long its server may take to say whether it takes a goal or cancels one.
    pub timeout: Duration,
    /// The network that has it; `None` for that of the own node.
    pub network: Option<String>,
}

impl ActionExposure {
    /// The action in ROS 2, before it is expanded.
    #[must_use]
    pub fn ros_action(&self) -> &str {
        self.ros_action.as_deref().unwrap_or(&self.action)
    }

    /// The services: to offer if a module serves the action, to call if a node of ROS 2 does.
    #[must_use]
    pub fn services(&self) -> Vec<ServiceExposure> {
        let action = self.action_type;
        [
            ("send_goal", action.send_goal(), self.timeout),
            ("cancel_goal", action.cancel_goal(), self.timeout),
            ("get_result", action.get_result(), RESULT_TIMEOUT),
        ]
        .map(|(part, service_type, timeout)| ServiceExposure {
            service: name(&self.action, part),
            ros_service: Some(name(self.ros_action(), part)),
            service_type,
            timeout,
            network: self.network.clone(),
        })
        .into()
    }

    /// The topics: out of the executor where a module serves the action, into it where a node of ROS 2 does.
    #[must_use]
    pub fn topics(&self, direction: Direction) -> Vec<Exposure> {
        let (feedback, status) = (self.action_type.feedback(), self.action_type.status());
        [("feedback", feedback, QosProfile::DEFAULT), ("status", status, STATUS)]
            .map(|(part, message_type, qos)| Exposure {
                ros_topic: Some(name(self.ros_action(), part)),
                qos: qos.into(),
                network: self.network.clone(),
                ..Exposure::new(name(&self.action, part), message_type, direction)
            })
            .into()
    }
}

/// The name of a part of an action.
fn name(action: &str, part: &str) -> String {
    format!("{action}/_action/{part}")
}
