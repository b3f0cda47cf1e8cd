//! What cannot be exposed of a core at the same time.

use super::endpoint::ExposedEndpoint;
use super::exposure::{ExposeError, Exposure, is_same_topic};
use crate::middleware::Direction;

/// What else is exposed of a core, of which one may be the opposite of another.
pub(super) struct Opposite<'a> {
    topic: &'a str,
    direction: Direction,
    network: Option<&'a str>,
    relays: bool,
    /// In ROS 2; `None` for an invalid name.
    ros_topic: Option<&'a str>,
}

impl<'a> Opposite<'a> {
    pub(super) fn of_exposure(exposure: &'a Exposure, ros_topic: Option<&'a str>) -> Self {
        let Exposure { topic, direction, network, relays, .. } = exposure;
        Self { topic, direction: *direction, network: network.as_deref(), relays: *relays, ros_topic }
    }

    pub(super) fn of_endpoint(endpoint: &'a ExposedEndpoint) -> Self {
        let ExposedEndpoint { topic, direction, network, relays, ros_topic, .. } = endpoint;
        let ros_topic = Some(ros_topic.as_str());
        Self { topic, direction: *direction, network: network.as_deref(), relays: *relays, ros_topic }
    }
}

impl Exposure {
    /// Why a topic cannot be exposed like this and like `other`; `name` is its name in ROS 2.
    pub(super) fn conflict(&self, name: Option<&str>, other: &Opposite<'_>) -> Option<ExposeError> {
        if self.direction == other.direction || !is_same_topic(&self.topic, other.topic) {
            return None;
        }
        if self.network.as_deref() != other.network {
            // The one that goes out decides.
            let is_meant = if self.direction == Direction::Out { self.relays } else { other.relays };
            return (!is_meant).then(|| ExposeError::Relay(self.topic.clone()));
        }
        let has_other_name = self.message_type.is_raw() && name != other.ros_topic;
        (!has_other_name).then(|| ExposeError::BothDirections(self.topic.clone()))
    }
}
