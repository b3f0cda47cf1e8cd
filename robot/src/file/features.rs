//! Features of the ROS 2 node of a robot beyond topics, services and parameters.

use std::time::Duration;

use downbeat_bridge::clock;
use downbeat_bridge::middleware::{Engine, OptionsError};

use super::table::{Table, Value};
use super::{Result, choice};

/// Further features of the node.
#[derive(Clone)]
pub struct NodeFeatures {
    /// Whether it publishes its log on `/rosout`.
    pub rosout: bool,
    /// Whether tools may read and set the levels of its loggers.
    pub logger_service: bool,
    /// Whether other nodes may change what is exposed with the service `~/expose`.
    pub expose_service: bool,
    /// Whether the robot's controllers and hardware are shown as those of ros2_control, by a node
    /// `controller_manager`.
    pub controller_manager: bool,
    /// Whether the topic `network` reports the nodes and endpoints of the ROS 2 network to modules.
    pub network: bool,
    /// How the node uses `/clock`.
    pub clock: ClockChoice,
    /// Whether the process publishes its state on the topic `diagnostics` once a second.
    pub diagnostics: bool,
    /// The engine below the node; `None` for that of the environment.
    pub engine: Option<Engine>,
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

impl Default for NodeFeatures {
    /// The features of an rclcpp node, and logger levels that tools can set.
    fn default() -> Self {
        Self {
            rosout: true,
            logger_service: true,
            expose_service: false,
            controller_manager: false,
            network: false,
            clock: ClockChoice::Own,
            diagnostics: true,
            engine: None,
        }
    }
}

/// Takes a value that only networks on Zenoh have.
pub(super) fn take_of_zenoh<'a>(
    table: &mut Table<'a>,
    key: &'static str,
    engine: Option<Engine>,
) -> Result<Option<Value<'a>>> {
    let value = table.take(key);
    match value {
        // The engine may not be built in.
        Some(value) if engine.is_none_or(|engine| engine.to_string() != ZENOH) => {
            Err(value.error(format!("\"{key}\" needs a network with engine = \"{ZENOH}\"")))
        }
        value => Ok(value),
    }
}

const ZENOH: &str = "zenoh";

impl NodeFeatures {
    /// Takes the keys of the features out of `[expose]`.
    pub(super) fn take(table: &mut Table<'_>) -> Result<Self> {
        let unless_given = Self::default();
        Ok(Self {
            rosout: table.take("rosout").map_or(Ok(unless_given.rosout), |value| value.flag())?,
            logger_service: table
                .take("logger_service")
                .map_or(Ok(unless_given.logger_service), |value| value.flag())?,
            expose_service: table
                .take("expose_service")
                .map_or(Ok(unless_given.expose_service), |value| value.flag())?,
            controller_manager: table
                .take("controller_manager")
                .map_or(Ok(unless_given.controller_manager), |value| value.flag())?,
            network: table.take("network").map_or(Ok(unless_given.network), |value| value.flag())?,
            clock: table.take("clock").map_or(Ok(unless_given.clock), clock_choice)?,
            diagnostics: table
                .take("diagnostics")
                .map_or(Ok(unless_given.diagnostics), |value| value.flag())?,
            engine: table.take("engine").map_or(Ok(unless_given.engine), |value| {
                let engine = value.text()?.parse();
                engine.map(Some).map_err(|error: OptionsError| value.error(error.to_string()))
            })?,
        })
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
