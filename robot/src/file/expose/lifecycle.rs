//! `lifecycle` in `[expose]`.

use downbeat_bridge::expose::TopicPattern;

use super::Result;
use crate::file::table::{Table, Value};

/// Modules that are exposed as managed nodes.
#[derive(Clone)]
pub struct LifecycleEntry {
    pub(crate) line: usize,
    /// The modules, by name or pattern.
    pub modules: TopicPattern,
    /// The name of the node if it differs from that of the module: absolute, or relative to the robot's
    /// namespace.
    pub node: Option<String>,
}

/// Reads modules, given by name or pattern or as a table that names the node.
pub(super) fn lifecycle(table: &mut Table<'_>) -> Result<Vec<LifecycleEntry>> {
    let values = table.take("lifecycle").map_or(Ok(Vec::new()), |value| value.list())?;
    values.into_iter().map(entry).collect()
}

fn entry(value: Value<'_>) -> Result<LifecycleEntry> {
    let line = value.line();
    let Some(mut table) = value.as_table("a module with a lifecycle") else {
        return Ok(LifecycleEntry { line, modules: pattern(value)?, node: None });
    };
    let module = table.require("module")?;
    let node = table.take("node");
    table.finish()?;
    match node {
        Some(node) if TopicPattern::is_pattern(module.text()?) => {
            Err(node.error("\"node\" can only be given for the name of one module, not for a pattern"))
        }
        node => {
            let node = node.map(|node| node.text().map(str::to_owned)).transpose()?;
            Ok(LifecycleEntry { line, modules: pattern(module)?, node })
        }
    }
}

fn pattern(value: Value<'_>) -> Result<TopicPattern> {
    TopicPattern::new(value.text()?).map_err(|error| value.error(error.to_string()))
}
