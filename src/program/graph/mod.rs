//! `downbeat graph`

mod network;
mod text;

use std::path::Path;

use crate::executor::{Core, Graph};
use crate::robot::{Catalog, RobotFile, RosArgs};

use super::cli::{GraphArguments, GraphFormat};

pub(crate) fn graph(arguments: &GraphArguments, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<()> {
    let format = if arguments.json { Some(GraphFormat::Json) } else { arguments.format };
    match &arguments.robot {
        Some(path) => {
            let graph = of_robot(path, catalog, ros)?;
            match format.unwrap_or(GraphFormat::Dot) {
                GraphFormat::Dot => print!("{}", graph.to_dot()),
                GraphFormat::Mermaid => print!("{}", graph.to_mermaid()),
                GraphFormat::Json => println!("{}", serde_json::to_string_pretty(&graph)?),
                GraphFormat::Text => print!("{}", text::of_robot(&graph)),
            }
        }
        None => {
            let network = network::look(arguments, catalog, ros)?;
            match format.unwrap_or(GraphFormat::Text) {
                GraphFormat::Dot => print!("{}", network::as_graph(&network).to_dot()),
                GraphFormat::Mermaid => print!("{}", network::as_graph(&network).to_mermaid()),
                GraphFormat::Json => {
                    println!("{}", serde_json::to_string_pretty(&network::as_json(&network))?)
                }
                GraphFormat::Text => print!("{}", text::of_network(&network)),
            }
        }
    }
    Ok(())
}

fn of_robot(path: &Path, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<Graph> {
    let core = RobotFile::read_with(path, catalog, ros)?.on_any_machine().build(Core::new())?.core;
    let mut graph = core.graph();
    // With their ROS names, if they have one.
    for topic in core.topics() {
        let shown = graph.topics.iter_mut().find(|shown| *shown.name == *topic.name);
        if let (Some(shown), Some(known)) = (shown, catalog.interfaces.message_of(topic.message_type_id)) {
            shown.message_type = known.name().to_owned();
        }
    }
    Ok(graph)
}
