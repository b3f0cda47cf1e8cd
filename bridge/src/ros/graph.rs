//! Which node owns which endpoint: told to others, and heard from them, on the topic `ros_discovery_info`.
//!
//! Every participant writes one message with all its nodes and the identities of their endpoints, again whenever
//! something changes; see `rmw_dds_common` (branch jazzy) and
//! <https://design.ros2.org/articles/Node_to_Participant_mapping.html>.

use super::network::Owners;
use super::{MessageType, NodeName, TopicName};
use crate::middleware::{
    Direction, Endpoint, Gid, Middleware, MiddlewareError, Reader, RejoinStep, RemoteEndpoint, Sample,
    WriteError, Writer,
};
use downbeat_msgs::cdr;
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::rmw_dds_common::msg::{Gid as GidMessage, NodeEntitiesInfo, ParticipantEntitiesInfo};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// At exit the last message gets this long to be acknowledged; on one machine it takes a millisecond.
const FAREWELL: Duration = Duration::from_millis(500);

/// A node of another participant, and its topics.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RemoteNode {
    /// Its namespace and name, `/robot/talker`.
    pub name: String,
    /// Its endpoints whose topic is known already.
    pub endpoints: Vec<RemoteTopic>,
}

/// What a node of another participant does on a topic.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RemoteTopic {
    /// The absolute name of the topic.
    pub topic: TopicName,
    /// Its type.
    pub message_type: MessageType,
    /// Whether the node publishes it.
    pub is_published: bool,
}

/// The graph as one participant tells and hears it. Dropping it tells the others that its nodes are gone.
pub(super) struct Graph {
    own: Arc<Own>,
    heard: Arc<Mutex<Heard>>,
    _reader: Box<dyn Reader>,
}

/// What is told to others.
struct Own {
    state: Mutex<OwnState>,
    writer: Box<dyn Writer>,
}

struct OwnState {
    participant: Gid,
    nodes: BTreeMap<NodeName, OwnNode>,
}

#[derive(Default)]
struct OwnNode {
    readers: Endpoints,
    writers: Endpoints,
}

/// The identities of endpoints: when they were created, and now.
type Endpoints = BTreeMap<Gid, Gid>;

/// The last message of each participant.
type Heard = BTreeMap<[u8; 12], ParticipantEntitiesInfo>;

impl Graph {
    pub(super) fn join(middleware: &dyn Middleware) -> Result<Self, MiddlewareError> {
        // As rmw_dds_common does, but for the history of the reader: a message replaces the one before.
        let endpoint = Endpoint::new(
            "ros_discovery_info",
            "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_",
            QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT.keep_last(1) },
        );
        let heard = Arc::<Mutex<Heard>>::default();
        let state = OwnState { participant: middleware.gid(), nodes: BTreeMap::new() };
        let own = Arc::new(Own { state: Mutex::new(state), writer: middleware.create_writer(&endpoint)? });
        let hear = {
            let (heard, own) = (Arc::clone(&heard), Arc::clone(&own));
            move |sample| hear(&heard, lock(&own.state).participant.participant(), &sample)
        };
        let reader_endpoint = Endpoint { qos: endpoint.qos.keep_last(100), ..endpoint };
        let reader = middleware.create_reader(&reader_endpoint, Box::new(hear))?;
        let rejoining = Arc::downgrade(&own);
        middleware.on_rejoin(Box::new(move |step| {
            if let Some(own) = rejoining.upgrade() {
                own.rejoin(step);
            }
        }));
        Ok(Self { own, heard, _reader: reader })
    }

    /// Adds a node; false when the participant has one of that name already.
    pub(super) fn add_node(&self, node: &NodeName) -> bool {
        let mut state = lock(&self.own.state);
        if state.nodes.contains_key(node) {
            return false;
        }
        state.nodes.insert(node.clone(), OwnNode::default());
        self.own.tell(&state);
        true
    }

    pub(super) fn remove_node(&self, node: &NodeName) {
        let mut state = lock(&self.own.state);
        state.nodes.remove(node);
        self.own.tell(&state);
    }

    pub(super) fn add_endpoint(&self, node: &NodeName, direction: Direction, endpoint: Gid) {
        self.change(node, direction, |gids| gids.insert(endpoint, endpoint).is_none());
    }

    /// Takes away an endpoint, by the identity it was added with.
    pub(super) fn remove_endpoint(&self, node: &NodeName, direction: Direction, endpoint: Gid) {
        self.change(node, direction, |gids| gids.remove(&endpoint).is_some());
    }

    fn change(&self, node: &NodeName, direction: Direction, change: impl FnOnce(&mut Endpoints) -> bool) {
        let mut state = lock(&self.own.state);
        let Some(endpoints) = state.nodes.get_mut(node) else { return };
        let gids = match direction {
            Direction::In => &mut endpoints.readers,
            Direction::Out => &mut endpoints.writers,
        };
        if change(gids) {
            self.own.tell(&state);
        }
    }

    /// The nodes of others, and whose endpoints are whose, by what they told.
    pub(super) fn remote_owners(&self, endpoints: &[RemoteEndpoint]) -> Owners {
        let alive: BTreeSet<_> = endpoints.iter().map(|endpoint| endpoint.gid.participant()).collect();
        let mut owners = Owners::default();
        for (_, info) in lock(&self.heard).iter().filter(|(participant, _)| alive.contains(*participant)) {
            for node in &info.node_entities_info_seq {
                let name = full_name(node);
                let gids = node.reader_gid_seq.iter().chain(&node.writer_gid_seq);
                owners.owners.extend(gids.map(|gid| (Gid(gid.data), name.clone())));
                owners.nodes.push((Gid(info.gid.data), name));
            }
        }
        owners
    }

    /// The nodes of others, by what they told and the endpoints that discovery found.
    pub(super) fn remote_nodes(&self, endpoints: &[RemoteEndpoint]) -> Vec<RemoteNode> {
        // A participant that vanished without a last word is known by having no endpoints any more.
        let alive: BTreeSet<_> = endpoints.iter().map(|endpoint| endpoint.gid.participant()).collect();
        let by_gid: BTreeMap<_, _> = endpoints.iter().map(|endpoint| (endpoint.gid, endpoint)).collect();
        let heard = lock(&self.heard);
        let told = heard.iter().filter(|(participant, _)| alive.contains(*participant));
        told.flat_map(|(_, info)| &info.node_entities_info_seq)
            .map(|node| {
                let gids = node.reader_gid_seq.iter().chain(&node.writer_gid_seq);
                let mut endpoints: Vec<_> =
                    gids.filter_map(|gid| remote_topic(by_gid.get(&Gid(gid.data))?)).collect();
                endpoints.sort();
                RemoteNode { name: full_name(node), endpoints }
            })
            .collect()
    }
}

impl Own {
    fn tell(&self, state: &OwnState) {
        self.write(state.participant, &state.nodes);
    }

    fn write(&self, participant: Gid, nodes: &BTreeMap<NodeName, OwnNode>) {
        let messages = |gids: &Endpoints| gids.values().map(|gid| GidMessage { data: gid.0 }).collect();
        let info = ParticipantEntitiesInfo {
            gid: GidMessage { data: participant.0 },
            node_entities_info_seq: nodes
                .iter()
                .map(|(node, endpoints)| NodeEntitiesInfo {
                    node_namespace: node.namespace().to_owned(),
                    node_name: node.name().to_owned(),
                    reader_gid_seq: messages(&endpoints.readers),
                    writer_gid_seq: messages(&endpoints.writers),
                })
                .collect(),
        };
        match self.writer.write(cdr::to_vec(&info).into()) {
            // It is told when the participant is there again.
            Ok(()) | Err(WriteError::Away) => {}
            Err(error) => {
                tracing::warn!(%error, "telling others about our nodes failed: node lists may be out of date");
            }
        }
    }

    fn rejoin(&self, step: &RejoinStep) {
        let mut state = lock(&self.state);
        match step {
            RejoinStep::Leaving => self.take_leave(state.participant),
            RejoinStep::Joined { participant, endpoints } => {
                state.participant = *participant;
                let own = state.nodes.values_mut();
                let gids = own.flat_map(|node| node.readers.values_mut().chain(node.writers.values_mut()));
                for gid in gids {
                    *gid = endpoints.get(gid).copied().unwrap_or(*gid);
                }
                self.tell(&state);
            }
        }
    }

    fn take_leave(&self, participant: Gid) {
        self.write(participant, &BTreeMap::new());
        self.writer.flush(FAREWELL);
    }
}

impl Drop for Graph {
    fn drop(&mut self) {
        let mut state = lock(&self.own.state);
        state.nodes.clear();
        self.own.take_leave(state.participant);
    }
}

fn hear(heard: &Mutex<Heard>, own: [u8; 12], sample: &Sample) {
    match cdr::from_slice::<ParticipantEntitiesInfo>(&sample.cdr) {
        Ok(info) => {
            let participant = Gid(info.gid.data).participant();
            if participant == own {
                return;
            }
            if info.node_entities_info_seq.is_empty() {
                lock(heard).remove(&participant);
            } else {
                lock(heard).insert(participant, info);
            }
        }
        Err(error) => {
            tracing::debug!(writer = %sample.writer, %error, "a message on ros_discovery_info is not valid")
        }
    }
}

fn full_name(node: &NodeEntitiesInfo) -> String {
    format!("{}/{}", node.node_namespace.trim_end_matches('/'), node.node_name)
}

fn remote_topic(endpoint: &RemoteEndpoint) -> Option<RemoteTopic> {
    Some(RemoteTopic {
        topic: TopicName::from_wire(&endpoint.topic_name)?,
        message_type: MessageType::from_wire(&endpoint.type_name)?,
        is_published: endpoint.direction == Direction::Out,
    })
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
