//! Which node owns which endpoint: told to others, and heard from them, on the topic `ros_discovery_info`.
//!
//! Every participant writes one message with all its nodes and the identities of their endpoints, again whenever
//! something changes; see `rmw_dds_common` (branch jazzy) and
//! <https://design.ros2.org/articles/Node_to_Participant_mapping.html>.

use super::network::Owners;
use super::{MessageType, NodeName, TopicName};
use crate::middleware::rpc::{RpcLink, TimeLimited};
use crate::middleware::{
    Direction, Endpoint, Gid, Middleware, MiddlewareError, Reader, RemoteEndpoint, Sample, WriteError, Writer,
};
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::rmw_dds_common::msg::{Gid as GidMessage, NodeEntitiesInfo, ParticipantEntitiesInfo};
use downbeat_msgs::{cdr, printable};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::time::{Duration, Instant};

/// At exit the last message gets this long to be sent, and as long to be acknowledged; on one machine it takes some
/// milliseconds.
const FAREWELL: Duration = Duration::from_millis(500);

/// A peer acknowledges within some milliseconds: a message that finds no room is written again after this time, then
/// after twice as long, up to [`LONGEST_WAIT`].
const FIRST_WAIT: Duration = Duration::from_millis(2);
const LONGEST_WAIT: Duration = Duration::from_secs(1);

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
    thread: RpcLink,
}

struct OwnState {
    participant: Gid,
    nodes: BTreeMap<NodeName, OwnNode>,
    untold: Option<Untold>,
}

/// The last message found no room in the send window, as when many endpoints come or go at once.
struct Untold {
    again: Instant,
    wait: Duration,
}

#[derive(Default)]
struct OwnNode {
    readers: BTreeSet<Gid>,
    writers: BTreeSet<Gid>,
}

/// The last message of each participant.
type Heard = BTreeMap<[u8; 12], ParticipantEntitiesInfo>;

impl Graph {
    /// What finds no room is told again on the thread.
    pub(super) fn join(middleware: &dyn Middleware, thread: RpcLink) -> Result<Self, MiddlewareError> {
        // As rmw_dds_common does, but for the history of the reader: a message replaces the one before.
        let endpoint = Endpoint::new(
            "ros_discovery_info",
            "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_",
            QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT.keep_last(1) },
        );
        let heard = Arc::<Mutex<Heard>>::default();
        let state = OwnState { participant: middleware.gid(), nodes: BTreeMap::new(), untold: None };
        let writer = middleware.create_writer(&endpoint)?;
        let own = Arc::new(Own { state: Mutex::new(state), writer, thread });
        let retold: Weak<dyn TimeLimited> = Arc::<Own>::downgrade(&own) as _;
        own.thread.watch(retold);
        let hear = {
            // Not by the state, which is locked while its writer waits for this reader too.
            let (heard, own) = (Arc::clone(&heard), middleware.gid().participant());
            move |sample| hear(&heard, own, &sample)
        };
        let reader_endpoint = Endpoint { qos: endpoint.qos.keep_last(100), ..endpoint };
        let reader = middleware.create_reader(&reader_endpoint, Box::new(hear))?;
        Ok(Self { own, heard, _reader: reader })
    }

    /// Adds a node; false when the participant has one of that name already.
    pub(super) fn add_node(&self, node: &NodeName) -> bool {
        let mut state = lock(&self.own.state);
        if state.nodes.contains_key(node) {
            return false;
        }
        state.nodes.insert(node.clone(), OwnNode::default());
        self.own.tell_change(&mut state);
        true
    }

    pub(super) fn remove_node(&self, node: &NodeName) {
        let mut state = lock(&self.own.state);
        state.nodes.remove(node);
        self.own.tell_change(&mut state);
    }

    pub(super) fn add_endpoint(&self, node: &NodeName, direction: Direction, endpoint: Gid) {
        self.change(node, direction, |gids| gids.insert(endpoint));
    }

    pub(super) fn remove_endpoint(&self, node: &NodeName, direction: Direction, endpoint: Gid) {
        self.change(node, direction, |gids| gids.remove(&endpoint));
    }

    fn change(&self, node: &NodeName, direction: Direction, change: impl FnOnce(&mut BTreeSet<Gid>) -> bool) {
        let mut state = lock(&self.own.state);
        let Some(endpoints) = state.nodes.get_mut(node) else { return };
        let gids = match direction {
            Direction::In => &mut endpoints.readers,
            Direction::Out => &mut endpoints.writers,
        };
        if change(gids) {
            self.own.tell_change(&mut state);
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
    /// Tells a change, with those that wait for room, if some do.
    fn tell_change(&self, state: &mut OwnState) {
        if state.untold.is_none() {
            self.tell(state);
        }
    }

    /// Tells all there is, now or as soon as there is room for it.
    fn tell(&self, state: &mut OwnState) {
        match self.write(state) {
            Ok(()) => state.untold = None,
            Err(WriteError::WindowFull) => {
                let waited = state.untold.take().map(|untold| untold.wait);
                let wait = waited.map_or(FIRST_WAIT, |waited| (waited * 2).min(LONGEST_WAIT));
                if wait == LONGEST_WAIT && waited != Some(LONGEST_WAIT) {
                    tracing::warn!(
                        "others do not acknowledge what we tell of our nodes: node lists may be out of date"
                    );
                }
                state.untold = Some(Untold { again: Instant::now() + wait, wait });
                self.thread.look_again();
            }
            Err(error) => {
                state.untold = None;
                tracing::warn!(%error, "telling others about our nodes failed: node lists may be out of date");
            }
        }
    }

    fn write(&self, state: &OwnState) -> Result<(), WriteError> {
        let messages = |gids: &BTreeSet<Gid>| gids.iter().map(|gid| GidMessage { data: gid.0 }).collect();
        let node = |(node, endpoints): (&NodeName, &OwnNode)| NodeEntitiesInfo {
            node_namespace: node.namespace().to_owned(),
            node_name: node.name().to_owned(),
            reader_gid_seq: messages(&endpoints.readers),
            writer_gid_seq: messages(&endpoints.writers),
        };
        let info = ParticipantEntitiesInfo {
            gid: GidMessage { data: state.participant.0 },
            node_entities_info_seq: state.nodes.iter().map(node).collect(),
        };
        self.writer.write(cdr::to_vec(&info).into())
    }

    /// Tells that there are no nodes any more, and waits until the others have heard it.
    fn take_leave(&self, participant: Gid) {
        let nobody = OwnState { participant, nodes: BTreeMap::new(), untold: None };
        let start = Instant::now();
        while matches!(self.write(&nobody), Err(WriteError::WindowFull)) && start.elapsed() < FAREWELL {
            std::thread::sleep(FIRST_WAIT);
        }
        self.writer.flush(FAREWELL);
    }
}

impl TimeLimited for Own {
    fn due(&self) -> Option<Instant> {
        lock(&self.state).untold.as_ref().map(|untold| untold.again)
    }

    fn expire(&self, now: Instant) {
        let mut state = lock(&self.state);
        if state.untold.as_ref().is_some_and(|untold| untold.again <= now) {
            self.tell(&mut state);
        }
    }
}

impl Drop for Graph {
    fn drop(&mut self) {
        let mut state = lock(&self.own.state);
        state.nodes.clear();
        state.untold = None;
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
    // Another participant may send any text, which lists and logs print.
    let name = format!("{}/{}", node.node_namespace.trim_end_matches('/'), node.node_name);
    printable(&name).into_owned()
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
