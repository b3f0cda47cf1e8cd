//! `services`, `calls` and `parameters` of `[expose]`.

use std::time::Duration;

use downbeat_bridge::edge::KnownService;
use downbeat_bridge::expose::TopicPattern;

use super::Result;
use crate::robot::file::Located;
use crate::robot::file::table::{Table, Value};

/// How long the server of an exposed service may take, unless the file says it.
const TIMEOUT: Duration = Duration::from_secs(10);

/// A service that passes between the robot and ROS 2.
#[derive(Clone)]
pub struct ServiceEntry {
    pub(crate) line: usize,
    /// The service in the robot.
    pub service: String,
    /// The service in ROS 2 where it has another name.
    pub ros_service: Option<String>,
    /// Its type, where the file names it.
    pub service_type: Option<KnownService>,
    /// How long its server may take.
    pub timeout: Duration,
}

/// The services under a key, by name or as a table that says more.
pub(super) fn services(table: &mut Table<'_>, key: &'static str) -> Result<Vec<ServiceEntry>> {
    let values = table.take(key).map_or(Ok(Vec::new()), |value| value.list())?;
    values.into_iter().map(entry).collect()
}

/// Which settings are parameters: names `module.setting`, or patterns for them.
pub(super) fn parameters(table: &mut Table<'_>) -> Result<Vec<Located<TopicPattern>>> {
    let values = table.take("parameters").map_or(Ok(Vec::new()), |value| value.list())?;
    let pattern = |value: Value<'_>| {
        let pattern = TopicPattern::new(value.text()?).map_err(|error| value.error(error.to_string()))?;
        Ok(Located { line: value.line(), value: pattern })
    };
    values.into_iter().map(pattern).collect()
}

fn entry(value: Value<'_>) -> Result<ServiceEntry> {
    let line = value.line();
    let Some(mut table) = value.as_table("an exposed service") else {
        let service = value.text()?.to_owned();
        return Ok(ServiceEntry { line, service, ros_service: None, service_type: None, timeout: TIMEOUT });
    };
    let entry = ServiceEntry {
        line,
        service: table.require("service")?.text()?.to_owned(),
        ros_service: table.take("as").map(|value| value.text().map(str::to_owned)).transpose()?,
        service_type: table.take("type").map(service_type).transpose()?,
        timeout: table.take("timeout").map_or(Ok(TIMEOUT), |value| value.duration())?,
    };
    table.finish()?;
    Ok(entry)
}

fn service_type(value: Value<'_>) -> Result<KnownService> {
    KnownService::named(value.text()?).map_err(|error| value.error(error.to_string()))
}
