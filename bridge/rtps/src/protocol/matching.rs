//! Matching of endpoints.

use super::{Admission, Event, LivelinessChange, MatchedReader, MatchedWriter, Now, Participant};
use crate::{
    qos::{Durability, Policy, Reliability, incompatible},
    wire::{EndpointData, EntityId, Guid, VendorId},
};
use std::sync::Arc;

/// Whether two endpoints of one topic match.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Verdict {
    Match,
    OtherType,
    Incompatible(Policy),
    /// In different partitions, or not admitted. Not reported as incompatible.
    Apart,
}

fn judge(ours: &EndpointData, theirs: &EndpointData) -> Verdict {
    let is_writer = ours.guid.entity.is_writer();
    if is_writer == theirs.guid.entity.is_writer() {
        return Verdict::Apart;
    }
    if ours.type_name != theirs.type_name {
        return Verdict::OtherType;
    }
    let (offered, requested) = if is_writer { (ours, theirs) } else { (theirs, ours) };
    match incompatible(&offered.qos, &requested.qos) {
        None => Verdict::Match,
        Some(Policy::Partition) => Verdict::Apart,
        Some(policy) => Verdict::Incompatible(policy),
    }
}

fn is_reliable(data: &EndpointData) -> bool {
    data.qos.reliability == Reliability::Reliable
}

impl Participant {
    /// Matches a new local endpoint with all endpoints of its topic.
    pub(super) fn match_local(&mut self, now: Now, id: EntityId) {
        let Some(data) = self.locals.data(id) else { return };
        let (own, topic) = (data.guid, data.topic.clone());
        for remote in self.peers.on_topic(&topic) {
            self.consider(now, id, remote);
        }
        for other in self.locals.on_topic(&topic) {
            if other.is_writer() != id.is_writer() {
                self.consider(now, id, Guid::new(own.prefix, other));
                self.consider(now, other, own);
            }
        }
    }

    /// Matches a new or changed remote endpoint with all local endpoints of its topic.
    pub(super) fn match_remote(&mut self, now: Now, guid: Guid) {
        let Some(remote) = self.peers.endpoint(guid) else { return };
        for local in self.locals.on_topic(&remote.data.topic) {
            self.consider(now, local, guid);
        }
    }

    fn consider(&mut self, now: Now, local: EntityId, remote: Guid) {
        let verdict = self.verdict(now, local, remote);
        let is_matched = self.locals.matched(local).is_some_and(|matched| matched.contains(&remote));
        match verdict {
            // Also if it is already matched: the policies may have changed.
            Some(Verdict::Match) => self.connect(now, local, remote, is_matched),
            _ if is_matched => {
                if let Some(known) = self.peers.endpoint_mut(remote) {
                    known.matched.retain(|id| *id != local);
                }
                self.unmatch(now, local, remote);
            }
            _ => {}
        }
        let Some(verdict @ (Verdict::OtherType | Verdict::Incompatible(_))) = verdict else {
            if let Some(refused) = self.locals.refused_mut(local) {
                refused.remove(&remote);
            }
            return;
        };
        if !self.locals.refused_mut(local).is_some_and(|refused| refused.insert(remote)) {
            return;
        }
        self.events.push_back(match verdict {
            Verdict::Incompatible(policy) => Event::Incompatible { local, remote, policy },
            _ => {
                let type_name = self.data(remote).map_or_else(Arc::default, |data| data.type_name[..].into());
                Event::OtherType { local, remote, type_name }
            }
        });
    }

    /// The data of an endpoint of this participant or of another one.
    fn data(&self, guid: Guid) -> Option<&EndpointData> {
        if guid.prefix == self.config.prefix {
            self.locals.data(guid.entity)
        } else {
            self.peers.endpoint(guid).map(|known| &known.data)
        }
    }

    fn verdict(&mut self, now: Now, local: EntityId, remote: Guid) -> Option<Verdict> {
        let ours = self.locals.data(local)?;
        if remote.prefix == self.config.prefix {
            return Some(judge(ours, self.locals.data(remote.entity)?));
        }
        let peer = self.peers.get(remote.prefix)?;
        let theirs = &peer.endpoints.get(&remote.entity)?.data;
        let verdict = judge(ours, theirs);
        if verdict != Verdict::Match {
            // The guard gives keys to those that it admits.
            return Some(verdict);
        }
        let is_admitted = peer.admission == Admission::Admit
            && (peer.account.is_known() || local.is_reader())
            && self
                .guard
                .as_deref_mut()
                .is_none_or(|guard| guard.admit_endpoint(now, ours, theirs) == Admission::Admit);
        Some(if is_admitted { verdict } else { Verdict::Apart })
    }

    fn connect(&mut self, now: Now, local: EntityId, remote: Guid, is_matched: bool) {
        let Some(link) = self.link_to(remote) else { return };
        let Some(ours) = self.locals.data(local) else { return };
        let is_own = remote.prefix == self.config.prefix;
        let vendor = match self.peers.get(remote.prefix) {
            Some(peer) if !is_own => peer.data.vendor,
            _ => VendorId::OURS,
        };
        let Some(theirs) = self.data(remote) else { return };
        let both = |holds: fn(&EndpointData) -> bool| holds(ours) && holds(theirs);
        let is_reliable = both(is_reliable);
        let wants_history = both(|data| data.qos.durability >= Durability::TransientLocal);
        let reader = MatchedReader { guid: remote, is_reliable, wants_history, link };
        let writer = MatchedWriter {
            guid: remote,
            is_reliable,
            lifespan: theirs.qos.lifespan,
            liveliness_lease: ours.qos.lease,
            link,
            numbers: self.numbers_of(remote.prefix, Some(ours)),
            vendor,
        };
        if let Some(matched) = self.locals.matched_mut(local) {
            matched.insert(remote);
        }
        if !is_matched {
            if let Some(known) = self.peers.endpoint_mut(remote) {
                known.matched.push(local);
            }
            match self.locals.writers.get_mut(&local).filter(|_| is_reliable) {
                Some(writer) => {
                    writer.unanswered.insert(remote);
                    let count = writer.unanswered.len();
                    self.events.push_back(Event::Awaiting { writer: local, count });
                }
                // Before the consequences of the match, such as a waiting sample or a change of liveliness.
                None => self.events.push_back(Event::Matched { local, remote }),
            }
        }
        if local.is_writer() {
            self.with_writer(now, local, |writer, links| writer.match_reader(now, reader, links));
        } else {
            self.locals.note_source(local, remote);
            self.with_reader(now, local, |reader, _, _| reader.match_writer(now, writer));
        }
    }

    /// Handles the first acknowledgement of a reader: it knows the writer, so samples written from now on
    /// reach it.
    pub(super) fn note_acquaintance(&mut self, local: EntityId, remote: Guid) {
        if let Some(count) = self.no_longer_await(local, remote) {
            self.events.push_back(Event::Matched { local, remote });
            self.events.push_back(Event::Awaiting { writer: local, count });
        }
    }

    /// Returns how many readers are still awaited if this one was.
    fn no_longer_await(&mut self, writer: EntityId, reader: Guid) -> Option<usize> {
        let unanswered = &mut self.locals.writers.get_mut(&writer)?.unanswered;
        (!unanswered.is_empty() && unanswered.remove(&reader)).then_some(unanswered.len())
    }

    /// Unmatches a local endpoint from another. The caller updates the matches of the other endpoint.
    pub(super) fn unmatch(&mut self, now: Now, local: EntityId, remote: Guid) {
        if !self.locals.matched_mut(local).is_some_and(|matched| matched.remove(&remote)) {
            return;
        }
        if local.is_writer() {
            self.with_writer(now, local, |writer, links| writer.unmatch_reader(now, remote, links));
            if let Some(count) = self.no_longer_await(local, remote) {
                self.events.push_back(Event::Awaiting { writer: local, count });
                return;
            }
        } else {
            self.locals.forget_source(local, remote);
            self.with_reader(now, local, |reader, _, _| reader.unmatch_writer(remote));
            let was_alive =
                self.locals.readers.get_mut(&local).and_then(|local| local.liveliness.remove(&remote));
            if let Some(was_alive) = was_alive {
                let change = if was_alive {
                    LivelinessChange::AliveRemoved
                } else {
                    LivelinessChange::NotAliveRemoved
                };
                self.events.push_back(Event::LivelinessChanged { reader: local, writer: remote, change });
            }
        }
        self.events.push_back(Event::Unmatched { local, remote });
    }

    /// Unmatches a local endpoint, which is about to be removed, from all others.
    pub(super) fn unmatch_local(&mut self, now: Now, id: EntityId) {
        let own = Guid::new(self.config.prefix, id);
        for remote in self.matched(id) {
            if let Some(known) = self.peers.endpoint_mut(remote) {
                known.matched.retain(|other| *other != id);
            }
            if remote.prefix == own.prefix {
                self.unmatch(now, remote.entity, own);
            }
            self.unmatch(now, id, remote);
        }
        let topic = self.locals.data(id).map(|data| data.topic.clone()).unwrap_or_default();
        for other in self.locals.on_topic(&topic) {
            if let Some(refused) = self.locals.refused_mut(other) {
                refused.remove(&own);
            }
        }
    }
}
