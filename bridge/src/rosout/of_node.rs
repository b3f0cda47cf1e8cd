//! `/rosout` of the other nodes of a program.

use super::collector::Rosout;
use super::{TOPIC, logger_name};
use crate::ros::{MessageType, Node, NodeError, Publisher};
use downbeat_msgs::Message;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::Log;
use std::sync::Arc;

/// The publisher of a node, until it is dropped.
pub struct RosoutOfNode {
    _publisher: Arc<Publisher>,
}

impl Rosout {
    /// Gives one more node of the program its publisher of `/rosout`, as every node of rclcpp has one. The
    /// lines of `module`, where the node stands for one, go through it under the node's name.
    ///
    /// # Errors
    /// [`NodeError`] when the publisher cannot be created.
    pub fn publish_also(&self, node: &Node, module: Option<&str>) -> Result<RosoutOfNode, NodeError> {
        let publisher =
            Arc::new(node.publish(TOPIC, &MessageType::new(Log::TYPE_NAME)?, QosProfile::ROSOUT)?);
        if let Some(module) = module {
            self.shared.of_modules.insert(module, &publisher, logger_name(node.name()));
        }
        Ok(RosoutOfNode { _publisher: publisher })
    }
}
