//! `downbeat check`

use std::fmt;
use std::path::Path;

use serde::Serialize;
use serde_json::json;

use super::cli::CheckArguments;
use super::describe::print_missing_kinds;
use super::logging::Log;
#[cfg(feature = "security")]
use super::network::participant_options;
#[cfg(feature = "security")]
use super::security::RobotReport;
use downbeat_bridge::edge::{Interfaces, KnownType};
use downbeat_bridge::expose::{ActionExposure, ServiceExposure};
use downbeat_bridge::ros::{NodeName, ServiceName};
use downbeat_bridge::{clock, rosout};
use downbeat_executor::{Core, TopicInfo};
use downbeat_robot::recorder::Unrecorded;
use downbeat_robot::running::add_diagnostics;
use downbeat_robot::{
    Catalog, ClockChoice, ExposedEndpoint, ModuleSource, NodeFeatures, Robot, RobotFile, RosArgs,
};

pub(crate) fn check(
    arguments: &CheckArguments,
    catalog: &Catalog,
    ros: &RosArgs,
    log: &Log,
) -> anyhow::Result<()> {
    if arguments.kinds {
        list_kinds(catalog);
    }
    let Some(path) = &arguments.robot else { return Ok(()) };
    check_robot(path, arguments, catalog, ros)?;
    if arguments.json || arguments.dump_params {
        return Ok(());
    }
    check_security(arguments.parameters.read_robot(path, catalog, ros)?, ros, log)
}

/// Prints what the enclave that the environment names denies the robot, if it names one.
#[cfg(feature = "security")]
fn check_security(file: RobotFile, ros: &RosArgs, log: &Log) -> anyhow::Result<()> {
    if std::env::var_os("ROS_SECURITY_ENABLE").is_none() {
        return Ok(());
    }
    let options = ros.with_enclave(participant_options(None)?);
    let Some(report) = RobotReport::for_run(file, &options, log)? else { return Ok(()) };
    println!("\n{}", report.summary());
    report.refuse_denied()
}

#[cfg(not(feature = "security"))]
fn check_security(_: RobotFile, _: &RosArgs, _: &Log) -> anyhow::Result<()> {
    Ok(())
}

fn check_robot(
    path: &Path,
    arguments: &CheckArguments,
    catalog: &Catalog,
    ros: &RosArgs,
) -> anyhow::Result<()> {
    let file = arguments.parameters.read_robot(path, catalog, ros)?;
    for problem in file.thread_problems() {
        tracing::warn!("the robot cannot run on this machine: {problem}");
    }
    let mut core = Core::new();
    add_diagnostics(&mut core, &file)?;
    let robot = file.on_any_machine().build(core)?;
    if arguments.dump_params {
        print!("{}", robot.parameters());
        return Ok(());
    }
    let exposed = robot.file.exposed(&robot.exposures()?)?;
    if arguments.json {
        println!("{}", serde_json::to_string_pretty(&as_json(&robot, &exposed)?)?);
        return Ok(());
    }
    let Robot { file, core, .. } = &robot;
    let emulated = if file.is_emulated() { ", emulated" } else { "" };
    println!("{}: robot {}{emulated}, {}", path.display(), file.name, file.launcher.choice);
    println!("\nmodules");
    for module in &file.modules {
        println!("  {:<20} {:<20} {}", module.name, module.kind.name(), module.kind.about());
        print_settings(core, &module.name);
    }
    println!("\ntopics");
    core.topics().for_each(|topic| print_topic(topic, &file.catalog.interfaces));
    println!("\nexposed to ROS 2 as node {}", file.node_name()?);
    print_exposed(&exposed, &file.node_name()?.to_string());
    print!("{}", NodeReport::of(&robot)?);
    print_actions(&robot)?;
    let topics = robot.recorded_topics()?;
    let unrecorded = Unrecorded::of(&topics, &robot.file.catalog.interfaces);
    let recorded: Vec<String> = topics.iter().map(|topic| topic.name.to_string()).collect();
    if recorded.len() == core.topics().count() {
        println!("\nrecorded with --record: all topics");
    } else {
        println!("\nrecorded with --record: {}", recorded.join(", "));
    }
    unrecorded.warn();
    Ok(())
}

fn print_actions(robot: &Robot) -> anyhow::Result<()> {
    for (actions, arrow) in [(robot.action_exposures()?, "->"), (robot.action_call_exposures()?, "<-")] {
        for action in actions {
            let ros_action = action_name(robot, action.ros_action())?;
            let network = on(action.network.as_deref());
            println!("  action {} {arrow} {ros_action} {}{network}", action.action, action.action_type);
            if arrow == "->" {
                println!(
                    "    a failure: the goal is not accepted; later, its status is ABORTED, its result has default values"
                );
            }
        }
    }
    Ok(())
}

/// By node, in the order of the file.
fn print_exposed<'a>(exposed: &'a [ExposedEndpoint], mut node: &'a str) {
    for endpoint in exposed {
        if endpoint.node != node {
            node = &endpoint.node;
            println!(" of node {node}");
        }
        println!("  {endpoint}");
    }
}

fn as_json(robot: &Robot, exposed: &[ExposedEndpoint]) -> anyhow::Result<serde_json::Value> {
    let Robot { file, core, .. } = robot;
    let modules: Vec<_> = file
        .modules
        .iter()
        .map(|module| json!({ "name": module.name, "kind": module.kind.name() }))
        .collect();
    let topics: Vec<_> = core
        .topics()
        .map(|topic| json!({ "name": *topic.name, "type": type_name(topic, &file.catalog.interfaces), "is_published": topic.is_published }))
        .collect();
    let NodeReport { features, networks, services, calls, parameters, lifecycle } = NodeReport::of(robot)?;
    let mut actions = Vec::new();
    for (direction, exposures) in [("out", robot.action_exposures()?), ("in", robot.action_call_exposures()?)]
    {
        for ActionExposure { action, ros_action, action_type, network, .. } in exposures {
            actions.push(json!({
                "action": action,
                "ros_action": action_name(robot, ros_action.as_ref().unwrap_or(&action))?,
                "direction": direction,
                "type": action_type.name(),
                "network": network,
            }));
        }
    }
    Ok(json!({
        "robot": file.name,
        "is_emulated": file.is_emulated(),
        "node": file.node_name()?.to_string(),
        "modules": modules,
        "topics": topics,
        "exposed": exposed,
        "actions": actions,
        "features": features,
        "networks": networks,
        "services": services,
        "calls": calls,
        "parameters": parameters,
        "lifecycle": lifecycle,
        "recorded": file.record.topics,
    }))
}

fn type_name(topic: &TopicInfo, interfaces: &Interfaces) -> &'static str {
    interfaces.message_in(topic).map_or(topic.message_type, KnownType::name)
}

fn list_kinds(catalog: &Catalog) {
    for kind in catalog.kinds() {
        let mut core = Core::new();
        println!("{:<20} {}", kind.name(), kind.about());
        let [required, optional] = kind.keys();
        if !required.is_empty() {
            println!("    keys: {}", [required, optional].concat().join(", "));
            println!();
            continue;
        }
        let source = ModuleSource::default();
        match kind.add_to(&mut core, kind.name(), kind.options(), &source, &catalog.interfaces) {
            Ok(()) => {
                print_settings(&core, kind.name());
                core.topics().for_each(|topic| print_topic(topic, &catalog.interfaces));
            }
            // What it publishes depends on settings that have no default.
            Err(needed) => println!("    has no module without settings: {needed}"),
        }
        println!();
    }
    print_missing_kinds(catalog);
}

fn print_settings(core: &Core, module: &str) {
    for setting in core.settings(module).unwrap_or_default() {
        println!("    {} = {}   {}", setting.name, setting.value, setting.description);
    }
}

fn print_topic(topic: &TopicInfo, interfaces: &Interfaces) {
    let type_name = type_name(topic, interfaces);
    let role = if topic.is_published { "published" } else { "subscribed" };
    println!("  {:<24} {type_name:<40} {role}", topic.name);
}

/// The report, with names after remapping.
#[derive(Serialize)]
struct NodeReport {
    features: Features,
    networks: Vec<NetworkReport>,
    services: Vec<ServiceReport>,
    /// Services of others that modules call.
    calls: Vec<ServiceReport>,
    parameters: Vec<ParameterReport>,
    lifecycle: Vec<LifecycleReport>,
}

#[derive(Serialize)]
struct Features {
    rosout: bool,
    logger_service: bool,
    expose_service: bool,
    controller_manager: bool,
    diagnostics: bool,
    network: bool,
    /// `own`, `publish` or `follow`, as in the robot file.
    clock: &'static str,
    /// How often the time is published.
    #[serde(skip_serializing_if = "Option::is_none")]
    clock_hz: Option<f64>,
}

/// What the node has in a further network.
#[derive(Serialize)]
struct NetworkReport {
    network: String,
    parameters: bool,
    rosout: bool,
}

#[derive(Serialize)]
struct ServiceReport {
    service: String,
    ros_service: String,
    #[serde(rename = "type")]
    type_name: &'static str,
    timeout_s: f64,
    /// `None` for the robot's own.
    #[serde(skip_serializing_if = "Option::is_none")]
    network: Option<String>,
    /// What clients receive for a request that is refused; `None` for a service of others.
    #[serde(skip_serializing_if = "Option::is_none")]
    refusal: Option<String>,
}

#[derive(Serialize)]
struct ParameterReport {
    name: String,
    /// In the syntax of robot files.
    value: String,
    is_read_only: bool,
}

#[derive(Serialize)]
struct LifecycleReport {
    module: String,
    node: String,
}

impl NodeReport {
    fn of(robot: &Robot) -> anyhow::Result<Self> {
        let (file, node) = (&robot.file, robot.file.node_name()?);
        let service = |exposure: &ServiceExposure| {
            anyhow::Ok(ServiceReport {
                service: exposure.service.clone(),
                ros_service: service_name(robot, exposure.ros_service(), &node)?,
                type_name: exposure.service_type.name(),
                timeout_s: exposure.timeout.as_secs_f64(),
                network: exposure.network.clone(),
                refusal: None,
            })
        };
        let offered = robot.service_exposures()?;
        let offered = offered.iter().map(|offered| {
            let refusal = Some(offered.service_type.refusals().to_string());
            Ok(ServiceReport { refusal, ..service(offered)? })
        });
        let called = robot.call_exposures()?;
        let called = called.iter().map(service);
        let lifecycle = robot.lifecycle_exposures()?.into_iter().map(|exposure| {
            let node = file.remaps.node(&exposure.node)?.to_string();
            anyhow::Ok(LifecycleReport { module: exposure.module, node })
        });
        let networks = file.networks.iter().map(|network| NetworkReport {
            network: network.name.clone(),
            parameters: network.parameters,
            rosout: network.rosout && !file.is_rosout_disabled,
        });
        Ok(Self {
            networks: networks.collect(),
            features: Features::of(&file.expose.features, file.is_rosout_disabled),
            services: offered.collect::<anyhow::Result<_>>()?,
            calls: called.collect::<anyhow::Result<_>>()?,
            parameters: parameters(robot)?,
            lifecycle: lifecycle.collect::<Result<_, _>>()?,
        })
    }
}

impl Features {
    fn of(features: &NodeFeatures, is_rosout_disabled: bool) -> Self {
        let (clock, clock_hz) = match features.clock {
            ClockChoice::Own => ("own", None),
            ClockChoice::Publish(period) => ("publish", Some((1e6 / period.as_secs_f64()).round() / 1e6)),
            ClockChoice::Follow => ("follow", None),
        };
        Self {
            rosout: features.rosout && !is_rosout_disabled,
            logger_service: features.logger_service,
            expose_service: features.expose_service,
            controller_manager: features.controller_manager,
            diagnostics: features.diagnostics,
            network: features.network,
            clock,
            clock_hz,
        }
    }
}

/// The network of an endpoint, as endpoints of topics print it.
fn on(network: Option<&str>) -> String {
    network.map(|network| format!(", on {network}")).unwrap_or_default()
}

fn service_name(robot: &Robot, name: &str, node: &NodeName) -> anyhow::Result<String> {
    Ok(robot.file.remaps.service(ServiceName::expand(name, node)?, node)?.to_string())
}

/// The name of an action, which is that of its services without the end.
fn action_name(robot: &Robot, name: &str) -> anyhow::Result<String> {
    const GOALS: &str = "/_action/send_goal";
    let goals = service_name(robot, &format!("{name}{GOALS}"), &robot.file.node_name()?)?;
    Ok(goals.strip_suffix(GOALS).unwrap_or(&goals).to_owned())
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
        for NetworkReport { network, parameters, rosout } in &self.networks {
            if *rosout {
                writeln!(f, "  log -> {}, on {network}", rosout::TOPIC)?;
            }
            if *parameters {
                writeln!(f, "  parameters, on {network}")?;
            }
        }
        for (arrow, services) in [("->", &self.services), ("<-", &self.calls)] {
            for ServiceReport { service, ros_service, type_name, network, refusal, .. } in services {
                let network = on(network.as_deref());
                writeln!(f, "  service {service} {arrow} {ros_service} {type_name}{network}")?;
                if let Some(refusal) = refusal {
                    writeln!(f, "    a refusal: {refusal}")?;
                }
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
            (self.expose_service, "what is exposed <- ~/expose".to_owned()),
            (self.controller_manager, "controllers and hardware <-> node controller_manager".to_owned()),
            (self.network, "what else is on the network -> topic network of the robot".to_owned()),
        ] {
            if is_there {
                writeln!(f, "  {what}")?;
            }
        }
        Ok(())
    }
}
