//! `qos` for an exposed topic.

use std::time::Duration;

use downbeat_bridge::middleware::Direction;
use downbeat_msgs::qos::{
    BEST_AVAILABLE, History, Policy, QosProfile, QosRequest, Reliability, SYSTEM_DEFAULT, Word,
};

use super::Result;
use crate::file::table::{Table, Value};
use crate::file::{choice, suggestion};

/// Reads a preset name, or a table with a preset and the policies that differ from it.
pub(super) fn request(value: Value<'_>, direction: Direction) -> Result<QosRequest> {
    let Some(mut table) = value.as_table("qos") else { return preset(value, direction) };
    let base = table.take("preset").map_or(Ok(QosRequest::default()), |value| preset(value, direction))?;
    let request = QosRequest {
        history: history(&mut table, base.history)?,
        reliability: policy(table.take("reliability"), base.reliability)?,
        durability: policy(table.take("durability"), base.durability)?,
        deadline: duration(table.take("deadline"), base.deadline)?,
        lifespan: table.take("lifespan").map_or(Ok(base.lifespan), finite)?,
        liveliness: policy(table.take("liveliness"), base.liveliness)?,
        liveliness_lease_duration: duration(
            table.take("liveliness_lease_duration"),
            base.liveliness_lease_duration,
        )?,
    };
    table.finish()?;
    Ok(request)
}

fn preset(value: Value<'_>, direction: Direction) -> Result<QosRequest> {
    const MORE: [&str; 3] = ["services", SYSTEM_DEFAULT, BEST_AVAILABLE];
    let name = value.text()?;
    Ok(match name {
        BEST_AVAILABLE => QosRequest::BEST_AVAILABLE,
        "services" => QosProfile::SERVICES.into(),
        SYSTEM_DEFAULT => system_default(direction).into(),
        _ => QosProfile::preset(name)
            .ok_or_else(|| {
                let hint =
                    suggestion(name, QosProfile::PRESETS.map(|(known, _)| known).into_iter().chain(MORE));
                value.error(format!("unknown QoS preset \"{name}\"{hint}"))
            })?
            .into(),
    })
}

/// The defaults of DDS, which apply when no QoS is requested: a writer is reliable, a reader is not.
fn system_default(direction: Direction) -> QosProfile {
    let reliability = match direction {
        Direction::Out => Reliability::Reliable,
        Direction::In => Reliability::BestEffort,
    };
    QosProfile { reliability, ..QosProfile::DEFAULT.keep_last(1) }
}

fn history(table: &mut Table<'_>, base: History) -> Result<History> {
    let depth = table.take("depth").map(|value| value.count()).transpose()?;
    let history = table.take("history");
    let keeps_all =
        history.map(|value| choice(value, &[(History::KEEP_LAST, false), (History::KEEP_ALL, true)]));
    match (history, keeps_all.transpose()?, depth) {
        (Some(value), Some(true), Some(_)) => Err(value.error("\"depth\" needs history = \"keep_last\"")),
        (_, Some(true), None) => Ok(History::KeepAll),
        (_, _, Some(depth)) => Ok(History::KeepLast(depth)),
        (_, Some(false), None) if base == History::KeepAll => Ok(QosProfile::DEFAULT.history),
        (_, _, None) => Ok(base),
    }
}

fn policy<T: Word>(value: Option<Value<'_>>, base: Policy<T>) -> Result<Policy<T>> {
    let Some(value) = value else { return Ok(base) };
    let given = T::ALL.iter().map(|policy| (policy.name(), Policy::Given(*policy)));
    choice(value, &given.chain([(BEST_AVAILABLE, Policy::BestAvailable)]).collect::<Vec<_>>())
}

fn duration(value: Option<Value<'_>>, base: Policy<Option<Duration>>) -> Result<Policy<Option<Duration>>> {
    match value {
        None => Ok(base),
        Some(value) if value.text().is_ok_and(|text| text == BEST_AVAILABLE) => Ok(Policy::BestAvailable),
        Some(value) => finite(value).map(Policy::Given),
    }
}

/// Reads a duration; `None` for "infinite".
fn finite(value: Value<'_>) -> Result<Option<Duration>> {
    match value.text() {
        Ok("infinite") => Ok(None),
        _ => value.duration().map(Some),
    }
}
