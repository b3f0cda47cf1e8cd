//! `[expose]` of a robot file.

use std::time::Duration;

use downbeat_msgs::qos::{Durability, History, QosProfile, Reliability};

use super::table::Value;
use super::{RobotFileError, choice, suggestion};

type Result<T> = std::result::Result<T, RobotFileError>;

/// What ROS 2 sees of a robot.
#[derive(Default)]
pub struct ExposeSection {
    /// Topics out of the robot and into it.
    pub topics: Vec<ExposeEntry>,
    // One field for each of the other keys: services, calls, parameters, clock, rosout.
}

/// Whether ROS 2 receives a topic or sends it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// The robot publishes, ROS 2 subscribes.
    Out,
    /// ROS 2 publishes, the robot subscribes.
    In,
}

/// A topic that ROS 2 sees.
pub struct ExposeEntry {
    pub(crate) line: usize,
    /// The topic in the robot.
    pub topic: String,
    /// The topic in ROS 2.
    pub ros_topic: String,
    /// Its type, where the file names it.
    pub type_name: Option<String>,
    /// Which way it goes.
    pub direction: Direction,
    /// Its quality of service.
    pub qos: QosProfile,
}

/// Reads `[expose]`: each key by a function of its own.
pub(super) fn expose(value: Value<'_>) -> Result<ExposeSection> {
    let mut table = value.table("[expose]")?;
    let mut topics = Vec::new();
    for (key, direction) in [("out", Direction::Out), ("in", Direction::In)] {
        for value in table.take(key).map_or(Ok(Vec::new()), |value| value.list())? {
            topics.push(topic(value, direction)?);
        }
    }
    table.finish()?;
    Ok(ExposeSection { topics })
}

fn topic(value: Value<'_>, direction: Direction) -> Result<ExposeEntry> {
    let line = value.line();
    let Some(mut table) = value.as_table("an exposed topic") else {
        let topic = value.text()?.to_owned();
        let ros_topic = topic.clone();
        return Ok(ExposeEntry {
            line,
            topic,
            ros_topic,
            type_name: None,
            direction,
            qos: QosProfile::DEFAULT,
        });
    };
    let topic = table.require("topic")?.text()?.to_owned();
    let ros_topic = table.take("as").map_or(Ok(topic.as_str()), |value| value.text())?.to_owned();
    let type_name = table.take("type").map(type_name).transpose()?;
    let qos = table.take("qos").map_or(Ok(QosProfile::DEFAULT), qos)?;
    table.finish()?;
    Ok(ExposeEntry { line, topic, ros_topic, type_name, direction, qos })
}

fn type_name(value: Value<'_>) -> Result<String> {
    let name = value.text()?;
    if downbeat_msgs::TYPE_NAMES.contains(&name) {
        return Ok(name.to_owned());
    }
    let hint = suggestion(name, downbeat_msgs::TYPE_NAMES.iter().copied());
    Err(value.error(format!("unknown topic type \"{name}\"{hint}")))
}

/// A preset by name, or a table that says how it differs from one.
fn qos(value: Value<'_>) -> Result<QosProfile> {
    let preset = |value: Value<'_>| {
        let name = value.text()?;
        QosProfile::preset(name).ok_or_else(|| {
            value.error(format!("unknown QoS preset \"{name}\"{}", suggestion(name, QosProfile::PRESETS)))
        })
    };
    let Some(mut table) = value.as_table("qos") else { return preset(value) };
    let mut qos = table.take("preset").map_or(Ok(QosProfile::DEFAULT), preset)?;
    if let Some(value) = table.take("reliability") {
        qos.reliability =
            choice(value, &[("reliable", Reliability::Reliable), ("best_effort", Reliability::BestEffort)])?;
    }
    if let Some(value) = table.take("durability") {
        let choices = [("volatile", Durability::Volatile), ("transient_local", Durability::TransientLocal)];
        qos.durability = choice(value, &choices)?;
    }
    let depth = table.take("depth").map(|value| value.count()).transpose()?;
    if let Some(depth) = depth {
        qos.history = History::KeepLast(depth);
    }
    if let Some(value) = table.take("history")
        && choice(value, &[("keep_last", false), ("keep_all", true)])?
    {
        if depth.is_some() {
            return Err(value.error("\"depth\" goes with history = \"keep_last\""));
        }
        qos.history = History::KeepAll;
    }
    if let Some(value) = table.take("deadline_ms") {
        qos.deadline = Some(Duration::from_millis(value.count()?.into()));
    }
    table.finish()?;
    Ok(qos)
}
