//! `downbeat graph`

use downbeat::bridge::edge::KnownType;
use downbeat::executor::Core;
use downbeat::robot::RobotFile;

use super::cli::{GraphArguments, GraphFormat};

pub(crate) fn graph(arguments: &GraphArguments) -> anyhow::Result<()> {
    let core = RobotFile::read(&arguments.robot)?.on_any_machine().build(Core::new())?.core;
    let mut graph = core.graph();
    // Under the names that ROS gives them, where it does.
    for topic in core.topics() {
        let shown = graph.topics.iter_mut().find(|shown| *shown.name == *topic.name);
        if let (Some(shown), Some(known)) = (shown, KnownType::of_rust_type(topic.message_type_id)) {
            shown.message_type = known.name().to_owned();
        }
    }
    let text = match arguments.format {
        GraphFormat::Dot => graph.to_dot(),
        GraphFormat::Mermaid => graph.to_mermaid(),
    };
    print!("{text}");
    Ok(())
}
