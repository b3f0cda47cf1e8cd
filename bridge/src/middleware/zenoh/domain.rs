//! What the endpoints of a participant share: the session, its numbers and its tokens.

use super::graph::Graph;
use super::outbox::Outbox;
use super::qos;
use super::repair::Repairs;
use crate::middleware::{Endpoint, Gid, MiddlewareError, NodeIdentity, ServiceEndpoint};
use downbeat_zenoh::wire::{Announced, EndpointToken, NodeName, Role, Token, gid};
use downbeat_zenoh::zenoh::liveliness::LivelinessToken;
use downbeat_zenoh::zenoh::{Error, Session, Wait};
use parking_lot::Mutex;
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{SystemTime, UNIX_EPOCH};

/// The node of endpoints that name none, which lists of ROS 2 hide.
const HIDDEN_NODE: &str = "_downbeat";

/// A ROS domain, as one session sees it.
pub(super) struct Domain {
    pub(super) session: Session,
    pub(super) domain_id: u16,
    pub(super) graph: Graph,
    pub(super) outbox: Outbox,
    pub(super) repairs: Repairs,
    /// The identity of the session, in hexadecimal digits.
    id: String,
    /// Numbers nodes and endpoints; none is used again.
    next: AtomicU64,
    nodes: Mutex<HashMap<NodeIdentity, Node>>,
    pub(super) skipped: Skipped,
}

/// Counts what peers sent and is not passed on.
#[derive(Default)]
pub(super) struct Skipped(AtomicU64);

struct Node {
    number: u64,
    /// `None` for a node that only endpoints mention.
    _token: Option<LivelinessToken>,
}

/// An endpoint that is announced, until this is dropped.
pub(super) struct Announcement {
    pub(super) gid: Gid,
    domain: Arc<Domain>,
    _token: LivelinessToken,
}

impl Drop for Announcement {
    fn drop(&mut self) {
        self.domain.graph.remove_local(self.gid);
    }
}

impl Domain {
    pub(super) fn new(session: Session, domain_id: u16) -> Result<Self, MiddlewareError> {
        let id = session.zid().to_string();
        Ok(Self {
            session,
            domain_id,
            graph: Graph::new(id.clone())?,
            outbox: Outbox::start()?,
            repairs: Repairs::default(),
            id,
            next: AtomicU64::new(0),
            nodes: Mutex::default(),
            skipped: Skipped::default(),
        })
    }

    pub(super) fn gid(&self) -> Gid {
        participant(&self.id)
    }

    /// The sessions to which there is a link.
    pub(super) fn linked_sessions(&self) -> BTreeSet<String> {
        let info = self.session.info();
        info.peers_zid().wait().chain(info.routers_zid().wait()).map(|id| id.to_string()).collect()
    }

    pub(super) fn add_node(&self, node: &NodeIdentity) -> Result<(), MiddlewareError> {
        let mut nodes = self.nodes.lock();
        let number = self.next.fetch_add(1, Ordering::Relaxed);
        let token = self.token(node, number, number, Announced::Node).to_string();
        let declared = self.session.liveliness().declare_token(token).wait();
        let token = declared.map_err(|error| self.failed(&error))?;
        nodes.insert(node.clone(), Node { number, _token: Some(token) });
        Ok(())
    }

    pub(super) fn remove_node(&self, node: &NodeIdentity) {
        let removed = self.nodes.lock().remove(node);
        // Withdraws the token.
        drop(removed);
    }

    /// Announces an endpoint, once it can receive.
    pub(super) fn announce(
        self: &Arc<Self>,
        described: Described,
        refused: impl Fn(&Error) -> MiddlewareError,
    ) -> Result<Announcement, MiddlewareError> {
        let Described { text, gid, token } = described;
        self.graph.add_local(gid, token);
        let declared = self.session.liveliness().declare_token(text).wait();
        let withdraw = |error: Error| {
            self.graph.remove_local(gid);
            refused(&error)
        };
        Ok(Announcement { gid, domain: Arc::clone(self), _token: declared.map_err(withdraw)? })
    }

    /// The token and identity of a new endpoint.
    pub(super) fn describe(&self, node: Option<&NodeIdentity>, endpoint: EndpointToken) -> Described {
        let hidden = NodeIdentity { namespace: "/".to_owned(), name: HIDDEN_NODE.to_owned() };
        let node = node.cloned().unwrap_or(hidden);
        let mut nodes = self.nodes.lock();
        let unknown = || Node { number: self.next.fetch_add(1, Ordering::Relaxed), _token: None };
        let number = nodes.entry(node.clone()).or_insert_with(unknown).number;
        drop(nodes);
        let entity = self.next.fetch_add(1, Ordering::Relaxed);
        let token = self.token(&node, number, entity, Announced::Endpoint(endpoint));
        let text = token.to_string();
        Described { gid: Gid(gid(&text)), text, token }
    }

    fn token(&self, node: &NodeIdentity, node_id: u64, entity_id: u64, announced: Announced) -> Token {
        Token {
            domain_id: self.domain_id,
            session: self.id.clone(),
            node_id,
            entity_id,
            enclave: "/".to_owned(),
            node: NodeName { namespace: node.namespace.clone(), name: node.name.clone() },
            announced,
        }
    }

    pub(super) fn failed(&self, error: &Error) -> MiddlewareError {
        MiddlewareError::Zenoh { domain_id: self.domain_id, reason: error.to_string() }
    }
}

impl Skipped {
    /// Counts a message and logs the first.
    pub(super) fn count(&self, name: &str, reason: &str) {
        if self.0.fetch_add(1, Ordering::Relaxed) == 0 {
            tracing::warn!(
                "{name}: a message of a peer on Zenoh is skipped: {reason}; further ones are only counted"
            );
        }
    }

    pub(super) fn total(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A token before it is declared.
pub(super) struct Described {
    text: String,
    pub(super) gid: Gid,
    token: Token,
}

/// An endpoint of a topic as its token describes it; `None` if its name is that of no topic.
pub(super) fn of_topic(endpoint: &Endpoint, role: Role) -> Option<EndpointToken> {
    Some(EndpointToken {
        role,
        name: endpoint.topic_name.strip_prefix("rt").filter(|name| name.starts_with('/'))?.to_owned(),
        type_name: endpoint.type_name.clone(),
        hash: endpoint.type_hash.clone(),
        qos: qos::to_token(&endpoint.qos),
    })
}

/// An endpoint of a service as its token describes it.
pub(super) fn of_service(service: &ServiceEndpoint, role: Role) -> EndpointToken {
    EndpointToken {
        role,
        name: service.name.clone(),
        type_name: service.type_name.clone(),
        hash: service.type_hash.clone(),
        qos: qos::to_token(&service.qos),
    }
}

/// The identity of the participant that is a session.
pub(super) fn participant(session: &str) -> Gid {
    Gid(u128::from_str_radix(session, 16).unwrap_or_default().to_be_bytes())
}

pub(super) fn now_ns() -> i64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    i64::try_from(now.as_nanos()).unwrap_or(i64::MAX)
}
