//! The graph of modules and topics as text, in layers.

use std::collections::BTreeSet;

use downbeat_executor::{Graph, GraphEdge};

/// The graph as lines: modules in layers, so that messages go down where they can; below each module what it
/// publishes and who receives that. `↺` marks receivers in the same layer or above, and `(no one)` a topic
/// without receivers.
pub(super) fn lines(graph: &Graph) -> Vec<String> {
    let layers = layers(graph);
    let mut lines = Vec::new();
    for layer in 0..=layers.iter().copied().max().unwrap_or(0) {
        for (module, info) in graph.modules.iter().enumerate().filter(|(module, _)| layers[*module] == layer)
        {
            let kind = if info.is_detached { "  detached" } else { "" };
            lines.push(format!("{layer}  {}{kind}", info.name));
            let mut branches: Vec<_> =
                published(graph, module).map(|topic| branch(graph, &layers, module, topic)).collect();
            branches.extend(served(graph, module));
            let last = branches.len().saturating_sub(1);
            lines.extend(
                branches
                    .into_iter()
                    .enumerate()
                    .map(|(index, branch)| format!("   {} {branch}", if index == last { "└" } else { "├" })),
            );
        }
    }
    lines
}

/// A topic of a module, and who receives it.
fn branch(graph: &Graph, layers: &[usize], module: usize, topic: usize) -> String {
    let receivers = subscribers(graph, topic).filter_map(|receiver| {
        let back = if layers[receiver] <= layers[module] { "↺" } else { "" };
        Some(format!("{back}{}", graph.modules.get(receiver)?.name))
    });
    let outlets = graph.edges.iter().filter_map(|edge| match *edge {
        GraphEdge::Leaves { topic: left, outlet } if left == topic => {
            Some(format!("[{}]", graph.outlets.get(outlet)?.name))
        }
        _ => None,
    });
    let receivers: Vec<_> = receivers.chain(outlets).collect();
    let receivers = if receivers.is_empty() { "(no one)".to_owned() } else { receivers.join(", ") };
    let name = graph.topics.get(topic).map_or("?", |topic| topic.name.as_str());
    format!("{name} → {receivers}")
}

/// The services of a module, and who calls them.
fn served(graph: &Graph, module: usize) -> impl Iterator<Item = String> {
    graph.edges.iter().filter_map(move |edge| match *edge {
        GraphEdge::Serves { module: server, service } if server == module => {
            let callers = graph.edges.iter().filter_map(|edge| match *edge {
                GraphEdge::Calls { module, service: called } if called == service => {
                    graph.modules.get(module).map(|module| module.name.as_str())
                }
                _ => None,
            });
            let callers: Vec<_> = callers.collect();
            let callers = if callers.is_empty() { "(no one)".to_owned() } else { callers.join(", ") };
            Some(format!("service {} ← {callers}", graph.services.get(service)?.name))
        }
        _ => None,
    })
}

fn published(graph: &Graph, module: usize) -> impl Iterator<Item = usize> {
    graph.edges.iter().filter_map(move |edge| match *edge {
        GraphEdge::Publishes { module: publisher, topic } if publisher == module => Some(topic),
        _ => None,
    })
}

fn subscribers(graph: &Graph, topic: usize) -> impl Iterator<Item = usize> {
    let count = graph.modules.len();
    graph
        .edges
        .iter()
        .filter_map(move |edge| match *edge {
            GraphEdge::Subscribes { module, topic: subscribed } if subscribed == topic => Some(module),
            _ => None,
        })
        .filter(move |module| *module < count)
}

/// The layer of each module: one below its lowest publisher, where edges that close a circle do not count.
fn layers(graph: &Graph) -> Vec<usize> {
    let receivers = |module| -> BTreeSet<usize> {
        published(graph, module)
            .flat_map(|topic| subscribers(graph, topic))
            .filter(|other| *other != module)
            .collect()
    };
    let receivers: Vec<_> = (0..graph.modules.len()).map(receivers).collect();
    let mut visit = Visit {
        receivers: &receivers,
        state: vec![State::New; receivers.len()],
        order: Vec::new(),
        forward: Vec::new(),
    };
    // Modules that receive nothing first: circles then open where messages enter them.
    let received: BTreeSet<_> = receivers.iter().flatten().copied().collect();
    let (sources, others): (Vec<_>, Vec<_>) =
        (0..receivers.len()).partition(|module| !received.contains(module));
    sources.into_iter().chain(others).for_each(|module| visit.module(module));
    let Visit { order, forward, .. } = visit;
    let mut layers = vec![0; receivers.len()];
    for module in order.into_iter().rev() {
        for (_, receiver) in forward.iter().filter(|(publisher, _)| *publisher == module) {
            layers[*receiver] = layers[*receiver].max(layers[module] + 1);
        }
    }
    layers
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum State {
    New,
    Open,
    Done,
}

/// A search in depth, which leaves out the edges that lead back.
struct Visit<'a> {
    receivers: &'a [BTreeSet<usize>],
    state: Vec<State>,
    /// Receivers before publishers.
    order: Vec<usize>,
    forward: Vec<(usize, usize)>,
}

impl Visit<'_> {
    fn module(&mut self, module: usize) {
        if self.state[module] != State::New {
            return;
        }
        self.state[module] = State::Open;
        for &receiver in &self.receivers[module] {
            if self.state[receiver] != State::Open {
                self.forward.push((module, receiver));
                self.module(receiver);
            }
        }
        self.state[module] = State::Done;
        self.order.push(module);
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use downbeat_executor::{GraphModule, GraphService, GraphTopic};

    /// A robot whose motion moves the servos and hears of them.
    pub(in crate::top) fn graph() -> Graph {
        let module = |name: &str, is_detached| GraphModule { name: name.into(), is_detached };
        let topic = |name: &str| GraphTopic { name: name.into(), message_type: "T".into() };
        Graph {
            modules: vec![module("motion", false), module("servos", true), module("camera", false)],
            topics: vec![topic("joint_states"), topic("joint_goals"), topic("image")],
            services: vec![GraphService {
                name: "stand".into(),
                request_type: "A".into(),
                response_type: "B".into(),
            }],
            outlets: Vec::new(),
            edges: vec![
                GraphEdge::Publishes { module: 1, topic: 0 },
                GraphEdge::Subscribes { module: 0, topic: 0 },
                GraphEdge::Publishes { module: 0, topic: 1 },
                GraphEdge::Subscribes { module: 1, topic: 1 },
                GraphEdge::Publishes { module: 2, topic: 2 },
                GraphEdge::Subscribes { module: 0, topic: 2 },
                GraphEdge::Serves { module: 0, service: 0 },
            ],
        }
    }

    #[test]
    fn modules_stand_below_those_whose_messages_they_receive() {
        let expected = [
            "0  camera",
            "   └ image → motion",
            "1  motion",
            "   ├ joint_goals → servos",
            "   └ service stand ← (no one)",
            "2  servos  detached",
            "   └ joint_states → ↺motion",
        ];
        assert_eq!(lines(&graph()), expected);
    }

    #[test]
    fn a_graph_without_modules_has_no_lines() {
        assert_eq!(lines(&Graph::default()), Vec::<String>::new());
    }
}
