//! The graph of modules, topics and services.

use std::fmt::Write;

use super::markup::{dot_string, mermaid_string, short_type};

/// The connections of modules, topics, services and outlets.
///
/// ```
/// use downbeat_executor::{Graph, GraphEdge, GraphModule, GraphTopic};
///
/// let graph = Graph {
///     modules: vec![GraphModule { name: "camera".into(), is_detached: true }],
///     topics: vec![GraphTopic { name: "image".into(), message_type: "Image".into() }],
///     services: Vec::new(),
///     outlets: Vec::new(),
///     edges: vec![GraphEdge::Publishes { module: 0, topic: 0 }],
/// };
/// assert!(graph.to_dot().contains("m0 -> t0;"));
/// assert!(graph.to_mermaid().contains("m0 --> t0"));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Graph {
    /// The modules, in the order of registration.
    pub modules: Vec<GraphModule>,
    /// The topics, in the order in which they were first declared.
    pub topics: Vec<GraphTopic>,
    /// The services, in the order in which they were first declared.
    pub services: Vec<GraphService>,
    /// The inboxes of outlets, in the order in which they were first used.
    #[cfg_attr(feature = "serde", serde(default))]
    pub outlets: Vec<GraphOutlet>,
    /// The connections.
    pub edges: Vec<GraphEdge>,
}

/// A module of a [`Graph`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GraphModule {
    /// The name.
    pub name: String,
    /// True if the module runs on a separate thread.
    pub is_detached: bool,
}

/// A topic of a [`Graph`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GraphTopic {
    /// The name, without a leading slash.
    pub name: String,
    /// The Rust path of the message type, or its ROS name.
    pub message_type: String,
}

/// A service of a [`Graph`].
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GraphService {
    /// The name, without a leading slash.
    pub name: String,
    /// The Rust path of the request type.
    pub request_type: String,
    /// The Rust path of the answer type.
    pub response_type: String,
}

/// An inbox of outlets, through which messages leave the core.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct GraphOutlet {
    /// The name of the inbox; the name of the topic if the inbox belongs to a single outlet.
    pub name: String,
}

/// An edge of a [`Graph`], between indices of its vectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize), serde(rename_all = "snake_case"))]
pub enum GraphEdge {
    /// The module publishes on the topic.
    Publishes {
        /// An index of [`Graph::modules`].
        module: usize,
        /// An index of [`Graph::topics`].
        topic: usize,
    },
    /// The module receives the topic's messages.
    Subscribes {
        /// An index of [`Graph::modules`].
        module: usize,
        /// An index of [`Graph::topics`].
        topic: usize,
    },
    /// The module calls the service.
    Calls {
        /// An index of [`Graph::modules`].
        module: usize,
        /// An index of [`Graph::services`].
        service: usize,
    },
    /// The module answers the service's calls.
    Serves {
        /// An index of [`Graph::modules`].
        module: usize,
        /// An index of [`Graph::services`].
        service: usize,
    },
    /// The topic's messages leave through the outlet.
    Leaves {
        /// An index of [`Graph::topics`].
        topic: usize,
        /// An index of [`Graph::outlets`].
        outlet: usize,
    },
}

impl Graph {
    /// The graph in the DOT language, for Graphviz. Modules are boxes, with double borders if detached;
    /// topics are ellipses, services hexagons, outlets tags. Calls are dashed lines.
    #[must_use]
    pub fn to_dot(&self) -> String {
        let mut dot = String::from("digraph robot {\n    rankdir=LR;\n    node [fontname=\"sans-serif\"];\n");
        for (index, GraphModule { name, is_detached }) in self.modules.iter().enumerate() {
            let borders = if *is_detached { ", peripheries=2" } else { "" };
            let label = dot_string(module_lines(name, *is_detached));
            let _ = writeln!(dot, "    m{index} [shape=box{borders}, label={label}];");
        }
        for (index, GraphTopic { name, message_type }) in self.topics.iter().enumerate() {
            let label = dot_string([name.as_str(), &short_type(message_type)]);
            let _ = writeln!(dot, "    t{index} [shape=ellipse, label={label}];");
        }
        for (index, service) in self.services.iter().enumerate() {
            let label = dot_string([service.name.as_str(), &service.types()]);
            let _ = writeln!(dot, "    s{index} [shape=hexagon, label={label}];");
        }
        for (index, GraphOutlet { name }) in self.outlets.iter().enumerate() {
            let label = dot_string([name.as_str()]);
            let _ = writeln!(dot, "    o{index} [shape=cds, label={label}];");
        }
        for edge in self.sorted_edges() {
            let _ = match edge {
                GraphEdge::Publishes { module, topic } => writeln!(dot, "    m{module} -> t{topic};"),
                GraphEdge::Subscribes { module, topic } => writeln!(dot, "    t{topic} -> m{module};"),
                GraphEdge::Calls { module, service } => {
                    writeln!(dot, "    m{module} -> s{service} [style=dashed];")
                }
                GraphEdge::Serves { module, service } => {
                    writeln!(dot, "    s{service} -> m{module} [style=dashed];")
                }
                GraphEdge::Leaves { topic, outlet } => writeln!(dot, "    t{topic} -> o{outlet};"),
            };
        }
        dot.push_str("}\n");
        dot
    }

    /// The graph as a Mermaid flowchart, with the same shapes as [`to_dot`](Self::to_dot).
    #[must_use]
    pub fn to_mermaid(&self) -> String {
        let mut chart = String::from("flowchart LR\n");
        for (index, GraphModule { name, is_detached }) in self.modules.iter().enumerate() {
            let label = mermaid_string(module_lines(name, *is_detached));
            let (open, close) = if *is_detached { ("[[", "]]") } else { ("[", "]") };
            let _ = writeln!(chart, "    m{index}{open}{label}{close}");
        }
        for (index, GraphTopic { name, message_type }) in self.topics.iter().enumerate() {
            let label = mermaid_string([name.as_str(), &short_type(message_type)]);
            let _ = writeln!(chart, "    t{index}([{label}])");
        }
        for (index, service) in self.services.iter().enumerate() {
            let label = mermaid_string([service.name.as_str(), &service.types()]);
            let _ = writeln!(chart, "    s{index}{{{{{label}}}}}");
        }
        for (index, GraphOutlet { name }) in self.outlets.iter().enumerate() {
            let label = mermaid_string([name.as_str()]);
            let _ = writeln!(chart, "    o{index}>{label}]");
        }
        for edge in self.sorted_edges() {
            let _ = match edge {
                GraphEdge::Publishes { module, topic } => writeln!(chart, "    m{module} --> t{topic}"),
                GraphEdge::Subscribes { module, topic } => writeln!(chart, "    t{topic} --> m{module}"),
                GraphEdge::Calls { module, service } => writeln!(chart, "    m{module} -.-> s{service}"),
                GraphEdge::Serves { module, service } => writeln!(chart, "    s{service} -.-> m{module}"),
                GraphEdge::Leaves { topic, outlet } => writeln!(chart, "    t{topic} --> o{outlet}"),
            };
        }
        chart
    }

    /// The edges, sorted and without duplicates, so that the text does not depend on the order of their
    /// collection.
    fn sorted_edges(&self) -> Vec<GraphEdge> {
        let mut edges = self.edges.clone();
        edges.sort_unstable();
        edges.dedup();
        edges
    }
}

impl GraphService {
    fn types(&self) -> String {
        format!("{} → {}", short_type(&self.request_type), short_type(&self.response_type))
    }
}

fn module_lines(name: &str, is_detached: bool) -> impl Iterator<Item = &str> {
    std::iter::once(name).chain(is_detached.then_some("detached"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn example() -> Graph {
        let module = |name: &str, is_detached| GraphModule { name: name.into(), is_detached };
        Graph {
            modules: vec![module("motion", false), module("hard\"ware", true)],
            topics: vec![
                GraphTopic { name: "goals".into(), message_type: "msgs::JointState".into() },
                GraphTopic { name: "raw".into(), message_type: "alloc::vec::Vec<u8>".into() },
            ],
            services: vec![GraphService {
                name: "reset".into(),
                request_type: "a::Reset".into(),
                response_type: "()".into(),
            }],
            outlets: vec![GraphOutlet { name: "bag".into() }],
            edges: vec![
                GraphEdge::Serves { module: 1, service: 0 },
                GraphEdge::Leaves { topic: 1, outlet: 0 },
                GraphEdge::Subscribes { module: 1, topic: 0 },
                GraphEdge::Publishes { module: 1, topic: 1 },
                GraphEdge::Calls { module: 0, service: 0 },
                GraphEdge::Publishes { module: 0, topic: 0 },
                GraphEdge::Publishes { module: 0, topic: 0 },
            ],
        }
    }

    #[test]
    fn the_graph_in_dot() {
        let expected = r#"digraph robot {
    rankdir=LR;
    node [fontname="sans-serif"];
    m0 [shape=box, label="motion"];
    m1 [shape=box, peripheries=2, label="hard\"ware\ndetached"];
    t0 [shape=ellipse, label="goals\nJointState"];
    t1 [shape=ellipse, label="raw\nVec<u8>"];
    s0 [shape=hexagon, label="reset\nReset → ()"];
    o0 [shape=cds, label="bag"];
    m0 -> t0;
    m1 -> t1;
    t0 -> m1;
    m0 -> s0 [style=dashed];
    s0 -> m1 [style=dashed];
    t1 -> o0;
}
"#;
        assert_eq!(example().to_dot(), expected);
    }

    #[test]
    fn the_graph_in_mermaid() {
        let expected = r#"flowchart LR
    m0["motion"]
    m1[["hard#34;ware<br/>detached"]]
    t0(["goals<br/>JointState"])
    t1(["raw<br/>Vec#60;u8#62;"])
    s0{{"reset<br/>Reset → ()"}}
    o0>"bag"]
    m0 --> t0
    m1 --> t1
    t0 --> m1
    m0 -.-> s0
    s0 -.-> m1
    t1 --> o0
"#;
        assert_eq!(example().to_mermaid(), expected);
    }

    #[test]
    fn a_graph_without_anything_is_still_a_graph() {
        assert_eq!(Graph::default().to_mermaid(), "flowchart LR\n");
        assert!(Graph::default().to_dot().ends_with("}\n"));
    }
}
