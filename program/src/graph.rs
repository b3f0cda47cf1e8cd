//! `downbeat graph`

use std::fmt::Write;
use std::path::Path;

use serde_json::{Value, json};

use super::cli::{GraphArguments, GraphFormat};
use crate::look::{Environment, Look, Patience};
use downbeat_executor::{Core, Graph, GraphEdge, GraphModule, GraphService, GraphTopic};
use downbeat_msgs::downbeat_interfaces::msg::{NetworkEndpoint, NetworkGraph};
use downbeat_msgs::qos::{Durability, Liveliness, Reliability};
use downbeat_robot::{Catalog, Robot, RobotFile, RosArgs};

pub(crate) fn graph(arguments: &GraphArguments, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<()> {
    let format = if arguments.json { Some(GraphFormat::Json) } else { arguments.format };
    match &arguments.robot {
        Some(path) => {
            let graph = of_robot(path, catalog, ros)?;
            match format.unwrap_or(GraphFormat::Dot) {
                GraphFormat::Dot => print!("{}", graph.to_dot()),
                GraphFormat::Mermaid => print!("{}", graph.to_mermaid()),
                GraphFormat::Json => println!("{}", serde_json::to_string_pretty(&graph)?),
                GraphFormat::Text => print!("{}", robot_text(&graph)),
            }
        }
        None => {
            let network = look(arguments, catalog, ros)?;
            match format.unwrap_or(GraphFormat::Text) {
                GraphFormat::Dot => print!("{}", as_graph(&network).to_dot()),
                GraphFormat::Mermaid => print!("{}", as_graph(&network).to_mermaid()),
                GraphFormat::Json => {
                    println!("{}", serde_json::to_string_pretty(&as_json(&network))?)
                }
                GraphFormat::Text => print!("{}", network_text(&network)),
            }
        }
    }
    Ok(())
}

pub(super) fn of_robot(path: &Path, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<Graph> {
    let Robot { core, file, .. } =
        RobotFile::read_with(path, catalog, ros)?.on_any_machine().build(Core::new())?;
    let mut graph = core.graph();
    // With their ROS names, if they have one.
    for topic in core.topics() {
        let shown = graph.topics.iter_mut().find(|shown| *shown.name == *topic.name);
        if let (Some(shown), Some(known)) = (shown, file.catalog.interfaces.message_in(topic)) {
            shown.message_type = known.name().to_owned();
        }
    }
    Ok(graph)
}

/// Joins the domain under a hidden name and waits until the node of every endpoint is known, or a time-out.
fn look(arguments: &GraphArguments, catalog: &Catalog, ros: &RosArgs) -> anyhow::Result<NetworkGraph> {
    // Hidden like the nodes of ROS 2 tools.
    let name = format!("_downbeat_graph_{}", std::process::id());
    let look = Look::join_as(&name, &arguments.network, arguments.wait, &Environment { catalog, ros })?;
    Ok(look.all(Patience::Nodes).into())
}

/// The QoS that an endpoint offers or requests.
fn policies(endpoint: &NetworkEndpoint) -> (Reliability, Durability, Liveliness) {
    (
        if endpoint.is_reliable { Reliability::Reliable } else { Reliability::BestEffort },
        if endpoint.is_transient_local { Durability::TransientLocal } else { Durability::Volatile },
        if endpoint.is_manual_by_topic { Liveliness::ManualByTopic } else { Liveliness::Automatic },
    )
}

/// The name of a kind of endpoint.
fn kind(endpoint: &NetworkEndpoint) -> &'static str {
    match endpoint.kind {
        NetworkEndpoint::PUBLISHER => "publisher",
        NetworkEndpoint::SUBSCRIPTION => "subscription",
        NetworkEndpoint::SERVER => "server",
        _ => "client",
    }
}

fn is_of_topic(endpoint: &NetworkEndpoint) -> bool {
    matches!(endpoint.kind, NetworkEndpoint::PUBLISHER | NetworkEndpoint::SUBSCRIPTION)
}

fn as_json(network: &NetworkGraph) -> Value {
    let nodes: Vec<_> = network
        .nodes
        .iter()
        .map(|node| {
            let participant: String = node.participant.iter().map(|byte| format!("{byte:02x}")).collect();
            let identity = (!node.identity.is_empty()).then_some(&node.identity);
            json!({
                "name": node.name,
                "vendor": node.vendor,
                "identity": identity,
                "participant": participant,
            })
        })
        .collect();
    let endpoint = |endpoint: &NetworkEndpoint| {
        let non_empty = |text: &String| (!text.is_empty()).then(|| text.clone());
        let (reliability, durability, liveliness) = policies(endpoint);
        let limit = |nanoseconds: i64| (nanoseconds > 0).then_some(nanoseconds);
        json!({
            "kind": kind(endpoint),
            "name": endpoint.name,
            "type": endpoint.r#type,
            "type_hash": non_empty(&endpoint.type_hash),
            "node": non_empty(&endpoint.node),
            "reliability": reliability,
            "durability": durability,
            "deadline_ns": limit(endpoint.deadline_ns),
            "liveliness": liveliness,
            "liveliness_lease_ns": limit(endpoint.liveliness_lease_ns),
        })
    };
    json!({ "nodes": nodes, "endpoints": network.endpoints.iter().map(endpoint).collect::<Vec<_>>() })
}

/// Converts it to the executor's graph: nodes instead of modules, and one node for endpoints without a node.
fn as_graph(network: &NetworkGraph) -> Graph {
    let mut graph = Graph::default();
    for endpoint in &network.endpoints {
        let name = if endpoint.node.is_empty() { "(unknown node)" } else { &endpoint.node };
        let module = position(
            &mut graph.modules,
            |node| node.name == name,
            || GraphModule { name: name.to_owned(), is_detached: false },
        );
        let edge = if is_of_topic(endpoint) {
            let topic = position(
                &mut graph.topics,
                |topic| topic.name == endpoint.name,
                || GraphTopic { name: endpoint.name.clone(), message_type: endpoint.r#type.clone() },
            );
            match endpoint.kind {
                NetworkEndpoint::PUBLISHER => GraphEdge::Publishes { module, topic },
                _ => GraphEdge::Subscribes { module, topic },
            }
        } else {
            let service = position(
                &mut graph.services,
                |service| service.name == endpoint.name,
                || GraphService {
                    name: endpoint.name.clone(),
                    request_type: format!("{}_Request", endpoint.r#type),
                    response_type: format!("{}_Response", endpoint.r#type),
                },
            );
            match endpoint.kind {
                NetworkEndpoint::SERVER => GraphEdge::Serves { module, service },
                _ => GraphEdge::Calls { module, service },
            }
        };
        graph.edges.push(edge);
    }
    graph
}

/// The position in the list, to which it is appended if missing.
fn position<T>(list: &mut Vec<T>, is_it: impl Fn(&T) -> bool, make: impl FnOnce() -> T) -> usize {
    list.iter().position(is_it).unwrap_or_else(|| {
        list.push(make());
        list.len() - 1
    })
}

/// A network: its nodes, then topics and services with their endpoints.
fn network_text(network: &NetworkGraph) -> String {
    // Writing to a String cannot fail.
    let mut text = String::new();
    let _ = writeln!(text, "nodes");
    for node in &network.nodes {
        let secured =
            if node.identity.is_empty() { String::new() } else { format!(", secured as {}", node.identity) };
        let _ = writeln!(text, "  {:<40} {}{secured}", node.name, node.vendor);
    }
    let (topics, services): (Vec<_>, Vec<_>) =
        network.endpoints.iter().partition(|endpoint| is_of_topic(endpoint));
    for (title, mut endpoints) in [("topics", topics), ("services", services)] {
        let _ = writeln!(text, "\n{title}");
        endpoints.sort_by_key(|endpoint| &endpoint.name);
        let mut last = None;
        for endpoint in endpoints {
            let heading = (&endpoint.name, &endpoint.r#type);
            if last.replace(heading) != Some(heading) {
                let _ = writeln!(text, "  {:<40} {}", endpoint.name, endpoint.r#type);
            }
            let node = if endpoint.node.is_empty() { "(unknown node)" } else { &endpoint.node };
            let _ = writeln!(text, "    {:<12} {node:<32} {}", kind(endpoint), offer(endpoint));
        }
    }
    text
}

fn offer(endpoint: &NetworkEndpoint) -> String {
    let (reliability, durability, liveliness) = policies(endpoint);
    let mut offer = format!("{reliability} {durability}");
    for (name, nanoseconds) in [("deadline", endpoint.deadline_ns), ("lease", endpoint.liveliness_lease_ns)] {
        if let Some(nanoseconds) = u64::try_from(nanoseconds).ok().filter(|&nanoseconds| nanoseconds > 0) {
            let _ = write!(offer, " {name} {:?}", std::time::Duration::from_nanos(nanoseconds));
        }
    }
    if liveliness == Liveliness::ManualByTopic {
        let _ = write!(offer, " {liveliness}");
    }
    if !endpoint.type_hash.is_empty() {
        let _ = write!(offer, " {}", endpoint.type_hash);
    }
    offer
}

/// A robot: its modules with their topics and services.
fn robot_text(graph: &Graph) -> String {
    let mut text = String::new();
    let mut edges = graph.edges.clone();
    edges.sort_unstable();
    for (index, module) in graph.modules.iter().enumerate() {
        let _ = writeln!(text, "{}{}", module.name, if module.is_detached { " (detached)" } else { "" });
        for edge in &edges {
            let (of, what, name) = match *edge {
                GraphEdge::Publishes { module, topic } => (module, "publishes", topic_name(graph, topic)),
                GraphEdge::Subscribes { module, topic } => (module, "subscribes", topic_name(graph, topic)),
                GraphEdge::Calls { module, service } => (module, "calls", service_name(graph, service)),
                GraphEdge::Serves { module, service } => (module, "serves", service_name(graph, service)),
                GraphEdge::Leaves { .. } => continue,
            };
            if of == index {
                let _ = writeln!(text, "  {what:<12} {name}");
            }
        }
    }
    for (index, outlet) in graph.outlets.iter().enumerate() {
        let _ = writeln!(text, "{} (outlet)", outlet.name);
        for edge in &edges {
            if let GraphEdge::Leaves { topic, outlet } = *edge
                && outlet == index
            {
                let _ = writeln!(text, "  {:<12} {}", "takes", topic_name(graph, topic));
            }
        }
    }
    text
}

fn topic_name(graph: &Graph, topic: usize) -> String {
    let topic = graph.topics.get(topic);
    topic.map_or_else(String::new, |topic| format!("{:<40} {}", topic.name, topic.message_type))
}

fn service_name(graph: &Graph, service: usize) -> String {
    let service = graph.services.get(service);
    service.map_or_else(String::new, |service| format!("{:<40} {}", service.name, service.request_type))
}

#[cfg(test)]
mod tests {
    use super::*;
    use downbeat_msgs::downbeat_interfaces::msg::NetworkNode;

    #[test]
    fn a_network_is_written_by_topic_and_service() {
        let endpoint = |kind: u8, name: &str, node: &str| NetworkEndpoint {
            kind,
            name: name.to_owned(),
            r#type: "std_msgs/msg/String".to_owned(),
            node: node.to_owned(),
            is_reliable: true,
            ..NetworkEndpoint::default()
        };
        let hashed = NetworkEndpoint {
            type_hash: "RIHS01_df".to_owned(),
            deadline_ns: 50_000_000,
            ..endpoint(NetworkEndpoint::SUBSCRIPTION, "/chatter", "")
        };
        let network = NetworkGraph {
            nodes: vec![NetworkNode {
                name: "/talker".to_owned(),
                vendor: "RustDDS".to_owned(),
                ..NetworkNode::default()
            }],
            endpoints: vec![
                endpoint(NetworkEndpoint::PUBLISHER, "/chatter", "/talker"),
                hashed,
                endpoint(NetworkEndpoint::SERVER, "/reset", "/talker"),
            ],
        };
        let words: Vec<_> = network_text(&network)
            .lines()
            .map(|line| line.split_whitespace().collect::<Vec<_>>().join(" "))
            .collect();
        assert_eq!(
            words,
            [
                "nodes",
                "/talker RustDDS",
                "",
                "topics",
                "/chatter std_msgs/msg/String",
                "publisher /talker reliable volatile",
                "subscription (unknown node) reliable volatile deadline 50ms RIHS01_df",
                "",
                "services",
                "/reset std_msgs/msg/String",
                "server /talker reliable volatile",
            ]
        );
    }
}
