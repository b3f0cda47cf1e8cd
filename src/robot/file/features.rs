//! What the ROS 2 node of a robot has beside topics, services and parameters.

use super::Result;
use super::table::Table;

/// What the node has besides.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeFeatures {
    /// Whether it publishes its log on `/rosout`.
    pub rosout: bool,
}

impl Default for NodeFeatures {
    /// What a node of rclcpp has.
    fn default() -> Self {
        Self { rosout: true }
    }
}

impl NodeFeatures {
    /// Takes its keys out of `[expose]`.
    pub(super) fn take(table: &mut Table<'_>) -> Result<Self> {
        let Self { rosout } = Self::default();
        Ok(Self { rosout: table.take("rosout").map_or(Ok(rosout), |value| value.switch())? })
    }
}
