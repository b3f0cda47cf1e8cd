//! `out` and `in` in `[expose]`.

use std::fmt;
use std::time::Duration;

use downbeat_bridge::expose::{Limits, OfACycle, TopicPattern};
use downbeat_bridge::middleware::{Direction, Engine, Priority, SendOptions};
use downbeat_edge::{Interfaces, KnownType};
use downbeat_msgs::definitions::{Kind, TypeName};
use downbeat_msgs::qos::QosRequest;

use super::{Result, qos};
use crate::file::choice as named;
use crate::file::features::take_of_zenoh;
use crate::file::suggestion;
use crate::file::table::{Table, Value};

/// Topics that are exposed to ROS 2.
#[derive(Clone)]
pub struct ExposeEntry {
    pub(crate) line: usize,
    /// The topics in the robot.
    pub topics: TopicChoice,
    /// The name in ROS 2 if it differs. In a pattern, wildcards stand for the text that they matched.
    pub ros_topic: Option<String>,
    /// The type, if the file specifies it.
    pub type_name: Option<String>,
    /// True if messages pass as bytes, because the file requests it or the type is not compiled in.
    pub is_raw: bool,
    /// Whether ROS 2 receives or sends the topics.
    pub direction: Direction,
    /// The quality of service.
    pub qos: QosRequest,
    /// Limits on the messages that pass.
    pub limits: Limits,
    /// How messages that go out go over a link.
    pub send: SendOptions,
    /// The node that has the endpoint, if it is not the node of the robot: absolute, or relative to the
    /// robot's namespace.
    pub node: Option<String>,
    /// The network in `[networks]`; `None` for the robot's own.
    pub network: Option<String>,
    /// Whether messages go out that came in from another network.
    pub relays: bool,
}

impl ExposeEntry {
    /// An entry of a program: topics under their own names, with the quality of service that fits.
    #[must_use]
    pub fn new(topics: TopicChoice, direction: Direction) -> Self {
        Self {
            line: 1,
            topics,
            ros_topic: None,
            type_name: None,
            is_raw: false,
            direction,
            qos: QosRequest::default(),
            limits: Limits::default(),
            send: SendOptions::default(),
            node: None,
            network: None,
            relays: false,
        }
    }
}

/// Topics by name or by pattern.
#[derive(Clone)]
pub enum TopicChoice {
    /// One topic.
    Name(String),
    /// All topics that match the pattern and none of `except`.
    Pattern {
        /// The pattern for the topics.
        pattern: TopicPattern,
        /// Patterns for excluded topics, with their lines in the file.
        except: Vec<(usize, TopicPattern)>,
    },
}

impl fmt::Display for TopicChoice {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => f.write_str(name),
            Self::Pattern { pattern, .. } => pattern.fmt(f),
        }
    }
}

/// Reads the topics of a network of this engine.
pub(super) fn topics(
    table: &mut Table<'_>,
    interfaces: &Interfaces,
    engine: Option<Engine>,
) -> Result<Vec<ExposeEntry>> {
    let mut topics = Vec::new();
    for direction in [Direction::Out, Direction::In] {
        for value in table.take(direction.name()).map_or(Ok(Vec::new()), |value| value.list())? {
            topics.push(entry(value, direction, interfaces, engine)?);
        }
    }
    Ok(topics)
}

fn entry(
    value: Value<'_>,
    direction: Direction,
    interfaces: &Interfaces,
    engine: Option<Engine>,
) -> Result<ExposeEntry> {
    let line = value.line();
    let Some(mut table) = value.as_table("an exposed topic") else {
        return Ok(ExposeEntry {
            line,
            ros_topic: absolute_pattern(value)?,
            ..ExposeEntry::new(choice(value, None)?, direction)
        });
    };
    let topic = table.require("topic")?;
    let topics = choice(topic, table.take("except"))?;
    let ros_topic = table.take("as").map(|value| new_name(value, &topics)).transpose()?;
    let ros_topic = ros_topic.or(absolute_pattern(topic)?);
    let type_value = table.take("type");
    let raw_value = table.take("raw");
    let wants_raw = raw_value.map_or(Ok(false), |value| value.flag())?;
    let type_name = type_value.map(|value| type_name(value, wants_raw, interfaces)).transpose()?;
    let is_known = |name: &String| interfaces.message(name).is_ok();
    let is_raw = wants_raw || type_name.as_ref().is_some_and(|name| !is_known(name));
    if let (TopicChoice::Pattern { .. }, true) = (&topics, is_raw) {
        let value = raw_value.or(type_value).unwrap_or(topic);
        return Err(value
            .error("a pattern matches only topics of modules; a topic whose messages pass as bytes must be given by name"));
    }
    if let (Some(value), true, None) = (raw_value, is_raw, &type_name) {
        return Err(value.error("\"raw\" needs a \"type\": the bytes do not contain it"));
    }
    let entry = ExposeEntry {
        line,
        topics,
        ros_topic,
        type_name,
        is_raw,
        direction,
        qos: table.take("qos").map_or(Ok(QosRequest::default()), |value| qos::request(value, direction))?,
        limits: limits_of(&mut table)?,
        node: table.take("node").map(|value| value.text().map(str::to_owned)).transpose()?,
        network: None,
        send: match direction {
            Direction::Out => send_options(&mut table, engine)?,
            Direction::In => SendOptions::default(),
        },
        relays: match direction {
            Direction::Out => table.take("relay").map_or(Ok(false), |value| value.flag())?,
            Direction::In => false,
        },
    };
    table.finish()?;
    Ok(entry)
}

fn choice(value: Value<'_>, except: Option<Value<'_>>) -> Result<TopicChoice> {
    let name = value.text()?;
    if TopicPattern::is_pattern(name) {
        let except = except.map_or(Ok(Vec::new()), |except| except.list())?;
        let except = except.into_iter().map(|value| Ok((value.line(), pattern(value)?)));
        return Ok(TopicChoice::Pattern { pattern: pattern(value)?, except: except.collect::<Result<_>>()? });
    }
    match except {
        Some(except) => Err(except.error(format!("\"except\" needs a pattern, but \"{name}\" is a name"))),
        None => Ok(TopicChoice::Name(name.to_owned())),
    }
}

/// Reads the name in ROS 2 of what an absolute pattern matches, which must be absolute as well.
fn absolute_pattern(value: Value<'_>) -> Result<Option<String>> {
    let name = value.text()?;
    Ok((name.starts_with('/') && TopicPattern::is_pattern(name)).then(|| name.to_owned()))
}

fn pattern(value: Value<'_>) -> Result<TopicPattern> {
    TopicPattern::new(value.text()?).map_err(|error| value.error(error.to_string()))
}

fn new_name(value: Value<'_>, topics: &TopicChoice) -> Result<String> {
    let name = value.text()?;
    match topics {
        TopicChoice::Pattern { pattern, .. } => {
            pattern.check_rename(name).map_err(|error| value.error(error.to_string()))?;
        }
        TopicChoice::Name(topic) if TopicPattern::is_pattern(name) => {
            return Err(value.error(format!("\"{name}\" has a wildcard, and \"{topic}\" has none for it")));
        }
        TopicChoice::Name(_) => {}
    }
    Ok(name.to_owned())
}

/// Reads the name of a registered type, or of a type in a package that is not registered.
fn type_name(value: Value<'_>, wants_raw: bool, interfaces: &Interfaces) -> Result<String> {
    let name = value.text()?;
    if interfaces.message(name).is_ok() {
        return Ok(name.to_owned());
    }
    let parsed: Option<TypeName> = name.parse().ok().filter(|name: &TypeName| name.kind == Kind::Message);
    let is_other = |name: &TypeName| {
        let of_package = |known: KnownType| known.name().split('/').next() == Some(&name.package);
        wants_raw || !interfaces.messages().any(of_package)
    };
    if parsed.as_ref().is_some_and(is_other) {
        return Ok(name.to_owned());
    }
    let hint = suggestion(name, interfaces.messages().map(KnownType::name));
    Err(value.error(format!("unknown topic type \"{name}\"{hint}")))
}

fn send_options(table: &mut Table<'_>, engine: Option<Engine>) -> Result<SendOptions> {
    let priority = take_of_zenoh(table, "priority", engine)?;
    let express = take_of_zenoh(table, "express", engine)?;
    Ok(SendOptions {
        priority: priority.map_or(Ok(Priority::default()), |value| named(value, &Priority::ALL))?,
        is_express: express.map_or(Ok(false), |value| value.flag())?,
    })
}

fn limits_of(table: &mut Table<'_>) -> Result<Limits> {
    let period = table.take("rate_hz").map(period).transpose()?;
    let every = table.take("every").map_or(Ok(Limits::default().every), |value| value.count())?;
    let is_latest_only = table.take("latest_only").map_or(Ok(false), |value| value.flag())?;
    let of_a_cycle = if is_latest_only { OfACycle::Latest } else { OfACycle::All };
    Ok(Limits { period, every, of_a_cycle })
}

/// Reads a rate in messages per second as a period.
fn period(value: Value<'_>) -> Result<Duration> {
    let rate = value.number()?;
    Limits::period_of(rate).ok_or_else(|| {
        value.error(format!("{rate} is not a rate; expected messages per second, such as 10.0"))
    })
}
