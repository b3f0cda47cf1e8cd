//! Which node owns which endpoint: announced to others, and received from them, on the topic
//! `ros_discovery_info`.
//!
//! Every participant writes one message with all its nodes and the identities of their endpoints, again
//! whenever something changes; see `rmw_dds_common` (branch jazzy) and
//! <https://design.ros2.org/articles/Node_to_Participant_mapping.html>.

use super::NodeName;
use super::graph_types::{Owners, RemoteNode, remote_topic};
use crate::middleware::{
    Direction, Endpoint, EndpointEvent, EventHandler, Gid, Middleware, MiddlewareError, Reader,
    RemoteEndpoint, Sample, WriteError, Writer,
};
use crate::worker::{TimeLimited, WorkerLink};
use downbeat_msgs::qos::{Durability, QosProfile};
use downbeat_msgs::rmw_dds_common::msg::{Gid as GidMessage, NodeEntitiesInfo, ParticipantEntitiesInfo};
use downbeat_msgs::{Message, cdr, printable};
use parking_lot::Mutex;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

/// At exit the last message gets this long to be sent, and as long to be acknowledged; on one machine it
/// takes some milliseconds.
const FAREWELL: Duration = Duration::from_millis(500);

/// A peer acknowledges within some milliseconds: a message that finds no room is written again after this
/// time, then after twice as long, up to [`LONGEST_WAIT`].
const FIRST_WAIT: Duration = Duration::from_millis(2);
const LONGEST_WAIT: Duration = Duration::from_secs(1);

/// The graph of one participant: its announcements and those of others. Dropping it announces that it has no
/// nodes.
pub(super) struct DiscoveryInfo {
    own: Arc<Own>,
    heard: Arc<Mutex<Heard>>,
    participant: Gid,
    _reader: Box<dyn Reader>,
}

/// What is announced to others.
struct Own {
    state: Mutex<OwnState>,
    writer: Box<dyn Writer>,
    worker: WorkerLink,
    /// Set when a participant has found this one again.
    is_found_again: AtomicBool,
}

struct OwnState {
    participant: Gid,
    nodes: BTreeMap<NodeName, OwnNode>,
    unannounced: Option<Unannounced>,
}

/// The last message found no room in the send window, as when many endpoints come or go at once.
struct Unannounced {
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

impl DiscoveryInfo {
    /// The worker writes messages again that found no room.
    pub(super) fn join(middleware: &dyn Middleware, worker: WorkerLink) -> Result<Self, MiddlewareError> {
        // As rmw_dds_common does, but for the history of the reader: a message replaces the one before.
        let endpoint = Endpoint {
            type_hash: Some(ParticipantEntitiesInfo::TYPE_HASH.to_owned()),
            ..Endpoint::new(
                "ros_discovery_info",
                "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_",
                QosProfile { durability: Durability::TransientLocal, ..QosProfile::DEFAULT.keep_last(1) },
            )
        };
        let heard = Arc::<Mutex<Heard>>::default();
        let state = OwnState { participant: middleware.gid(), nodes: BTreeMap::new(), unannounced: None };
        let writer = middleware.create_writer(&endpoint)?;
        let own = Arc::new(Own {
            state: Mutex::new(state),
            writer,
            worker,
            is_found_again: AtomicBool::new(false),
        });
        own.writer.on_event(found_again(&own));
        let again: Weak<dyn TimeLimited> = Arc::<Own>::downgrade(&own) as _;
        own.worker.watch(again);
        let hear = {
            // Not by the state, which is locked while its writer waits for this reader too.
            let (heard, own) = (Arc::clone(&heard), middleware.gid().participant());
            move |sample| hear(&heard, own, &sample)
        };
        let reader_endpoint = Endpoint { qos: endpoint.qos.keep_last(100), ..endpoint };
        let reader = middleware.create_reader(&reader_endpoint, Box::new(hear))?;
        Ok(Self { own, heard, participant: middleware.gid(), _reader: reader })
    }

    /// Adds a node; false when the participant has one of that name already.
    pub(super) fn add_node(&self, node: &NodeName) -> bool {
        let mut state = self.own.state.lock();
        if state.nodes.contains_key(node) {
            return false;
        }
        state.nodes.insert(node.clone(), OwnNode::default());
        self.own.announce_change(&mut state);
        true
    }

    /// Announces that there are no nodes, without waiting.
    pub(super) fn leave(&self) {
        let nobody = OwnState { participant: self.participant, nodes: BTreeMap::new(), unannounced: None };
        // If there is no room for it, the end of the participant says the same.
        let _ = self.own.write(&nobody);
    }

    pub(super) fn remove_node(&self, node: &NodeName) {
        let mut state = self.own.state.lock();
        state.nodes.remove(node);
        self.own.announce_change(&mut state);
    }

    pub(super) fn add_endpoint(&self, node: &NodeName, direction: Direction, endpoint: Gid) {
        self.change(node, direction, |gids| gids.insert(endpoint));
    }

    pub(super) fn remove_endpoint(&self, node: &NodeName, direction: Direction, endpoint: Gid) {
        self.change(node, direction, |gids| gids.remove(&endpoint));
    }

    fn change(&self, node: &NodeName, direction: Direction, change: impl FnOnce(&mut BTreeSet<Gid>) -> bool) {
        let mut state = self.own.state.lock();
        let Some(endpoints) = state.nodes.get_mut(node) else { return };
        let gids = match direction {
            Direction::In => &mut endpoints.readers,
            Direction::Out => &mut endpoints.writers,
        };
        if change(gids) {
            self.own.announce_change(&mut state);
        }
    }

    /// The nodes of others and the owners of endpoints, as others announce them.
    pub(super) fn remote_owners(&self, endpoints: &[RemoteEndpoint]) -> Owners {
        let alive: BTreeSet<_> = endpoints.iter().map(|endpoint| endpoint.gid.participant()).collect();
        let mut owners = Owners::default();
        for (_, info) in self.heard.lock().iter().filter(|(participant, _)| alive.contains(*participant)) {
            for node in &info.node_entities_info_seq {
                let name = full_name(node);
                let gids = node.reader_gid_seq.iter().chain(&node.writer_gid_seq);
                owners.owners.extend(gids.map(|gid| (Gid(gid.data), name.clone())));
                owners.nodes.push((Gid(info.gid.data), name));
            }
        }
        owners
    }

    /// Whether all of these participants have announced their nodes, and all endpoints of these are known.
    pub(super) fn has_heard_all(&self, participants: &[[u8; 12]], endpoints: &[RemoteEndpoint]) -> bool {
        let known: BTreeSet<_> = endpoints.iter().map(|endpoint| endpoint.gid).collect();
        let heard = self.heard.lock();
        participants.iter().all(|participant| {
            let nodes = heard.get(participant).map(|info| &info.node_entities_info_seq);
            nodes.is_some_and(|nodes| {
                let gids =
                    nodes.iter().flat_map(|node| node.reader_gid_seq.iter().chain(&node.writer_gid_seq));
                gids.into_iter().all(|gid| known.contains(&Gid(gid.data)))
            })
        })
    }

    /// The nodes of others, as they announce them, with the endpoints that discovery found.
    pub(super) fn remote_nodes(&self, endpoints: &[RemoteEndpoint]) -> Vec<RemoteNode> {
        // A participant that vanished without a last word is known by having no endpoints any more.
        let alive: BTreeSet<_> = endpoints.iter().map(|endpoint| endpoint.gid.participant()).collect();
        let by_gid: BTreeMap<_, _> = endpoints.iter().map(|endpoint| (endpoint.gid, endpoint)).collect();
        let heard = self.heard.lock();
        let announced = heard.iter().filter(|(participant, _)| alive.contains(*participant));
        announced
            .flat_map(|(_, info)| &info.node_entities_info_seq)
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
    /// Announces a change, together with changes that wait for room.
    fn announce_change(&self, state: &mut OwnState) {
        if state.unannounced.is_none() {
            self.announce(state);
        }
    }

    /// Announces all nodes, now or as soon as there is room for it.
    fn announce(&self, state: &mut OwnState) {
        match self.write(state) {
            Ok(()) => state.unannounced = None,
            Err(WriteError::WindowFull) => {
                let waited = state.unannounced.take().map(|unannounced| unannounced.wait);
                let wait = waited.map_or(FIRST_WAIT, |waited| (waited * 2).min(LONGEST_WAIT));
                if wait == LONGEST_WAIT && waited != Some(LONGEST_WAIT) {
                    tracing::warn!(
                        "others do not acknowledge the announcements of our nodes: their node lists may be out of date"
                    );
                }
                state.unannounced = Some(Unannounced { again: Instant::now() + wait, wait });
                self.worker.look_again();
            }
            Err(error) => {
                state.unannounced = None;
                tracing::warn!(%error, "announcing our nodes failed: node lists of others may be out of date");
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

    /// Announces that there are no nodes, and waits until others have acknowledged it.
    fn take_leave(&self, participant: Gid) {
        let nobody = OwnState { participant, nodes: BTreeMap::new(), unannounced: None };
        let start = Instant::now();
        while matches!(self.write(&nobody), Err(WriteError::WindowFull)) && start.elapsed() < FAREWELL {
            std::thread::sleep(FIRST_WAIT);
        }
        self.writer.flush(FAREWELL);
    }
}

impl TimeLimited for Own {
    fn due(&self) -> Option<Instant> {
        if self.is_found_again.load(Ordering::Relaxed) {
            return Some(Instant::now());
        }
        self.state.lock().unannounced.as_ref().map(|unannounced| unannounced.again)
    }

    fn expire(&self, now: Instant) {
        let is_found_again = self.is_found_again.swap(false, Ordering::Relaxed);
        let mut state = self.state.lock();
        if is_found_again || state.unannounced.as_ref().is_some_and(|unannounced| unannounced.again <= now) {
            self.announce(&mut state);
        }
    }
}

impl Drop for DiscoveryInfo {
    fn drop(&mut self) {
        let mut state = self.own.state.lock();
        state.nodes.clear();
        state.unannounced = None;
        self.own.take_leave(state.participant);
    }
}

/// The most readers that are remembered.
const MOST_REMEMBERED: usize = 4096;

/// Announces the nodes again when a reader is matched that was matched before, or has begun anew. A
/// participant that lost this one has forgotten its nodes, and Fast DDS does not pass a message on again
/// whose number it has seen.
fn found_again(own: &Arc<Own>) -> EventHandler {
    let (own, known) = (Arc::downgrade(own), Mutex::new(BTreeSet::new()));
    Box::new(move |event| {
        let is_found_again = match event {
            EndpointEvent::BegunAnew { .. } => true,
            EndpointEvent::Matched { peer } => {
                let mut known = known.lock();
                if known.len() >= MOST_REMEMBERED {
                    known.clear();
                }
                !known.insert(*peer)
            }
            _ => false,
        };
        if is_found_again && let Some(own) = own.upgrade() {
            own.is_found_again.store(true, Ordering::Relaxed);
            own.worker.look_again();
        }
    })
}

fn hear(heard: &Mutex<Heard>, own: [u8; 12], sample: &Sample) {
    match cdr::from_slice::<ParticipantEntitiesInfo>(&sample.cdr) {
        Ok(info) => {
            let participant = Gid(info.gid.data).participant();
            if participant == own {
                return;
            }
            if info.node_entities_info_seq.is_empty() {
                heard.lock().remove(&participant);
            } else {
                heard.lock().insert(participant, info);
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
