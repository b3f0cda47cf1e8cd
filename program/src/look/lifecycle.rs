//! `downbeat lifecycle`

use std::collections::BTreeMap;
use std::time::Duration;

use anyhow::{Context, bail};
use clap::{Args, Subcommand};
use downbeat_bridge::ros::{EndpointKind, Found};
use downbeat_msgs::Service;
use downbeat_msgs::lifecycle_msgs::msg::TransitionDescription;
use downbeat_msgs::lifecycle_msgs::srv::{
    ChangeState, ChangeStateRequest, GetAvailableTransitions, GetAvailableTransitionsRequest, GetState,
    GetStateRequest,
};
use downbeat_msgs::qos::QosProfile;

use super::network::{Environment, Look, LookArguments, Patience, absolute, is_hidden_node};
use super::node;

#[derive(Subcommand)]
pub(crate) enum LifecycleCommand {
    /// Print the state of a managed node, or of all.
    Get(GetArguments),
    /// Trigger a transition of a managed node.
    Set(SetArguments),
    /// List the transitions that are available in a managed node's state, or all of them.
    List(ListArguments),
    /// List managed nodes.
    Nodes(node::ListArguments),
}

#[derive(Args)]
pub(crate) struct GetArguments {
    /// The node; default is all managed nodes.
    node: Option<String>,
    /// Also consider nodes whose name starts with an underscore.
    #[arg(long)]
    include_hidden_nodes: bool,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct SetArguments {
    /// The node.
    node: String,
    /// The transition, by name or number, for example configure.
    transition: String,
    /// Also consider nodes whose name starts with an underscore.
    #[arg(long)]
    include_hidden_nodes: bool,
    #[command(flatten)]
    look: LookArguments,
}

#[derive(Args)]
pub(crate) struct ListArguments {
    /// The node.
    node: String,
    /// List all transitions, not only those from the present state.
    #[arg(short, long)]
    all: bool,
    /// Also consider nodes whose name starts with an underscore.
    #[arg(long)]
    include_hidden_nodes: bool,
    #[command(flatten)]
    look: LookArguments,
}

pub(crate) fn lifecycle(command: &LifecycleCommand, environment: &Environment<'_>) -> anyhow::Result<()> {
    match command {
        LifecycleCommand::Get(arguments) => get(arguments, environment),
        LifecycleCommand::Set(arguments) => set(arguments, environment),
        LifecycleCommand::List(arguments) => list(arguments, environment),
        LifecycleCommand::Nodes(arguments) => nodes(arguments, environment),
    }
}

/// How long a node may take to answer; transitions can be slow.
const PATIENCE: Duration = Duration::from_secs(60);

/// Managed nodes: those with the service that returns their state.
fn managed(found: &Found, with_hidden: bool) -> Vec<String> {
    let servers = found.endpoints.iter().filter(|endpoint| endpoint.kind == EndpointKind::Server);
    let states = servers.filter(|server| server.type_name == GetState::TYPE_NAME);
    let mut nodes: Vec<_> =
        states.filter_map(|server| server.name.strip_suffix("/get_state")).map(str::to_owned).collect();
    nodes.retain(|node| with_hidden || !is_hidden_node(node));
    nodes.dedup();
    nodes
}

/// # Errors
/// Returns an error if there is no such managed node.
fn managed_node(look: &Look, node: &str, with_hidden: bool) -> anyhow::Result<String> {
    let node = absolute(node);
    let found = look.found_with(|found| managed(found, with_hidden).contains(&node));
    if !managed(&found, with_hidden).contains(&node) {
        bail!("Node not found");
    }
    Ok(node)
}

fn ask<S: Service>(
    look: &Look,
    node: &str,
    service: &str,
    request: &S::Request,
) -> anyhow::Result<S::Response> {
    let client = look.node.client::<S>(&format!("{node}/{service}"), QosProfile::SERVICES)?;
    look.wait_for(Some(PATIENCE), || client.is_available());
    let answer = client.call_and_wait(request, PATIENCE);
    answer.with_context(|| format!("Exception while calling service of node '{node}'"))
}

fn get(arguments: &GetArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("lifecycle", &arguments.look, environment)?;
    let with_hidden = arguments.include_hidden_nodes;
    let state = |node: &str| ask::<GetState>(&look, node, "get_state", &GetStateRequest::default());
    if let Some(node) = &arguments.node {
        let state = state(&managed_node(&look, node, with_hidden)?)?.current_state;
        println!("{} [{}]", state.label, state.id);
        return Ok(());
    }
    let nodes = managed(&look.all(Patience::Endpoints), with_hidden);
    let states: BTreeMap<_, _> = nodes.iter().map(|node| (node, state(node))).collect();
    for (node, answer) in states {
        match answer {
            Ok(answer) => {
                println!("{node}: {} [{}]", answer.current_state.label, answer.current_state.id)
            }
            Err(error) => eprintln!("{error:#}"),
        }
    }
    Ok(())
}

fn transitions(look: &Look, node: &str, service: &str) -> anyhow::Result<Vec<TransitionDescription>> {
    let request = GetAvailableTransitionsRequest::default();
    Ok(ask::<GetAvailableTransitions>(look, node, service, &request)?.available_transitions)
}

fn set(arguments: &SetArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("lifecycle", &arguments.look, environment)?;
    let node = managed_node(&look, &arguments.node, arguments.include_hidden_nodes)?;
    let available = transitions(&look, &node, "get_available_transitions")?;
    let wanted = &arguments.transition;
    let labelled = available.iter().find(|known| known.transition.label == *wanted);
    let numbered = || available.iter().find(|known| known.transition.id.to_string() == *wanted);
    let Some(chosen) = labelled.or_else(numbered) else {
        let names: String = available
            .iter()
            .map(|known| format!("\n- {} [{}]", known.transition.label, known.transition.id))
            .collect();
        bail!("Unknown transition requested, available ones are:{names}");
    };
    let request = ChangeStateRequest { transition: chosen.transition.clone() };
    if !ask::<ChangeState>(&look, &node, "change_state", &request)?.success {
        bail!("Transitioning failed");
    }
    println!("Transitioning successful");
    Ok(())
}

fn list(arguments: &ListArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("lifecycle", &arguments.look, environment)?;
    let node = managed_node(&look, &arguments.node, arguments.include_hidden_nodes)?;
    let service = if arguments.all { "get_transition_graph" } else { "get_available_transitions" };
    for TransitionDescription { transition, start_state, goal_state } in transitions(&look, &node, service)? {
        println!(
            "- {} [{}]\n\tStart: {}\n\tGoal: {}",
            transition.label, transition.id, start_state.label, goal_state.label
        );
    }
    Ok(())
}

fn nodes(arguments: &node::ListArguments, environment: &Environment<'_>) -> anyhow::Result<()> {
    let look = Look::join("lifecycle", &arguments.look, environment)?;
    let nodes = managed(&look.all(Patience::Endpoints), arguments.all);
    if arguments.count_nodes {
        println!("{}", nodes.len());
    } else {
        nodes.iter().for_each(|node| println!("{node}"));
    }
    Ok(())
}
