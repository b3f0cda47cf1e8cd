//! Features of the ROS 2 node of a robot beyond topics, services and parameters.

use std::time::Duration;

use downbeat_bridge::clock;
use downbeat_bridge::middleware::{Engine, OptionsError};

use super::table::{Table, Value};
use super::{Located, Result, RobotFile, choice};

/// Further features of the node.
#[derive(Clone)]
pub struct NodeFeatures {
    /// Whether it publishes its log on `/rosout`.
    pub rosout: bool,
    /// Whether tools may read and set the levels of its loggers.
    pub logger_service: bool,
    /// Whether other nodes may change what is exposed with the service `~/expose`.
    pub expose_service: bool,
    /// Whether the topic `network` reports the nodes and endpoints of the ROS 2 network to modules.
    pub network: bool,
    /// How the node uses `/clock`.
    pub clock: ClockChoice,
    /// Whether the process publishes its state on the topic `diagnostics` once a second.
    pub diagnostics: bool,
    /// The engine that speaks RTPS.
    pub engine: Engine,
    /// A URDF file, relative to the robot file, to publish on `robot_description`.
    pub(crate) robot_description: Option<Located<String>>,
}

/// The source of time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClockChoice {
    /// The clock of the machine, without `/clock`.
    Own,
    /// The clock of the machine, published on `/clock` with this period.
    Publish(Duration),
    /// The time on `/clock`, like a node with `use_sim_time`.
    Follow,
}

/// The longest robot description in bytes. Typical ones have some hundred kilobytes.
const LONGEST_DESCRIPTION: u64 = 16 * 1024 * 1024;

impl Default for NodeFeatures {
    /// The features of an rclcpp node, and logger levels that tools can set.
    fn default() -> Self {
        Self {
            rosout: true,
            logger_service: true,
            expose_service: false,
            network: false,
            clock: ClockChoice::Own,
            diagnostics: true,
            engine: Engine::default(),
            robot_description: None,
        }
    }
}

impl NodeFeatures {
    /// Takes the keys of the features out of `[expose]`.
    pub(super) fn take(table: &mut Table<'_>) -> Result<Self> {
        let unless_given = Self::default();
        let description = table.take("robot_description");
        Ok(Self {
            rosout: table.take("rosout").map_or(Ok(unless_given.rosout), |value| value.flag())?,
            logger_service: table
                .take("logger_service")
                .map_or(Ok(unless_given.logger_service), |value| value.flag())?,
            expose_service: table
                .take("expose_service")
                .map_or(Ok(unless_given.expose_service), |value| value.flag())?,
            network: table.take("network").map_or(Ok(unless_given.network), |value| value.flag())?,
            clock: table.take("clock").map_or(Ok(unless_given.clock), clock_choice)?,
            diagnostics: table
                .take("diagnostics")
                .map_or(Ok(unless_given.diagnostics), |value| value.flag())?,
            engine: table.take("engine").map_or(Ok(unless_given.engine), |value| {
                value.text()?.parse().map_err(|error: OptionsError| value.error(error.to_string()))
            })?,
            robot_description: description
                .map(|value| Ok(Located { line: value.line(), value: value.text()?.to_owned() }))
                .transpose()?,
        })
    }
}

impl RobotFile {
    /// Returns the text of the robot description, if the robot file names one: XML with `robot` as its root
    /// element.
    ///
    /// # Errors
    /// Returns an error if the description cannot be read or is not of this form, with path and line in the
    /// robot file, and in the description if it is not XML.
    pub fn robot_description(&self) -> Result<Option<String>> {
        let Some(Located { line, value: name }) = &self.expose.features.robot_description else {
            return Ok(None);
        };
        let path = self.path().parent().map_or_else(|| name.into(), |folder| folder.join(name));
        let refuse = |problem: String| {
            self.source.error(*line, format!("robot_description {}: {problem}", path.display()))
        };
        let length = std::fs::metadata(&path).map_err(|error| refuse(error.to_string()))?.len();
        if length > LONGEST_DESCRIPTION {
            return Err(refuse(format!("it has {length} bytes, which is too long for a URDF")));
        }
        let text = std::fs::read_to_string(&path).map_err(|error| refuse(error.to_string()))?;
        let document =
            roxmltree::Document::parse(&text).map_err(|error| refuse(format!("no XML: {error}")))?;
        let root = document.root_element().tag_name().name();
        if root != "robot" {
            let hint = if text.contains("xacro") { "; expand it with xacro before" } else { "" };
            return Err(refuse(format!("its root is <{root}>, that of a URDF is <robot>{hint}")));
        }
        Ok(Some(text))
    }
}

fn clock_choice(value: Value<'_>) -> Result<ClockChoice> {
    let period = |rate_hz: f64| ClockChoice::Publish(Duration::from_secs_f64(1.0 / rate_hz));
    let Some(mut table) = value.as_table("clock") else {
        let choices = [("publish", period(clock::DEFAULT_RATE_HZ)), ("follow", ClockChoice::Follow)];
        return choice(value, &choices);
    };
    let rate = table.require("publish_hz")?;
    table.finish()?;
    let number = rate.number()?;
    if (0.1..=1000.0).contains(&number) {
        return Ok(period(number));
    }
    Err(rate.error("expected a rate per second from 0.1 to 1000"))
}
