//! Who is matched with whom, and which endpoints others have: kept up to date from the events of discovery.
//!
//! The status channel of each rustdds endpoint holds four events and drops the rest, so counts come from the
//! participant's, which holds 2048.

use super::qos;
use super::returned::ReturnWatch;
use crate::middleware::rejoining::Trouble;
use crate::middleware::{Direction, Gid, MatchHandler, RemoteEndpoint};
use rustdds::{DomainParticipantStatusEvent as Event, EndpointDescription, GUID, LostReason, QosPolicies};
use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::Instant;

/// The number of endpoints that one of ours is matched with, shared with its handle.
pub(super) type MatchedCount = Arc<AtomicUsize>;

/// The handlers of the endpoints whose matches have changed, to be called when the lock is free again.
pub(super) type Changed = Vec<Arc<MatchHandler>>;

#[derive(Default)]
struct Matched {
    count: MatchedCount,
    peers: HashSet<Gid>,
    on_change: Option<Arc<MatchHandler>>,
}

impl Matched {
    fn changed(&self, changed: &mut Changed) {
        self.count.store(self.peers.len(), Ordering::Release);
        changed.extend(self.on_change.clone());
    }
}

/// See the module.
pub(super) struct Matches {
    own: [u8; 12],
    local: HashMap<Gid, Matched>,
    remote: HashMap<Gid, RemoteEndpoint>,
    last_participant: Option<Instant>,
    /// Where there is a supervisor to tell.
    watch: Option<ReturnWatch>,
}

impl Matches {
    pub(super) fn new(own: Gid, watch: Option<ReturnWatch>) -> Self {
        Self {
            own: own.participant(),
            local: HashMap::new(),
            remote: HashMap::new(),
            last_participant: None,
            watch,
        }
    }

    /// The count of a local endpoint; events may have come before this call.
    pub(super) fn watch(&mut self, local: Gid) -> MatchedCount {
        Arc::clone(&self.local.entry(local).or_default().count)
    }

    /// Whom a local endpoint is matched with.
    pub(super) fn peers(&self, local: Gid) -> Vec<Gid> {
        self.local.get(&local).map(|matched| matched.peers.iter().copied().collect()).unwrap_or_default()
    }

    pub(super) fn on_change(&mut self, local: Gid, handler: MatchHandler) {
        self.local.entry(local).or_default().on_change = Some(Arc::new(handler));
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

    /// When another participant was last found.
    pub(super) fn last_participant(&self) -> Option<Instant> {
        self.last_participant
    }

    /// Applies one event of discovery.
    #[must_use]
    pub(super) fn apply(&mut self, event: Event) -> Changed {
        let mut changed = Changed::new();
        match event {
            Event::ParticipantDiscovered { .. } => self.last_participant = Some(Instant::now()),
            Event::ReaderDetected { reader } => self.detected(reader, Direction::In),
            Event::WriterDetected { writer } => self.detected(writer, Direction::Out),
            Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
                let lost = gid(guid);
                self.remote.remove(&lost);
                self.remove_peers(|peer| peer == lost, &mut changed);
            }
            Event::ParticipantLost { id, reason } => {
                let mut anyone = GUID::GUID_UNKNOWN;
                anyone.prefix = id;
                let lost = gid(anyone).participant();
                if let (LostReason::Timeout { .. }, Some(watch)) = (reason, &mut self.watch) {
                    watch.lost(lost);
                }
                self.remote.retain(|gid, _| gid.participant() != lost);
                self.remove_peers(|peer| peer.participant() == lost, &mut changed);
            }
            Event::RemoteReaderMatched { local_writer: local, remote_reader: peer }
            | Event::RemoteWriterMatched { local_reader: local, remote_writer: peer } => {
                if gid(peer).participant() == self.own {
                    return changed;
                }
                let matched = self.local.entry(gid(local)).or_default();
                matched.peers.insert(gid(peer));
                matched.changed(&mut changed);
            }
            Event::RemoteReaderQosIncompatible { remote_reader, requested_qos, offered_qos, .. } => {
                self.warn_about_incompatible("subscription", remote_reader, &requested_qos, &offered_qos);
            }
            Event::RemoteWriterQosIncompatible { remote_writer, requested_qos, offered_qos, .. } => {
                self.warn_about_incompatible("publisher", remote_writer, &requested_qos, &offered_qos);
            }
            _ => {}
        }
        changed
    }

    /// Tells the supervisor, if there is one.
    pub(super) fn tell(&self, trouble: Trouble) {
        if let Some(watch) = &self.watch {
            watch.tell(trouble);
        }
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
                liveliness,
                liveliness_lease_duration,
                type_hash: type_hash(&endpoint.user_data),
            },
        );
    }

    fn remove_peers(&mut self, is_lost: impl Fn(Gid) -> bool, changed: &mut Changed) {
        for matched in self.local.values_mut() {
            let before = matched.peers.len();
            matched.peers.retain(|peer| !is_lost(*peer));
            if matched.peers.len() != before {
                matched.changed(changed);
            }
        }
    }

    fn warn_about_incompatible(
        &self,
        what: &str,
        peer: GUID,
        requested: &QosPolicies,
        offered: &QosPolicies,
    ) {
        let peer = gid(peer);
        let requested = qos::reliability_and_durability(requested, Direction::In);
        let offered = qos::reliability_and_durability(offered, Direction::Out);
        let topic = self.remote.get(&peer).map_or("", |endpoint| endpoint.topic_name.as_str());
        tracing::warn!(
            topic,
            %peer,
            "a {what} does not match: requested {requested:?}, offered {offered:?} (or deadline or liveliness differ)"
        );
    }
}

/// The identity that rustdds calls GUID.
pub(super) fn gid(guid: GUID) -> Gid {
    Gid(guid.to_bytes())
}

/// The hash in the user data of an endpoint: `typehash=RIHS01_…;` among other `key=value;` pairs. The engine gives the value of
/// the parameter as it stands on the wire: a sequence of bytes, which begins with its length.
fn type_hash(user_data: &[u8]) -> Option<String> {
    let text = std::str::from_utf8(user_data.get(4..)?).ok()?;
    text.split(';').find_map(|pair| pair.strip_prefix("typehash=")).map(str::to_owned)
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
