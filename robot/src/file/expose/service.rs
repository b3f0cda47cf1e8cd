//! `services`, `calls`, `actions`, `action_calls` and `parameters` in `[expose]`.

use std::time::Duration;

use downbeat_bridge::expose::{ServiceIntrospection, TopicPattern};
use downbeat_bridge::ros::{Introspection, UnknownIntrospection};
use downbeat_edge::{Interfaces, KnownAction, KnownService};

use super::Result;
use crate::file::Located;
use crate::file::table::{Table, Value};

/// How long the server of an exposed service may take unless the file specifies it.
const TIMEOUT: Duration = Duration::from_secs(10);

/// A service that is exposed to ROS 2 or called in ROS 2.
#[derive(Clone)]
pub struct ServiceEntry {
    pub(crate) line: usize,
    /// The service in the robot.
    pub service: String,
    /// The name in ROS 2 if it differs.
    pub ros_service: Option<String>,
    /// The type, if the file specifies it.
    pub service_type: Option<KnownService>,
    /// How long the server may take.
    pub timeout: Duration,
    /// The network in `[networks]`; `None` for the robot's own.
    pub network: Option<String>,
}

/// An action that is exposed to ROS 2 or used in ROS 2.
#[derive(Clone)]
pub struct ActionEntry {
    pub(crate) line: usize,
    /// The action in the robot.
    pub action: String,
    /// The name in ROS 2 if it differs.
    pub ros_action: Option<String>,
    /// The type, if the file specifies it.
    pub action_type: Option<KnownAction>,
    /// How long the server may take to accept or cancel a goal.
    pub timeout: Duration,
    /// The network in `[networks]`; `None` for the robot's own.
    pub network: Option<String>,
}

/// Reads the services under a key, given by name or as a table.
pub(super) fn services(
    table: &mut Table<'_>,
    key: &'static str,
    interfaces: &Interfaces,
) -> Result<Vec<ServiceEntry>> {
    let values = table.take(key).map_or(Ok(Vec::new()), |value| value.list())?;
    values.into_iter().map(|value| service(value, interfaces)).collect()
}

/// Reads the actions under a key, given by name or as a table.
pub(super) fn actions(
    table: &mut Table<'_>,
    key: &'static str,
    interfaces: &Interfaces,
) -> Result<Vec<ActionEntry>> {
    let values = table.take(key).map_or(Ok(Vec::new()), |value| value.list())?;
    values.into_iter().map(|value| action(value, interfaces)).collect()
}

/// Reads what services and calls publish about their calls.
pub(super) fn introspection(table: &mut Table<'_>) -> Result<ServiceIntrospection> {
    let mut chosen = |key| {
        let word = |value: Value<'_>| -> Result<Introspection> {
            let word: Introspection = value
                .text()?
                .parse()
                .map_err(|error: UnknownIntrospection| value.error(error.to_string()))?;
            Ok(word)
        };
        table.take(key).map_or(Ok(Introspection::Off), word)
    };
    Ok(ServiceIntrospection {
        services: chosen("service_introspection")?,
        clients: chosen("client_introspection")?,
    })
}

/// Reads which settings are exposed as parameters: names `module.setting`, or patterns for them.
pub(super) fn parameters(table: &mut Table<'_>) -> Result<Vec<Located<TopicPattern>>> {
    let values = table.take("parameters").map_or(Ok(Vec::new()), |value| value.list())?;
    let pattern = |value: Value<'_>| {
        let pattern = TopicPattern::new(value.text()?).map_err(|error| value.error(error.to_string()))?;
        Ok(Located { line: value.line(), value: pattern })
    };
    values.into_iter().map(pattern).collect()
}

fn service(value: Value<'_>, interfaces: &Interfaces) -> Result<ServiceEntry> {
    let known =
        |value: Value<'_>| interfaces.service(value.text()?).map_err(|error| value.error(error.to_string()));
    let entry = entry(value, "service", known)?;
    let Entry { line, name: service, ros_name: ros_service, known: service_type, timeout } = entry;
    Ok(ServiceEntry { line, service, ros_service, service_type, timeout, network: None })
}

fn action(value: Value<'_>, interfaces: &Interfaces) -> Result<ActionEntry> {
    let known =
        |value: Value<'_>| interfaces.action(value.text()?).map_err(|error| value.error(error.to_string()));
    let entry = entry(value, "action", known)?;
    let Entry { line, name: action, ros_name: ros_action, known: action_type, timeout } = entry;
    Ok(ActionEntry { line, action, ros_action, action_type, timeout, network: None })
}

/// The common part of a service and an action.
struct Entry<T> {
    line: usize,
    name: String,
    ros_name: Option<String>,
    known: Option<T>,
    timeout: Duration,
}

fn entry<'a, T>(
    value: Value<'a>,
    kind: &'static str,
    known: impl FnOnce(Value<'a>) -> Result<T>,
) -> Result<Entry<T>> {
    let line = value.line();
    let Some(mut table) = value.as_table(&format!("an exposed {kind}")) else {
        let name = value.text()?.to_owned();
        return Ok(Entry { line, name, ros_name: None, known: None, timeout: TIMEOUT });
    };
    let entry = Entry {
        line,
        name: table.require(kind)?.text()?.to_owned(),
        ros_name: table.take("as").map(|value| value.text().map(str::to_owned)).transpose()?,
        known: table.take("type").map(known).transpose()?,
        timeout: table.take("timeout").map_or(Ok(TIMEOUT), |value| value.duration())?,
    };
    table.finish()?;
    Ok(entry)
}
