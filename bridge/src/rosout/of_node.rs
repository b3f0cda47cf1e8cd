//! `/rosout` of the other nodes of a program.

use super::collector::Rosout;
use super::{LogLine, TOPIC, logger_name};
use crate::ros::{MessageType, Node, NodeError, Publisher};
use downbeat_msgs::Message;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::rcl_interfaces::msg::Log;
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::{Arc, Weak};

/// The publisher of a node, until it is dropped.
pub struct RosoutOfNode {
    _publisher: Arc<Publisher>,
}

/// The publishers of the lines of modules that have their own nodes.
#[derive(Default)]
pub(super) struct OfModules {
    by_module: Mutex<BTreeMap<String, OfModule>>,
}

struct OfModule {
    publisher: Weak<Publisher>,
    logger: String,
}

impl Rosout {
    /// Gives one more node of the program its publisher of `/rosout`, as every node of rclcpp has one. The lines of `module`,
    /// where the node stands for one, go through it under the node's name.
    ///
    /// # Errors
    /// [`NodeError`] when the publisher cannot be created.
    pub fn publish_also(&self, node: &Node, module: Option<&str>) -> Result<RosoutOfNode, NodeError> {
        let publisher =
            Arc::new(node.publish(TOPIC, &MessageType::new(Log::TYPE_NAME)?, QosProfile::ROSOUT)?);
        if let Some(module) = module {
            let of_module =
                OfModule { publisher: Arc::downgrade(&publisher), logger: logger_name(node.name()) };
            self.shared.of_modules.by_module.lock().insert(module.to_owned(), of_module);
        }
        Ok(RosoutOfNode { _publisher: publisher })
    }
}

impl OfModules {
    /// The publisher for a line and the message that it is, where its module has a node that is still there.
    pub(super) fn find(&self, line: &LogLine) -> Option<(Arc<Publisher>, Log)> {
        let by_module = self.by_module.lock();
        let OfModule { publisher, logger } = by_module.get(line.module.as_ref()?)?;
        Some((publisher.upgrade()?, Log { name: logger.clone(), ..line.to_message("") }))
    }
}
