//! The other participants and their endpoints.

use std::{
    collections::BTreeMap,
    net::{Ipv4Addr, SocketAddrV4},
    time::Instant,
};

use super::{Limits, LinkId, account::Account, guard::Admission};
use crate::wire::{EndpointData, EntityId, Guid, GuidPrefix, ParticipantData, VendorId};

/// Another participant, known by its announcement.
#[derive(Debug)]
pub(crate) struct Peer {
    pub(crate) data: ParticipantData,
    /// The address from which its announcement came.
    pub(crate) source: Ipv4Addr,
    /// The host to which messages for it are sent.
    pub(crate) host: Ipv4Addr,
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
    /// Whether its port was closed, so that nothing is sent to it.
    pub(crate) is_closed: bool,
    /// Senders that wait until the account allows sending.
    pub(crate) withheld: Vec<(LinkId, EntityId)>,
    /// When the last valid message arrived.
    pub(crate) heard: Instant,
    /// When the last message arrived that is addressed to this participant and comes from its host.
    pub(crate) answered: Instant,
    /// What was announced in its name and is applied only if it no longer answers.
    pub(crate) doubtful: Option<Doubtful>,
    /// When its endpoints were last requested again.
    pub(crate) audited: Option<Instant>,
    /// When the announcement of this participant was last sent to it.
    pub(crate) announced: Instant,
    pub(crate) endpoints: BTreeMap<EntityId, Remote>,
}

impl Peer {
    /// Returns whether an endpoint of it is matched.
    pub(crate) fn is_matched(&self) -> bool {
        self.endpoints.values().any(|remote| !remote.matched.is_empty())
    }

    /// Returns whether it runs this engine.
    pub(crate) fn is_ours(&self) -> bool {
        self.data.vendor == VendorId::OURS
    }
}

/// An announcement that may be forged: the participant was asked whether it is still there.
#[derive(Debug)]
pub(crate) struct Doubtful {
    pub(crate) change: Change,
    /// When it was asked.
    pub(crate) asked: Instant,
    /// How often it has answered a question before this one.
    pub(crate) answers: u32,
}

/// A change that silences a participant.
#[derive(Debug)]
pub(crate) enum Change {
    Farewell,
    /// Other addresses, announced from an address by a datagram of this length.
    Move(Box<ParticipantData>, Ipv4Addr, usize),
}

/// An endpoint of another participant.
#[derive(Debug)]
pub(crate) struct Remote {
    pub(crate) data: EndpointData,
    /// Number of endpoints that were announced before it.
    age: u64,
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
    /// Number of endpoints that were ever stored.
    announced: u64,
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

    /// The participant to remove for a new one that announces itself from `newcomer`; `None` if the new one
    /// is not stored.
    ///
    /// Participants that were never validated go first. After them, addresses share the room: one of the
    /// address with the most participants goes, first those without matches. Matched ones go only if their
    /// address has more participants than that of the newcomer would have.
    pub(crate) fn expendable(&self, newcomer: Ipv4Addr) -> Option<GuidPrefix> {
        let oldest = |is_expendable: &dyn Fn(&Peer) -> bool| {
            let peers = self.iter().filter(|(_, peer)| is_expendable(peer));
            peers.min_by_key(|(prefix, peer)| (peer.heard, *prefix)).map(|(prefix, _)| prefix)
        };
        if let Some(unknown) = oldest(&|peer| !peer.account.is_known()) {
            return Some(unknown);
        }
        let mut shares = BTreeMap::<Ipv4Addr, usize>::new();
        self.by_prefix.values().for_each(|peer| *shares.entry(peer.host).or_default() += 1);
        let own = shares.get(&newcomer).copied().unwrap_or_default() + 1;
        let mut crowds: Vec<_> =
            shares.into_iter().filter(|(host, share)| *host == newcomer || *share > own).collect();
        crowds.sort_by_key(|(host, share)| (std::cmp::Reverse(*share), *host));
        let unmatched = |host: Ipv4Addr| oldest(&|peer| peer.host == host && !peer.is_matched());
        crowds.iter().find_map(|(host, _)| unmatched(*host)).or_else(|| {
            let (host, _) = crowds.iter().find(|(host, _)| *host != newcomer)?;
            oldest(&|peer| peer.host == *host)
        })
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

    /// Returns whether an endpoint is new and there is no room for it, although its participant may have
    /// more.
    pub(crate) fn needs_room(&self, guid: Guid, limits: &Limits) -> bool {
        let is_admissible = |peer: &Peer| {
            !peer.endpoints.contains_key(&guid.entity)
                && peer.endpoints.len() < limits.endpoints_per_participant
        };
        self.endpoints >= limits.endpoints && self.get(guid.prefix).is_some_and(is_admissible)
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
        self.announced += 1;
        let age = self.announced;
        self.endpoints += 1;
        self.by_topic.entry(data.topic.clone()).or_default().push(guid);
        peer.endpoints.insert(guid.entity, Remote { data, age, matched: Vec::new() });
        Ok(Noted::New)
    }

    /// The endpoint to remove for a new one of the participant `newcomer`; `None` if the new one is not
    /// stored.
    ///
    /// Addresses share the room, and so do the participants of an address. One of the participant with the
    /// most endpoints of the address with the most endpoints goes: the oldest one without a match, or else
    /// the newest.
    pub(crate) fn expendable_endpoint(&self, newcomer: GuidPrefix) -> Option<Guid> {
        let mut shares = BTreeMap::<Ipv4Addr, usize>::new();
        for peer in self.by_prefix.values() {
            *shares.entry(peer.host).or_default() += peer.endpoints.len();
        }
        let own = self.get(newcomer)?;
        let (host, share) = shares.iter().max_by_key(|(_, share)| **share)?;
        let is_own_host = own.host == *host;
        if !is_own_host && *share <= shares.get(&own.host)? + 1 {
            return None;
        }
        let peers = self.by_prefix.iter().filter(|(_, peer)| peer.host == *host);
        let (prefix, largest) = peers.max_by_key(|(_, peer)| peer.endpoints.len())?;
        if is_own_host && largest.endpoints.len() <= own.endpoints.len() + 1 {
            return None;
        }
        let remotes = || largest.endpoints.iter();
        let unmatched = remotes().filter(|(_, remote)| remote.matched.is_empty());
        let oldest = unmatched.min_by_key(|(_, remote)| remote.age);
        let (entity, _) = oldest.or_else(|| remotes().max_by_key(|(_, remote)| remote.age))?;
        Some(Guid::new(*prefix, *entity))
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
