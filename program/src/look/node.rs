//! `downbeat node`

use anyhow::bail;
use clap::{Args, Subcommand};
use downbeat_bridge::ros::EndpointKind;

use super::network::{
    Environment, Look, LookArguments, NamesAndTypes, Patience, absolute, actions, is_hidden, joined,
    names_and_types, node_names,
};

#[derive(Subcommand)]
pub(crate) enum NodeCommand {
    /// List nodes.
    List(ListArguments),
    /// Print the topics, services and actions of a node.
    Info(InfoArguments),
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// Also print nodes whose name starts with an underscore.
    #[arg(short, long)]
    pub(super) all: bool,
    /// Print only the number.
    #[arg(short, long)]
    pub(super) count_nodes: bool,
    #[command(flatten)]
    pub(super) look: LookArguments,
}

#[derive(Args)]
pub(crate) struct InfoArguments {
    /// The node.
    node: String,
    /// Also print names with a part that starts with an underscore.
    #[arg(long)]
    include_hidden: bool,
    #[command(flatten)]
    look: LookArguments,
}

pub(crate) fn node(command: &NodeCommand, environment: &Environment<'_>) -> anyhow::Result<()> {
    match command {
        NodeCommand::List(arguments) => list(arguments, environment),
        NodeCommand::Info(arguments) => info(arguments, environment),
    }
}

fn list(arguments: &ListArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("node", &arguments.look, environment)?;
    let found = look.all(Patience::Nodes);
    let names = node_names(&found, arguments.all);
    if arguments.count_nodes {
        println!("{}", names.len());
        return Ok(());
    }
    if names.windows(2).any(|pair| pair[0] == pair[1]) {
        eprintln!(
            "WARNING: Be aware that there are nodes in the graph that share an exact name, which can have unintended side \
             effects."
        );
    }
    names.iter().for_each(|name| println!("{name}"));
    Ok(())
}

fn info(arguments: &InfoArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("node", &arguments.look, environment)?;
    let name = absolute(&arguments.node);
    let found = look.all_with(Patience::Nodes, |found| node_names(found, true).contains(&&*name));
    let count = node_names(&found, arguments.include_hidden).iter().filter(|known| **known == name).count();
    match count {
        0 => bail!("Unable to find node '{}'", arguments.node),
        1 => {}
        _ => eprintln!(
            "There are {count} nodes in the graph with the exact name \"{name}\". You are seeing information about only one \
             of them."
        ),
    }
    println!("{name}");
    let identities = found.nodes.iter().filter(|node| node.name == name && !node.identity.is_empty());
    identities.for_each(|node| println!("  Secured as: {}", node.identity));
    let node = Some(&*name);
    let names = |kind| names_and_types(&found, &[kind], node);
    let print = |title: &str, names: NamesAndTypes| {
        println!("  {title}:");
        let shown = names.iter().filter(|(name, _)| arguments.include_hidden || !is_hidden(name));
        let lines: Vec<_> = shown.map(|(name, types)| format!("    {name}: {}", joined(types))).collect();
        println!("{}", lines.join("\n"));
    };
    print("Subscribers", names(EndpointKind::Subscription));
    print("Publishers", names(EndpointKind::Publisher));
    print("Service Servers", names(EndpointKind::Server));
    print("Service Clients", names(EndpointKind::Client));
    print("Action Servers", actions(&found, &[EndpointKind::Publisher], node));
    print("Action Clients", actions(&found, &[EndpointKind::Subscription], node));
    Ok(())
}
