//! Who is matched with whom, and which endpoints others have: kept up to date from the events of discovery.
//!
//! The status channel of each rustdds endpoint holds four events and drops the rest, so counts come from the
//! participant's, which holds 2048.

use super::qos;
use crate::middleware::{
    Direction, EndpointEvent, EventHandler, Gid, MatchHandler, QosPolicyKind, RemoteEndpoint,
};
use downbeat_msgs::qos::Liveliness;
use rustdds::{DomainParticipantStatusEvent as Event, EndpointDescription, GUID};
use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The number of endpoints that one of ours is matched with, shared with its handle.
pub(super) type MatchedCount = Arc<AtomicUsize>;

/// Events for the handlers of endpoints, which are delivered without the lock.
#[derive(Default)]
pub(super) struct News {
    on_change: Vec<Arc<MatchHandler>>,
    events: Vec<(Arc<EventHandler>, EndpointEvent)>,
}

impl News {
    pub(super) fn deliver(&self) {
        self.on_change.iter().for_each(|on_change| on_change());
        self.events.iter().for_each(|(handler, event)| handler(event));
    }
}

/// How one of our endpoints stands to those of others.
#[derive(Default)]
struct Matched {
    /// What it offers or requests; not known yet where an event comes before its creation has returned.
    liveliness: Option<(Direction, Liveliness)>,
    count: MatchedCount,
    peers: HashSet<Gid>,
    /// Endpoints on the topic that do not match. Announcements are repeated; each is reported once.
    unsuited: HashMap<Gid, QosPolicyKind>,
    on_change: Option<Arc<MatchHandler>>,
    on_event: Option<Arc<EventHandler>>,
}

impl Matched {
    /// rustdds 0.15.1 does not compare the kinds of liveliness (`Ord for Liveliness` in `dds/qos.rs` compares
    /// one with itself), so it takes a match for granted that the other side does not.
    fn suits(&self, theirs: Liveliness) -> bool {
        let (automatic, manual) = (Liveliness::Automatic, Liveliness::ManualByTopic);
        match self.liveliness {
            Some((Direction::Out, ours)) => (ours, theirs) != (automatic, manual),
            Some((Direction::In, ours)) => (ours, theirs) != (manual, automatic),
            None => true,
        }
    }

    fn matched(&mut self, peer: Gid, news: &mut News) {
        self.unsuited.remove(&peer);
        let is_new = self.peers.insert(peer);
        self.count.store(self.peers.len(), Ordering::Release);
        news.on_change.extend(self.on_change.clone());
        if is_new {
            self.event(EndpointEvent::Matched { peer }, news);
        }
    }

    fn incompatible(&mut self, peer: Gid, policy: QosPolicyKind, news: &mut News) {
        if self.unsuited.insert(peer, policy) != Some(policy) {
            self.event(EndpointEvent::IncompatibleQos { peer, policy }, news);
        }
    }

    fn remove(&mut self, is_lost: impl Fn(Gid) -> bool, news: &mut News) {
        self.unsuited.retain(|peer, _| !is_lost(*peer));
        let lost: Vec<Gid> = self.peers.extract_if(|peer| is_lost(*peer)).collect();
        if lost.is_empty() {
            return;
        }
        self.count.store(self.peers.len(), Ordering::Release);
        news.on_change.extend(self.on_change.clone());
        for peer in lost {
            self.event(EndpointEvent::Unmatched { peer }, news);
        }
    }

    fn event(&self, event: EndpointEvent, news: &mut News) {
        news.events.extend(self.on_event.clone().map(|handler| (handler, event)));
    }
}

/// See the module.
pub(super) struct Matches {
    own: [u8; 12],
    local: HashMap<Gid, Matched>,
    remote: HashMap<Gid, RemoteEndpoint>,
}

impl Matches {
    pub(super) fn new(own: Gid) -> Self {
        Self { own: own.participant(), local: HashMap::new(), remote: HashMap::new() }
    }

    /// The count of a local endpoint; events may have come before this call.
    pub(super) fn watch(&mut self, local: Gid, direction: Direction, liveliness: Liveliness) -> MatchedCount {
        let matched = self.local.entry(local).or_default();
        matched.liveliness = Some((direction, liveliness));
        let known = |peer: &Gid| self.remote.get(peer).map(|remote| remote.liveliness);
        let unsuited =
            matched.peers.iter().filter(|peer| known(peer).is_some_and(|kind| !matched.suits(kind)));
        let unsuited: Vec<Gid> = unsuited.copied().collect();
        for peer in unsuited {
            matched.peers.remove(&peer);
            matched.unsuited.insert(peer, QosPolicyKind::Liveliness);
        }
        matched.count.store(matched.peers.len(), Ordering::Release);
        Arc::clone(&matched.count)
    }

    /// Whom a local endpoint is matched with.
    pub(super) fn peers(&self, local: Gid) -> Vec<Gid> {
        self.local.get(&local).map(|matched| matched.peers.iter().copied().collect()).unwrap_or_default()
    }

    pub(super) fn on_change(&mut self, local: Gid, handler: MatchHandler) {
        self.local.entry(local).or_default().on_change = Some(Arc::new(handler));
    }

    /// Registers a handler for events of a local endpoint and returns the present state. Called on the thread
    /// that applies events, so that nothing comes in between.
    #[must_use]
    pub(super) fn listen(&mut self, local: Gid, handler: EventHandler) -> News {
        let mut news = News::default();
        // It may have been removed before its turn came.
        if let Some(matched) = self.local.get_mut(&local) {
            matched.on_event = Some(Arc::new(handler));
            for &peer in &matched.peers {
                matched.event(EndpointEvent::Matched { peer }, &mut news);
            }
            for (&peer, &policy) in &matched.unsuited {
                matched.event(EndpointEvent::IncompatibleQos { peer, policy }, &mut news);
            }
        }
        news
    }

    /// A local endpoint was removed.
    pub(super) fn forget(&mut self, local: Gid) {
        self.local.remove(&local);
    }

    pub(super) fn remote_endpoints(&self) -> Vec<RemoteEndpoint> {
        let mut endpoints: Vec<_> = self.remote.values().cloned().collect();
        endpoints.sort_by(|a, b| (&a.topic_name, a.gid).cmp(&(&b.topic_name, b.gid)));
        endpoints
    }

    /// Applies one event of discovery.
    #[must_use]
    pub(super) fn apply(&mut self, event: Event) -> News {
        let mut news = News::default();
        match event {
            Event::ReaderDetected { reader } => self.detected(reader, Direction::In),
            Event::WriterDetected { writer } => self.detected(writer, Direction::Out),
            Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
                let lost = gid(guid);
                self.remote.remove(&lost);
                self.remove_peers(|peer| peer == lost, &mut news);
            }
            Event::ParticipantLost { id, .. } => {
                let mut anyone = GUID::GUID_UNKNOWN;
                anyone.prefix = id;
                let lost = gid(anyone).participant();
                self.remote.retain(|gid, _| gid.participant() != lost);
                self.remove_peers(|peer| peer.participant() == lost, &mut news);
            }
            Event::RemoteReaderMatched { local_writer: local, remote_reader: peer }
            | Event::RemoteWriterMatched { local_reader: local, remote_writer: peer } => {
                let peer = gid(peer);
                let matched = self.local.entry(gid(local)).or_default();
                if self.remote.get(&peer).is_none_or(|remote| matched.suits(remote.liveliness)) {
                    matched.matched(peer, &mut news);
                } else {
                    matched.incompatible(peer, QosPolicyKind::Liveliness, &mut news);
                }
            }
            Event::RemoteReaderQosIncompatible {
                local_writer: local,
                remote_reader: peer,
                requested_qos,
                offered_qos,
            }
            | Event::RemoteWriterQosIncompatible {
                local_reader: local,
                remote_writer: peer,
                requested_qos,
                offered_qos,
            } => {
                let policy = qos::incompatibility(&offered_qos, &requested_qos);
                self.local.entry(gid(local)).or_default().incompatible(gid(peer), policy, &mut news);
            }
            _ => {}
        }
        news
    }

    fn detected(&mut self, endpoint: EndpointDescription, direction: Direction) {
        let gid = gid(endpoint.guid);
        if gid.participant() == self.own {
            return;
        }
        let (reliability, durability) = qos::reliability_and_durability(&endpoint.qos, direction);
        let (liveliness, liveliness_lease_duration) = qos::liveliness_and_lease(&endpoint.qos);
        self.remote.insert(
            gid,
            RemoteEndpoint {
                gid,
                direction,
                topic_name: endpoint.topic_name,
                type_name: endpoint.type_name,
                reliability,
                durability,
                deadline: qos::deadline(&endpoint.qos),
                lifespan: qos::lifespan(&endpoint.qos),
                liveliness,
                liveliness_lease_duration,
                type_hash: type_hash(&endpoint.user_data),
                node: None,
            },
        );
    }

    fn remove_peers(&mut self, is_lost: impl Fn(Gid) -> bool, news: &mut News) {
        self.local.values_mut().for_each(|matched| matched.remove(&is_lost, news));
    }
}

/// The identity that rustdds calls GUID.
pub(super) fn gid(guid: GUID) -> Gid {
    Gid(guid.to_bytes())
}

/// The hash in the user data of an endpoint: `typehash=RIHS01_…;` among other `key=value;` pairs. The engine
/// gives the value of the parameter as it stands on the wire: a sequence of bytes, which begins with its
/// length.
fn type_hash(user_data: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(user_data.get(4..)?).ok()?;
    text.split(';')
        .find_map(|pair| pair.strip_prefix("typehash="))
        .filter(|hash| is_word(hash))
        .map(str::to_owned)
}

/// Whether a text from the network has letters, digits and underscores only: it is printed as it is.
fn is_word(text: &str) -> bool {
    text.bytes().all(|byte| byte.is_ascii_alphanumeric() || byte == b'_')
}

#[cfg(test)]
mod tests {
    use super::type_hash;

    #[test]
    fn a_type_hash_is_found_among_other_user_data() {
        assert_eq!(type_hash(b"\x17\0\0\0a=b;typehash=RIHS01_00;\0").as_deref(), Some("RIHS01_00"));
        assert_eq!(type_hash(b""), None);
        assert_eq!(type_hash(&[2, 0, 0, 0, 0xff, 0xfe]), None);
    }
}
