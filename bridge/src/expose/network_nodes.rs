//! The nodes of a core in its networks.

use super::exposure::ExposeError;
use crate::ros::Node;
use std::collections::BTreeMap;
use std::sync::Arc;

/// The node of a robot in each of its networks. Clones share them.
#[derive(Clone)]
pub struct NetworkNodes {
    own: Node,
    further: Arc<BTreeMap<String, Node>>,
}

impl NetworkNodes {
    /// A node for what names no network, and those in further networks by the names of these.
    #[must_use]
    pub fn new(own: Node, further: BTreeMap<String, Node>) -> Self {
        Self { own, further: Arc::new(further) }
    }

    /// The node for what names no network.
    #[must_use]
    pub fn own(&self) -> &Node {
        &self.own
    }

    /// The node that exposes `name` in a network.
    pub(super) fn find(&self, name: &str, network: Option<&str>) -> Result<&Node, ExposeError> {
        let Some(network) = network else { return Ok(&self.own) };
        let missing = || ExposeError::NoNetwork { name: name.to_owned(), network: network.to_owned() };
        self.further.get(network).ok_or_else(missing)
    }
}

impl From<&Node> for NetworkNodes {
    fn from(own: &Node) -> Self {
        Self::new(own.clone(), BTreeMap::new())
    }
}
