//! `[expose]` in a robot file.

mod lifecycle;
mod qos;
mod service;
mod topic;

pub use lifecycle::LifecycleEntry;
pub use service::{ActionEntry, ServiceEntry};
pub(super) use topic::topics;
pub use topic::{ExposeEntry, TopicChoice};

use downbeat_bridge::expose::{ServiceIntrospection, TopicPattern};
use downbeat_edge::Interfaces;

use super::table::{Table, Value};
use super::{Located, NodeFeatures, RobotFileError};

type Result<T> = std::result::Result<T, RobotFileError>;

/// The parts of a robot that are exposed to ROS 2.
#[derive(Default)]
pub struct ExposeSection {
    /// Topics that ROS 2 receives from the robot or sends to it.
    pub topics: Vec<ExposeEntry>,
    /// Services of modules that ROS 2 may call.
    pub services: Vec<ServiceEntry>,
    /// Services of ROS 2 that modules call.
    pub calls: Vec<ServiceEntry>,
    /// Actions of modules that ROS 2 may use.
    pub actions: Vec<ActionEntry>,
    /// Actions of ROS 2 that modules use.
    pub action_calls: Vec<ActionEntry>,
    /// What services and calls initially publish about their calls.
    pub introspection: ServiceIntrospection,
    /// Settings of modules that are exposed as parameters.
    pub(crate) parameters: Vec<Located<TopicPattern>>,
    /// Modules that are exposed as managed nodes.
    pub lifecycle: Vec<LifecycleEntry>,
    /// Further features of the node.
    pub features: NodeFeatures,
}

/// Reads only `out` and `in`.
pub(super) fn entries(mut table: Table<'_>, interfaces: &Interfaces) -> Result<Vec<ExposeEntry>> {
    let topics = topic::topics(&mut table, interfaces)?;
    table.finish()?;
    Ok(topics)
}

/// Reads `[expose]`.
pub(super) fn expose(value: Value<'_>, interfaces: &Interfaces) -> Result<ExposeSection> {
    let mut table = value.table("[expose]")?;
    let topics = topic::topics(&mut table, interfaces)?;
    let services = service::services(&mut table, "services", interfaces)?;
    let calls = service::services(&mut table, "calls", interfaces)?;
    let actions = service::actions(&mut table, "actions", interfaces)?;
    let action_calls = service::actions(&mut table, "action_calls", interfaces)?;
    let introspection = service::introspection(&mut table)?;
    let parameters = service::parameters(&mut table)?;
    let lifecycle = lifecycle::lifecycle(&mut table)?;
    let features = NodeFeatures::take(&mut table)?;
    table.finish()?;
    Ok(ExposeSection {
        topics,
        services,
        calls,
        actions,
        action_calls,
        introspection,
        parameters,
        lifecycle,
        features,
    })
}

#[cfg(test)]
mod tests;
