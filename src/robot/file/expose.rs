//! `[expose]` of a robot file.

mod qos;
mod topic;

pub use topic::{Direction, ExposeEntry, TopicChoice};

use super::RobotFileError;
use super::table::{Table, Value};

type Result<T> = std::result::Result<T, RobotFileError>;

/// What ROS 2 sees of a robot.
#[derive(Default)]
pub struct ExposeSection {
    /// Topics out of the robot and into it.
    pub topics: Vec<ExposeEntry>,
    // One field for each of the other keys: services, calls, parameters, clock, rosout.
}

/// Reads `out` and `in` alone.
pub(super) fn entries(mut table: Table<'_>) -> Result<Vec<ExposeEntry>> {
    let topics = topic::topics(&mut table)?;
    table.finish()?;
    Ok(topics)
}

/// Reads `[expose]`: each key by a function of its own.
pub(super) fn expose(value: Value<'_>) -> Result<ExposeSection> {
    let mut table = value.table("[expose]")?;
    let topics = topic::topics(&mut table)?;
    table.finish()?;
    Ok(ExposeSection { topics })
}

#[cfg(test)]
mod tests;
