//! The interfaces of a robot's ROS 2 node other than topics.

use std::fmt;

use crate::bridge::clock;
use crate::bridge::edge::KnownService;
use crate::bridge::ros::{NodeName, ServiceName};
use crate::bridge::{robot_description, rosout};
use crate::robot::{ClockChoice, NodeFeatures, Robot};
use serde::Serialize;

/// The report, with names after remapping.
#[derive(Serialize)]
pub(super) struct NodeReport {
    pub(super) features: Features,
    pub(super) services: Vec<ServiceReport>,
    /// Services of others that modules call.
    pub(super) calls: Vec<ServiceReport>,
    pub(super) parameters: Vec<ParameterReport>,
    pub(super) lifecycle: Vec<LifecycleReport>,
}

#[derive(Serialize)]
pub(super) struct Features {
    rosout: bool,
    logger_service: bool,
    expose_service: bool,
    diagnostics: bool,
    network: bool,
    /// `own`, `publish` or `follow`, as in the robot file.
    clock: &'static str,
    /// How often the time is published.
    #[serde(skip_serializing_if = "Option::is_none")]
    clock_hz: Option<f64>,
    robot_description: bool,
}

#[derive(Serialize)]
pub(super) struct ServiceReport {
    service: String,
    ros_service: String,
    #[serde(rename = "type")]
    type_name: &'static str,
    timeout_s: f64,
}

#[derive(Serialize)]
pub(super) struct ParameterReport {
    name: String,
    /// In the syntax of robot files.
    value: String,
    is_read_only: bool,
}

#[derive(Serialize)]
pub(super) struct LifecycleReport {
    module: String,
    node: String,
}

impl NodeReport {
    pub(super) fn of(robot: &Robot) -> anyhow::Result<Self> {
        let (file, node) = (&robot.file, robot.file.node_name()?);
        let service = |service: &str, ros_service: Option<&str>, service_type: KnownService, timeout| {
            let name = ros_service.unwrap_or(service);
            anyhow::Ok(ServiceReport {
                service: service.to_owned(),
                ros_service: service_name(robot, name, &node)?,
                type_name: service_type.name(),
                timeout_s: std::time::Duration::as_secs_f64(&timeout),
            })
        };
        let offered = robot.service_exposures()?;
        let offered = offered.iter().map(|offered| {
            service(&offered.service, offered.ros_service.as_deref(), offered.service_type, offered.timeout)
        });
        let called = robot.call_exposures()?;
        let called = called.iter().map(|called| {
            service(&called.service, called.ros_service.as_deref(), called.service_type, called.timeout)
        });
        let lifecycle = robot.lifecycle_exposures()?.into_iter().map(|exposure| {
            let node = file.remaps.node(&exposure.node)?.to_string();
            anyhow::Ok(LifecycleReport { module: exposure.module, node })
        });
        Ok(Self {
            features: Features::of(
                &file.expose.features,
                file.is_rosout_disabled,
                file.robot_description()?.is_some(),
            ),
            services: offered.collect::<Result<_, _>>()?,
            calls: called.collect::<Result<_, _>>()?,
            parameters: parameters(robot)?,
            lifecycle: lifecycle.collect::<Result<_, _>>()?,
        })
    }
}

impl Features {
    fn of(features: &NodeFeatures, is_rosout_disabled: bool, has_description: bool) -> Self {
        let (clock, clock_hz) = match features.clock {
            ClockChoice::Own => ("own", None),
            ClockChoice::Publish(period) => ("publish", Some((1e6 / period.as_secs_f64()).round() / 1e6)),
            ClockChoice::Follow => ("follow", None),
        };
        Self {
            rosout: features.rosout && !is_rosout_disabled,
            logger_service: features.logger_service,
            expose_service: features.expose_service,
            diagnostics: features.diagnostics,
            network: features.network,
            clock,
            clock_hz,
            robot_description: has_description,
        }
    }
}

fn service_name(robot: &Robot, name: &str, node: &NodeName) -> anyhow::Result<String> {
    Ok(robot.file.remaps.service(ServiceName::expand(name, node)?, node)?.to_string())
}

fn parameters(robot: &Robot) -> anyhow::Result<Vec<ParameterReport>> {
    let exposure = robot.parameter_exposure()?;
    let mut parameters = Vec::new();
    for module in robot.core.modules() {
        for setting in robot.core.settings(&module.name).unwrap_or_default() {
            let name = format!("{}.{}", module.name, setting.name);
            if exposure.settings.iter().any(|pattern| pattern.matches(&name)) {
                let (value, is_read_only) = (setting.value.to_string(), setting.is_read_only);
                parameters.push(ParameterReport { name, value, is_read_only });
            }
        }
    }
    Ok(parameters)
}

impl fmt::Display for NodeReport {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.features)?;
        for (arrow, services) in [("->", &self.services), ("<-", &self.calls)] {
            for ServiceReport { service, ros_service, type_name, .. } in services {
                writeln!(f, "  service {service} {arrow} {ros_service} {type_name}")?;
            }
        }
        for LifecycleReport { module, node } in &self.lifecycle {
            writeln!(f, "  lifecycle of {module} -> node {node}")?;
        }
        for ParameterReport { name, value, is_read_only } in &self.parameters {
            writeln!(f, "  parameter {name} = {value}{}", if *is_read_only { " (read-only)" } else { "" })?;
        }
        Ok(())
    }
}

impl fmt::Display for Features {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match (self.clock, self.clock_hz) {
            ("publish", Some(rate)) => writeln!(f, "  time -> {}, {rate} Hz", clock::TOPIC)?,
            ("follow", _) => writeln!(f, "  time <- {}", clock::TOPIC)?,
            _ => {}
        }
        for (is_there, what) in [
            (self.rosout, format!("log -> {}", rosout::TOPIC)),
            (
                self.logger_service,
                "levels of loggers <-> ~/get_logger_levels, ~/set_logger_levels".to_owned(),
            ),
            (self.robot_description, format!("robot description -> {}", robot_description::TOPIC)),
            (self.expose_service, "what is exposed <- ~/expose".to_owned()),
            (self.network, "what else is on the network -> topic network of the robot".to_owned()),
        ] {
            if is_there {
                writeln!(f, "  {what}")?;
            }
        }
        Ok(())
    }
}
