//! `robot_description`: the URDF of the robot for those that show it.

use crate::ros::{MessageType, Node, NodeError, Publisher};
use bytes::Bytes;
use downbeat_msgs::qos::QosProfile;
use downbeat_msgs::std_msgs::msg::String as Text;
use downbeat_msgs::{Message, cdr};
use thiserror::Error;

/// The topic, in the namespace of the node, as that of robot_state_publisher.
pub const TOPIC: &str = "robot_description";

/// Publishes the description until it is dropped.
pub struct RobotDescription {
    publisher: Publisher,
}

/// The description cannot be published.
#[derive(Debug, Error)]
pub enum RobotDescriptionError {
    /// The publisher could not be created.
    #[error("publishing {TOPIC}: {0}")]
    Node(#[from] NodeError),
    /// It was not sent.
    #[error("publishing {TOPIC}: {0}")]
    Write(#[from] crate::middleware::WriteError),
}

impl RobotDescription {
    /// Publishes a URDF once, for all that are there and all that come later (reliable, transient local, keep last 1).
    ///
    /// ```
    /// use downbeat_bridge::middleware::in_process::Hub;
    /// use downbeat_bridge::robot_description::RobotDescription;
    /// use downbeat_bridge::ros::{NodeName, Participant};
    ///
    /// let participant = Participant::on(std::sync::Arc::new(Hub::new().join()))?;
    /// let node = participant.create_node(NodeName::new("/robot1", "downbeat")?)?;
    /// let description = RobotDescription::publish(&node, "<robot name=\"stick\"><link name=\"stick\"/></robot>")?;
    /// assert_eq!(description.topic(), "/robot1/robot_description");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`RobotDescriptionError`] where it cannot be published.
    pub fn publish(node: &Node, urdf: &str) -> Result<Self, RobotDescriptionError> {
        let kind = MessageType::new(Text::TYPE_NAME).map_err(NodeError::from)?;
        let publisher = node.publish(TOPIC, &kind, QosProfile::LATCHED)?;
        publisher.publish(Bytes::from(cdr::to_vec(&Text { data: urdf.to_owned() })))?;
        Ok(Self { publisher })
    }

    /// The absolute name of the topic.
    #[must_use]
    pub fn topic(&self) -> &str {
        self.publisher.topic().as_str()
    }
}
