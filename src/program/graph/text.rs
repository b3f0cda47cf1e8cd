//! Graphs as lines of text.

use std::fmt::Write;

use crate::executor::{Graph, GraphEdge};
use crate::msgs::downbeat_interfaces::msg::{NetworkEndpoint, NetworkGraph};
use crate::msgs::qos::Liveliness;

use super::network::{is_of_topic, kind, policies};

/// A network: its nodes, then topics and services with their endpoints.
pub(super) fn of_network(network: &NetworkGraph) -> String {
    // Writing to a String cannot fail.
    let mut text = String::new();
    let _ = writeln!(text, "nodes");
    for node in &network.nodes {
        let _ = writeln!(text, "  {:<40} {}", node.name, node.vendor);
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
pub(super) fn of_robot(graph: &Graph) -> String {
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
    use crate::msgs::downbeat_interfaces::msg::NetworkNode;

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
        let words: Vec<_> = of_network(&network)
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
