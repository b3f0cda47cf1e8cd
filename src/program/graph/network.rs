//! The graph of the network.

use crate::executor::{Graph, GraphEdge, GraphModule, GraphService, GraphTopic};
use crate::msgs::downbeat_interfaces::msg::{NetworkEndpoint, NetworkGraph};
use crate::msgs::qos::{Durability, Liveliness, Reliability};
use crate::robot::{Catalog, RosArgs};
use serde_json::{Value, json};

use crate::program::cli::GraphArguments;
use crate::program::look::{Environment, Look, Patience};

/// Joins the domain under a hidden name and waits until the node of every endpoint is known, or a time-out.
pub(super) fn look(
    arguments: &GraphArguments,
    catalog: &Catalog,
    ros: &RosArgs,
) -> anyhow::Result<NetworkGraph> {
    // Hidden like the nodes of ROS 2 tools.
    let name = format!("_downbeat_graph_{}", std::process::id());
    let look = Look::join_as(&name, arguments.domain, arguments.wait, &Environment { catalog, ros })?;
    Ok(look.all(Patience::Nodes).into())
}

/// What an endpoint offers or requests.
pub(super) fn policies(endpoint: &NetworkEndpoint) -> (Reliability, Durability, Liveliness) {
    (
        if endpoint.is_reliable { Reliability::Reliable } else { Reliability::BestEffort },
        if endpoint.is_transient_local { Durability::TransientLocal } else { Durability::Volatile },
        if endpoint.is_manual_by_topic { Liveliness::ManualByTopic } else { Liveliness::Automatic },
    )
}

/// The name of a kind of endpoint.
pub(super) fn kind(endpoint: &NetworkEndpoint) -> &'static str {
    match endpoint.kind {
        NetworkEndpoint::PUBLISHER => "publisher",
        NetworkEndpoint::SUBSCRIPTION => "subscription",
        NetworkEndpoint::SERVER => "server",
        _ => "client",
    }
}

pub(super) fn is_of_topic(endpoint: &NetworkEndpoint) -> bool {
    matches!(endpoint.kind, NetworkEndpoint::PUBLISHER | NetworkEndpoint::SUBSCRIPTION)
}

pub(super) fn as_json(network: &NetworkGraph) -> Value {
    let nodes: Vec<_> = network
        .nodes
        .iter()
        .map(|node| {
            let participant: String = node.participant.iter().map(|byte| format!("{byte:02x}")).collect();
            json!({ "name": node.name, "vendor": node.vendor, "participant": participant })
        })
        .collect();
    let endpoint = |endpoint: &NetworkEndpoint| {
        let told = |text: &String| (!text.is_empty()).then(|| text.clone());
        let (reliability, durability, liveliness) = policies(endpoint);
        let limit = |nanoseconds: i64| (nanoseconds > 0).then_some(nanoseconds);
        json!({
            "kind": kind(endpoint),
            "name": endpoint.name,
            "type": endpoint.r#type,
            "type_hash": told(&endpoint.type_hash),
            "node": told(&endpoint.node),
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
pub(super) fn as_graph(network: &NetworkGraph) -> Graph {
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
