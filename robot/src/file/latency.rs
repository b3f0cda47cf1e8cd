//! `[[latency]]`: chains that are measured while the robot runs.

use std::time::Duration;

use super::table::Value;
use super::{Located, Result};

/// A chain from messages of one topic to messages of another.
#[derive(Clone)]
pub(crate) struct LatencyEntry {
    pub(crate) name: String,
    pub(crate) from: Located<String>,
    pub(crate) to: Located<String>,
    /// An age that is reported.
    pub(crate) limit: Option<Duration>,
}

/// Reads the list.
pub(super) fn latencies(value: Value<'_>) -> Result<Vec<LatencyEntry>> {
    let mut entries: Vec<LatencyEntry> = Vec::new();
    for value in value.list()? {
        let mut table = value.table("[[latency]]")?;
        let name = table.require("name")?;
        let mut topic = |key| -> Result<_> {
            let value = table.require(key)?;
            Ok(Located { line: value.line(), value: value.text()?.trim_start_matches('/').to_owned() })
        };
        let (from, to) = (topic("from")?, topic("to")?);
        let limit = table.take("limit").map(|value| value.duration()).transpose()?;
        table.finish()?;
        if entries.iter().any(|known| name.text().is_ok_and(|name| name == known.name)) {
            return Err(name.error("there is another [[latency]] of this name; each needs its own"));
        }
        if from.value == to.value {
            return Err(value.error("\"from\" and \"to\" are the same topic; a chain leads to another one"));
        }
        entries.push(LatencyEntry { name: name.text()?.to_owned(), from, to, limit });
    }
    Ok(entries)
}
