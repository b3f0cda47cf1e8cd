//! `downbeat check`

use std::path::Path;

use downbeat::bridge::edge::KnownType;
use downbeat::executor::{Core, ModuleOptions, TopicInfo};
use downbeat::robot::{Direction, KINDS, LauncherChoice, Robot, RobotFile};

use super::cli::CheckArguments;

pub(crate) fn check(arguments: &CheckArguments) -> anyhow::Result<()> {
    if arguments.kinds {
        list_kinds()?;
    }
    arguments.robot.as_deref().map_or(Ok(()), check_robot)
}

fn check_robot(path: &Path) -> anyhow::Result<()> {
    let robot = RobotFile::read(path)?.build(Core::new())?;
    let Robot { file, core } = &robot;
    let emulated = if file.is_emulated() { ", emulated" } else { "" };
    let launcher = match file.launcher {
        LauncherChoice::Linear => "on one thread".to_owned(),
        LauncherChoice::Pool(threads) => format!("on {threads} threads"),
    };
    println!("{}: robot {}{emulated}, {launcher}", path.display(), file.name);
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
        kind.add_to(&mut core, kind.name, ModuleOptions::default())?;
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
