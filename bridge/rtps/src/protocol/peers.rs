//! The other participants and their endpoints.

use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddrV4},
    time::Instant,
};

use super::{Limits, LinkId, counters::Account, guard::Admission};
use crate::wire::{EndpointData, EntityId, Guid, GuidPrefix, ParticipantData, VendorId};

/// Another participant, known by its announcement.
#[derive(Debug)]
pub(crate) struct Peer {
    pub(crate) data: ParticipantData,
    /// The address from which its announcement came.
    pub(crate) source: Ipv4Addr,
    /// Whether it is on this host.
    pub(crate) is_own_host: bool,
    /// Whether the guard admits it. Until then nothing is matched with it.
    pub(crate) admission: Admission,
    /// The link for discovery.
    pub(crate) metatraffic: LinkId,
    /// The link for samples of endpoints without their own address.
    pub(crate) default: LinkId,
    /// All links, including the two above.
    pub(crate) links: Vec<(SocketAddrV4, LinkId)>,
    pub(crate) account: Account,
    /// Senders that wait until the account allows sending.
    pub(crate) withheld: Vec<(LinkId, EntityId)>,
    /// When the last valid message arrived.
    pub(crate) heard: Instant,
    /// When the announcement of this participant was last sent to it.
    pub(crate) announced: Instant,
    pub(crate) endpoints: BTreeMap<EntityId, Remote>,
}

impl Peer {
    /// Returns whether it runs this engine.
    pub(crate) fn is_ours(&self) -> bool {
        self.data.vendor == VendorId::OURS
    }
}

/// An endpoint of another participant.
#[derive(Debug)]
pub(crate) struct Remote {
    pub(crate) data: EndpointData,
    /// Local endpoints that are matched with it.
    pub(crate) matched: Vec<EntityId>,
}

/// Why an endpoint is not stored.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Full {
    /// Its participant has too many endpoints.
    Participant,
    /// All participants together have too many endpoints.
    All,
}

/// The result of storing announced endpoint data.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Noted {
    New,
    Changed,
    Same,
}

/// All other participants, with an index of their endpoints by topic.
#[derive(Debug, Default)]
pub(crate) struct Peers {
    by_prefix: BTreeMap<GuidPrefix, Peer>,
    by_topic: BTreeMap<String, Vec<Guid>>,
    endpoints: usize,
}

impl Peers {
    pub(crate) fn len(&self) -> usize {
        self.by_prefix.len()
    }

    pub(crate) fn get(&self, prefix: GuidPrefix) -> Option<&Peer> {
        self.by_prefix.get(&prefix)
    }

    pub(crate) fn get_mut(&mut self, prefix: GuidPrefix) -> Option<&mut Peer> {
        self.by_prefix.get_mut(&prefix)
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = (GuidPrefix, &Peer)> {
        self.by_prefix.iter().map(|(prefix, peer)| (*prefix, peer))
    }

    pub(crate) fn iter_mut(&mut self) -> impl Iterator<Item = (GuidPrefix, &mut Peer)> {
        self.by_prefix.iter_mut().map(|(prefix, peer)| (*prefix, peer))
    }

    pub(crate) fn insert(&mut self, prefix: GuidPrefix, peer: Peer) {
        self.by_prefix.insert(prefix, peer);
    }

    /// Removes a participant that has no endpoints left.
    pub(crate) fn remove(&mut self, prefix: GuidPrefix) -> Option<Peer> {
        self.by_prefix.remove(&prefix)
    }

    /// The participant to remove for a new one: among those that never answered, the one with the oldest last
    /// message.
    pub(crate) fn expendable(&self) -> Option<GuidPrefix> {
        let unknown = self.iter().filter(|(_, peer)| !peer.account.is_known());
        unknown.min_by_key(|(prefix, peer)| (peer.heard, *prefix)).map(|(prefix, _)| prefix)
    }

    pub(crate) fn endpoint(&self, guid: Guid) -> Option<&Remote> {
        self.by_prefix.get(&guid.prefix)?.endpoints.get(&guid.entity)
    }

    pub(crate) fn endpoint_mut(&mut self, guid: Guid) -> Option<&mut Remote> {
        self.by_prefix.get_mut(&guid.prefix)?.endpoints.get_mut(&guid.entity)
    }

    pub(crate) fn on_topic(&self, topic: &str) -> Vec<Guid> {
        self.by_topic.get(topic).cloned().unwrap_or_default()
    }

    /// Stores a new or changed endpoint of a known participant. If the topic has changed, the caller removes
    /// the old endpoint first.
    pub(crate) fn note(&mut self, data: EndpointData, limits: &Limits) -> Result<Noted, Full> {
        let guid = data.guid;
        let Some(peer) = self.by_prefix.get_mut(&guid.prefix) else { return Err(Full::All) };
        if let Some(remote) = peer.endpoints.get_mut(&guid.entity) {
            let is_same = remote.data == data;
            remote.data = data;
            return Ok(if is_same { Noted::Same } else { Noted::Changed });
        }
        if peer.endpoints.len() >= limits.endpoints_per_participant {
            return Err(Full::Participant);
        }
        if self.endpoints >= limits.endpoints {
            return Err(Full::All);
        }
        self.endpoints += 1;
        self.by_topic.entry(data.topic.clone()).or_default().push(guid);
        peer.endpoints.insert(guid.entity, Remote { data, matched: Vec::new() });
        Ok(Noted::New)
    }

    pub(crate) fn forget_endpoint(&mut self, guid: Guid) -> Option<Remote> {
        let remote = self.by_prefix.get_mut(&guid.prefix)?.endpoints.remove(&guid.entity)?;
        self.endpoints -= 1;
        if let Some(guids) = self.by_topic.get_mut(&remote.data.topic) {
            guids.retain(|other| *other != guid);
            if guids.is_empty() {
                self.by_topic.remove(&remote.data.topic);
            }
        }
        Some(remote)
    }
}
