//! The nodes of a participant in the graph that tools show.

use super::NodeName;
use super::discovery_info::DiscoveryInfo;
use super::graph_types::{Owners, remote_topic};
pub use super::graph_types::{RemoteNode, RemoteTopic};
use crate::middleware::{Direction, Gid, Middleware, MiddlewareError, Nodes, RemoteEndpoint};
use crate::worker::WorkerLink;
use parking_lot::Mutex;
use std::collections::BTreeSet;
use std::sync::Arc;

/// How nodes are announced and heard of.
pub(super) enum Graph {
    /// By samples, as on DDS.
    Samples(DiscoveryInfo),
    /// By the engine.
    Engine(EngineGraph),
}

/// The nodes of an engine that announces them itself.
pub(super) struct EngineGraph {
    middleware: Arc<dyn Middleware>,
    names: Mutex<BTreeSet<NodeName>>,
}

impl Graph {
    pub(super) fn join(
        middleware: &Arc<dyn Middleware>,
        worker: WorkerLink,
    ) -> Result<Self, MiddlewareError> {
        if middleware.nodes().is_some() {
            let middleware = Arc::clone(middleware);
            return Ok(Self::Engine(EngineGraph { middleware, names: Mutex::default() }));
        }
        Ok(Self::Samples(DiscoveryInfo::join(&**middleware, worker)?))
    }

    /// Adds a node; false when the participant has one of that name already.
    pub(super) fn add_node(&self, node: &NodeName) -> Result<bool, MiddlewareError> {
        match self {
            Self::Samples(info) => Ok(info.add_node(node)),
            Self::Engine(graph) => {
                let mut names = graph.names.lock();
                if names.contains(node) {
                    return Ok(false);
                }
                if let Some(nodes) = graph.middleware.nodes() {
                    nodes.add(&node.identity())?;
                }
                Ok(names.insert(node.clone()))
            }
        }
    }

    pub(super) fn remove_node(&self, node: &NodeName) {
        match self {
            Self::Samples(info) => info.remove_node(node),
            Self::Engine(graph) => {
                graph.names.lock().remove(node);
                if let Some(nodes) = graph.middleware.nodes() {
                    nodes.remove(&node.identity());
                }
            }
        }
    }

    /// Announces that there are no nodes, without waiting. The end of the participant says the same where the
    /// engine announces them.
    pub(super) fn leave(&self) {
        if let Self::Samples(info) = self {
            info.leave();
        }
    }

    pub(super) fn add_endpoint(&self, node: &NodeName, direction: Direction, endpoint: Gid) {
        if let Self::Samples(info) = self {
            info.add_endpoint(node, direction, endpoint);
        }
    }

    pub(super) fn remove_endpoint(&self, node: &NodeName, direction: Direction, endpoint: Gid) {
        if let Self::Samples(info) = self {
            info.remove_endpoint(node, direction, endpoint);
        }
    }

    /// The nodes of others and the owners of endpoints, as others announce them.
    pub(super) fn remote_owners(&self, endpoints: &[RemoteEndpoint]) -> Owners {
        let Some(nodes) = self.of_engine() else {
            return self.info().map(|info| info.remote_owners(endpoints)).unwrap_or_default();
        };
        let owner = |endpoint: &RemoteEndpoint| Some((endpoint.gid, endpoint.node.clone()?.name));
        Owners {
            nodes: nodes.remote().into_iter().map(|node| (node.participant, node.name)).collect(),
            owners: endpoints.iter().filter_map(owner).collect(),
        }
    }

    /// The nodes of others, with the endpoints that discovery found.
    pub(super) fn remote_nodes(&self, endpoints: &[RemoteEndpoint]) -> Vec<RemoteNode> {
        let Some(nodes) = self.of_engine() else {
            return self.info().map(|info| info.remote_nodes(endpoints)).unwrap_or_default();
        };
        let with_topics = |node| {
            let of_node = endpoints.iter().filter(|endpoint| endpoint.node.as_ref() == Some(&node));
            let mut endpoints: Vec<_> = of_node.filter_map(remote_topic).collect();
            endpoints.sort();
            RemoteNode { name: node.name, endpoints }
        };
        nodes.remote().into_iter().map(with_topics).collect()
    }

    /// Whether everything that others have announced so far is known.
    pub(super) fn has_heard_all(&self, middleware: &dyn Middleware) -> bool {
        if let Some(nodes) = self.of_engine() {
            return nodes.has_heard_all();
        }
        let Some(participants) = middleware.remote_participants() else { return false };
        let endpoints = middleware.remote_endpoints();
        let has_heard = |info: &DiscoveryInfo| info.has_heard_all(&participants, &endpoints);
        !participants.is_empty() && self.info().is_some_and(has_heard)
    }

    fn of_engine(&self) -> Option<&dyn Nodes> {
        match self {
            Self::Samples(_) => None,
            Self::Engine(graph) => graph.middleware.nodes(),
        }
    }

    fn info(&self) -> Option<&DiscoveryInfo> {
        match self {
            Self::Samples(info) => Some(info),
            Self::Engine(_) => None,
        }
    }
}
