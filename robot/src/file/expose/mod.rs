//! `[expose]` in a robot file.

mod lifecycle;
mod qos;
mod service;
mod topic;

pub use lifecycle::LifecycleEntry;
pub use service::{ActionEntry, ServiceEntry};
pub use topic::{ExposeEntry, TopicChoice};

use downbeat_bridge::expose::{ServiceIntrospection, TopicPattern};
use downbeat_bridge::middleware::Engine;
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

impl ExposeSection {
    /// Adds what is exposed in a further network.
    pub(super) fn add_network(&mut self, name: &str, selection: Self) {
        let Self { mut topics, mut services, mut calls, mut actions, mut action_calls, .. } = selection;
        let network = || Some(name.to_owned());
        topics.iter_mut().for_each(|topic| topic.network = network());
        services.iter_mut().chain(&mut calls).for_each(|service| service.network = network());
        actions.iter_mut().chain(&mut action_calls).for_each(|action| action.network = network());
        self.topics.extend(topics);
        self.services.extend(services);
        self.calls.extend(calls);
        self.actions.extend(actions);
        self.action_calls.extend(action_calls);
    }
}

/// Reads only `out` and `in`.
pub(super) fn entries(
    mut table: Table<'_>,
    interfaces: &Interfaces,
    engine: Option<Engine>,
) -> Result<Vec<ExposeEntry>> {
    let topics = topic::topics(&mut table, interfaces, engine)?;
    table.finish()?;
    Ok(topics)
}

/// Reads the topics, services and actions that are exposed in a network.
pub(super) fn selection(
    table: &mut Table<'_>,
    interfaces: &Interfaces,
    engine: Option<Engine>,
) -> Result<ExposeSection> {
    Ok(ExposeSection {
        topics: topic::topics(table, interfaces, engine)?,
        services: service::services(table, "services", interfaces)?,
        calls: service::services(table, "calls", interfaces)?,
        actions: service::actions(table, "actions", interfaces)?,
        action_calls: service::actions(table, "action_calls", interfaces)?,
        ..ExposeSection::default()
    })
}

/// Reads `[expose]`.
pub(super) fn expose(value: Value<'_>, interfaces: &Interfaces) -> Result<ExposeSection> {
    let mut table = value.table("[expose]")?;
    let features = NodeFeatures::take(&mut table)?;
    let selection = selection(&mut table, interfaces, features.engine)?;
    let introspection = service::introspection(&mut table)?;
    let parameters = service::parameters(&mut table)?;
    let lifecycle = lifecycle::lifecycle(&mut table)?;
    table.finish()?;
    Ok(ExposeSection { introspection, parameters, lifecycle, features, ..selection })
}

#[cfg(test)]
mod tests;
