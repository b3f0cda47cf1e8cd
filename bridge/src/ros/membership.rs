//! What a participant and its nodes share.

use super::graph::Graph;
use super::{NameError, NodeName, RemapRules};
use crate::edge::Interfaces;
use crate::middleware::{Middleware, MiddlewareError};
use crate::worker::Worker;
use parking_lot::Mutex;
use std::any::Any;
use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use thiserror::Error;

/// A node or one of its endpoints could not be created.
#[derive(Debug, Error)]
pub enum NodeError {
    /// A name is not valid.
    #[error(transparent)]
    Name(#[from] NameError),
    /// The participant has a node of that name already.
    #[error("this process has a ROS 2 node {0} already; give one of them another name or namespace")]
    Exists(NodeName),
    /// The engine refused.
    #[error(transparent)]
    Middleware(#[from] MiddlewareError),
}

pub(super) struct Shared {
    // Fields drop in this order: the graph takes leave before the participant goes.
    pub(super) graph: Graph,
    pub(super) worker: Worker,
    pub(super) middleware: Arc<dyn Middleware>,
    pub(super) remaps: RemapRules,
    pub(super) interfaces: Interfaces,
    /// The existing nodes, by the names with which they were requested.
    pub(super) nodes: Mutex<BTreeMap<NodeName, Weak<Membership>>>,
    pub(super) furnishers: Mutex<Vec<Weak<Furnisher>>>,
}

/// Gives a new node the endpoints that all nodes have.
pub(super) type Furnisher = dyn Fn(&Arc<Membership>) -> Result<(), NodeError> + Send + Sync;

/// A node in the graph of its participant.
pub(super) struct Membership {
    pub(super) shared: Arc<Shared>,
    pub(super) name: NodeName,
    /// Dropped with the node.
    pub(super) attached: Mutex<Vec<Box<dyn Any + Send>>>,
}

impl Drop for Membership {
    fn drop(&mut self) {
        self.shared.graph.remove_node(&self.name);
        let attached = std::mem::take(&mut *self.attached.lock());
        // Before the participant, which may go with this node.
        drop(attached);
    }
}
