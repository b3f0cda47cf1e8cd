//! `downbeat check`

mod node;

use std::path::Path;

use crate::bridge::edge::{Interfaces, KnownType};
use crate::bridge::expose::ActionExposure;
use crate::executor::{Core, TopicInfo};
use crate::recorder::Unrecorded;
use crate::robot::{Catalog, ExposedEndpoint, Robot, RosArgs};
use serde_json::json;

use node::NodeReport;

use super::cli::CheckArguments;
use crate::running::add_diagnostics;

pub(crate) fn check(arguments: &CheckArguments, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<()> {
    if arguments.kinds {
        list_kinds(catalog)?;
    }
    arguments.robot.as_deref().map_or(Ok(()), |path| check_robot(path, arguments, catalog, ros))
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
    let Robot { file, core } = &robot;
    let emulated = if file.is_emulated() { ", emulated" } else { "" };
    println!("{}: robot {}{emulated}, {}", path.display(), file.name, file.launcher.choice);
    println!("\nmodules");
    for module in &file.modules {
        println!("  {:<20} {:<20} {}", module.name, module.kind.name(), module.kind.about());
        print_settings(core, &module.name);
    }
    println!("\ntopics");
    core.topics().for_each(|topic| print_topic(topic, &catalog.interfaces));
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
            println!("  action {} {arrow} {} {}", action.action, action.ros_action(), action.action_type);
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
    let Robot { file, core } = robot;
    let modules: Vec<_> = file
        .modules
        .iter()
        .map(|module| json!({ "name": module.name, "kind": module.kind.name() }))
        .collect();
    let topics: Vec<_> = core
        .topics()
        .map(|topic| json!({ "name": *topic.name, "type": type_name(topic, &file.catalog.interfaces), "is_published": topic.is_published }))
        .collect();
    let NodeReport { features, services, calls, parameters, lifecycle } = NodeReport::of(robot)?;
    let mut actions = Vec::new();
    for (direction, exposures) in [("out", robot.action_exposures()?), ("in", robot.action_call_exposures()?)]
    {
        for ActionExposure { action, ros_action, action_type, .. } in exposures {
            actions.push(json!({
                "action": action,
                "ros_action": ros_action.as_ref().unwrap_or(&action),
                "direction": direction,
                "type": action_type.name(),
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
        "services": services,
        "calls": calls,
        "parameters": parameters,
        "lifecycle": lifecycle,
        "recorded": file.record.topics,
    }))
}

fn type_name(topic: &TopicInfo, interfaces: &Interfaces) -> &'static str {
    interfaces.message_of(topic.message_type_id).map_or(topic.message_type, KnownType::name)
}

fn list_kinds(catalog: &Catalog) -> anyhow::Result<()> {
    for kind in catalog.kinds() {
        let mut core = Core::new();
        kind.add_to(&mut core, kind.name(), kind.options())?;
        println!("{:<20} {}", kind.name(), kind.about());
        print_settings(&core, kind.name());
        core.topics().for_each(|topic| print_topic(topic, &catalog.interfaces));
        println!();
    }
    Ok(())
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
