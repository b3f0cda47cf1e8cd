//! `downbeat check`

use std::path::Path;

use downbeat::bridge::edge::KnownType;
use downbeat::executor::{Core, TopicInfo};
use downbeat::robot::{Direction, KINDS, Robot};

use super::cli::CheckArguments;
use super::session::add_diagnostics;

pub(crate) fn check(arguments: &CheckArguments) -> anyhow::Result<()> {
    if arguments.kinds {
        list_kinds()?;
    }
    arguments.robot.as_deref().map_or(Ok(()), |path| check_robot(path, arguments))
}

fn check_robot(path: &Path, arguments: &CheckArguments) -> anyhow::Result<()> {
    let file = arguments.parameters.read_robot(path)?;
    for problem in file.thread_problems() {
        tracing::warn!("on this machine the robot does not run: {problem}");
    }
    let mut core = Core::new();
    add_diagnostics(&mut core, &file)?;
    let robot = file.on_any_machine().build(core)?;
    if arguments.dump_params {
        print!("{}", robot.parameters());
        return Ok(());
    }
    let Robot { file, core } = &robot;
    let emulated = if file.is_emulated() { ", emulated" } else { "" };
    println!("{}: robot {}{emulated}, {}", path.display(), file.name, file.launcher.choice);
    println!("\nmodules");
    for module in &file.modules {
        println!("  {:<20} {:<20} {}", module.name, module.kind.name, module.kind.about);
        print_settings(core, &module.name);
    }
    println!("\ntopics");
    core.topics().for_each(print_topic);
    println!("\nexposed to ROS 2 as node {}", file.name);
    for entry in &file.expose {
        let arrow = if entry.direction == Direction::Out { "->" } else { "<-" };
        println!("  {:<24} {arrow} {}", entry.topic, entry.ros_topic);
    }
    match &file.record.topics {
        None => println!("\nrecorded with --record: all topics"),
        Some(topics) => println!("\nrecorded with --record: {}", topics.join(", ")),
    }
    Ok(())
}

fn list_kinds() -> anyhow::Result<()> {
    for kind in KINDS {
        let mut core = Core::new();
        kind.add_to(&mut core, kind.name, kind.options())?;
        println!("{:<20} {}", kind.name, kind.about);
        print_settings(&core, kind.name);
        core.topics().for_each(print_topic);
        println!();
    }
    Ok(())
}

fn print_settings(core: &Core, module: &str) {
    for setting in core.settings(module).unwrap_or_default() {
        println!("    {} = {}   {}", setting.name, setting.value, setting.description);
    }
}

fn print_topic(topic: &TopicInfo) {
    let type_name =
        KnownType::of_rust_type(topic.message_type_id).map_or(topic.message_type, KnownType::name);
    let role = if topic.is_published { "published" } else { "subscribed" };
    println!("  {:<24} {type_name:<40} {role}", topic.name);
}
