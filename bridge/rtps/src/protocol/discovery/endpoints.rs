//! Announcement of local and remote endpoints (SEDP, section 8.5.4).
//!
//! The SEDP topics have a key, the GUID. Writers do not support keys, so superseded samples are removed from
//! the history here.

use std::{net::SocketAddrV4, time::Duration};

use bytes::Bytes;

use crate::{
    protocol::{
        Event, Fault, Now, Participant, Sample, WriteOptions,
        participant::Timer,
        peers::{Full, Noted},
    },
    wire::{EndpointData, EntityId, Guid, GuidPrefix, InlineQos, Payload, SequenceNumber, StatusInfo},
};

/// Delay before the endpoints of a participant are requested again. Several changes share a request.
const AUDIT_DELAY: Duration = Duration::from_millis(100);
const AUDIT_PERIOD: Duration = Duration::from_secs(1);

/// The builtin writer that announces an endpoint.
fn announcing_writer(id: EntityId, is_protected: bool) -> EntityId {
    match (id.is_writer(), is_protected) {
        (true, false) => EntityId::SEDP_PUBLICATIONS_WRITER,
        (false, false) => EntityId::SEDP_SUBSCRIPTIONS_WRITER,
        (true, true) => EntityId::SEDP_PUBLICATIONS_SECURE_WRITER,
        (false, true) => EntityId::SEDP_SUBSCRIPTIONS_SECURE_WRITER,
    }
}

impl Participant {
    fn is_discovery_protected(&self, topic: &str) -> bool {
        self.guard.as_deref().is_some_and(|guard| guard.protection_of(topic).discovery)
    }

    /// Announces a local endpoint.
    pub(in crate::protocol) fn announce_endpoint(&mut self, now: Now, id: EntityId) {
        let Some(data) = self.locals.data(id) else { return };
        let mut payload = Vec::new();
        data.emit(&mut payload);
        let key_hash = Some(data.guid.to_bytes());
        let inline_qos = InlineQos { key_hash, ..InlineQos::default() };
        let announcing = announcing_writer(id, self.is_discovery_protected(&data.topic));
        if let Some(number) = self.write_builtin(now, announcing, payload.into(), inline_qos) {
            self.announced.note(id, number);
        }
    }

    /// Announces the removal of a local endpoint, which is about to be removed.
    pub(in crate::protocol) fn dispose_endpoint(&mut self, now: Now, id: EntityId) {
        let Some(data) = self.locals.data(id) else { return };
        let announcing = announcing_writer(id, self.is_discovery_protected(&data.topic));
        if let Some(number) = self.announced.remove(id)
            && let Some(local) = self.locals.writers.get_mut(&announcing)
        {
            local.machine.discard(number);
        }
        // Fast DDS requires the key hash, Cyclone DDS accepts the key hash or a payload.
        let inline_qos = InlineQos::removal(Guid::new(self.config.prefix, id));
        if let Some(number) = self.write_builtin(now, announcing, Bytes::new(), inline_qos) {
            self.announced.note_removal(announcing, number);
        }
        if self.is_acknowledged(announcing) {
            self.drop_removals(announcing);
        }
    }

    /// Removes removals from the history of `announcing` that all peers have acknowledged. New peers do not
    /// need them.
    pub(in crate::protocol) fn drop_removals(&mut self, announcing: EntityId) {
        let Some(local) = self.locals.writers.get_mut(&announcing) else { return };
        for number in self.announced.take_removals(announcing) {
            local.machine.discard(number);
        }
    }

    pub(super) fn write_builtin(
        &mut self,
        now: Now,
        writer: EntityId,
        payload: Bytes,
        inline_qos: InlineQos,
    ) -> Option<SequenceNumber> {
        let options = WriteOptions { inline_qos, ..WriteOptions::default() };
        self.with_writer(now, writer, |writer, links| writer.write(now, payload, options, links))?.ok()
    }

    /// Handles the announcement of an endpoint by its participant.
    pub(in crate::protocol) fn hear_of_endpoint(&mut self, now: Now, reader: EntityId, sample: &Sample) {
        let Some(peer) = self.peers.get(sample.writer.prefix) else { return };
        let from = SocketAddrV4::new(peer.source, 0);
        let payload =
            if sample.is_key { Payload::Key(&sample.payload) } else { Payload::Data(&sample.payload) };
        let is_removal = sample.inline_qos.status.is_some_and(StatusInfo::is_removal);
        if is_removal {
            match sample.inline_qos.removed(payload) {
                Some(guid) if !self.may_announce(reader, guid, None) => {
                    self.fault(now, Fault::Rejected, from);
                }
                Some(guid) if guid.prefix == sample.writer.prefix => {
                    self.remove_remote(now, guid);
                    // Not if it only makes room or announces other addresses: its keys do not come again.
                    if let Some(guard) = self.guard.as_deref_mut() {
                        guard.forget_endpoint(guid);
                    }
                    self.plan_audit(now, guid.prefix);
                }
                Some(_) => self.fault(now, Fault::ForeignEndpoint, from),
                None => self.fault(now, Fault::MalformedDiscovery, from),
            }
            return;
        }
        let data = match EndpointData::parse(&sample.payload) {
            Ok(data) => data,
            Err(_) => return self.fault(now, Fault::MalformedDiscovery, from),
        };
        let announces_writers =
            matches!(reader, EntityId::SEDP_PUBLICATIONS_READER | EntityId::SEDP_PUBLICATIONS_SECURE_READER);
        let entity = data.guid.entity;
        if data.guid.prefix != sample.writer.prefix || entity.is_builtin() {
            self.fault(now, Fault::ForeignEndpoint, from);
        } else if entity.is_writer() != announces_writers || entity.is_reader() == announces_writers {
            self.fault(now, Fault::MalformedDiscovery, from);
        } else if !self.may_announce(reader, data.guid, Some(&data.topic)) {
            self.fault(now, Fault::Rejected, from);
        } else {
            self.note_remote(now, data, from);
        }
    }

    /// Whether an endpoint may be announced to that reader: to the protected one if and only if the discovery
    /// of its topic, announced and known, is protected.
    fn may_announce(&self, reader: EntityId, guid: Guid, topic: Option<&str>) -> bool {
        if self.guard.is_none() {
            return true;
        }
        let is_protected = matches!(
            reader,
            EntityId::SEDP_PUBLICATIONS_SECURE_READER | EntityId::SEDP_SUBSCRIPTIONS_SECURE_READER
        );
        let known = self.peers.endpoint(guid).map(|remote| remote.data.topic.as_str());
        topic.into_iter().chain(known).all(|topic| self.is_discovery_protected(topic) == is_protected)
    }

    fn note_remote(&mut self, now: Now, data: EndpointData, from: SocketAddrV4) {
        let guid = data.guid;
        let moved = self.peers.endpoint(guid).is_some_and(|known| {
            known.data.topic != data.topic
                || known.data.type_name != data.type_name
                || known.data.unicast != data.unicast
        });
        if moved {
            self.remove_remote(now, guid);
            self.plan_audit(now, guid.prefix);
        }
        if self.peers.needs_room(guid, &self.config.limits) {
            self.fault(now, Fault::TooManyEndpoints, from);
            let Some(expendable) = self.peers.expendable_endpoint(guid.prefix) else { return };
            self.remove_remote(now, expendable);
        }
        match self.peers.note(data, &self.config.limits) {
            Ok(Noted::Same) => return,
            Ok(Noted::New) => self.events.push_back(Event::EndpointFound { remote: guid }),
            Ok(Noted::Changed) => {
                self.plan_audit(now, guid.prefix);
                self.events.push_back(Event::EndpointChanged { remote: guid });
            }
            Err(Full::Participant | Full::All) => return self.fault(now, Fault::TooManyEndpoints, from),
        }
        self.match_remote(now, guid);
    }

    /// Plans to request the endpoints of a participant again after one was removed or changed: anybody can do
    /// that in its name, and the participant does not announce them again by itself.
    fn plan_audit(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get(prefix).filter(|peer| peer.account.is_known()) else { return };
        let earliest = peer.audited.map_or(now.steady, |audited| audited + AUDIT_PERIOD);
        self.timers.set(Timer::Audit(prefix), Some(earliest.max(now.steady + AUDIT_DELAY)));
    }

    /// Requests all endpoints of a participant again.
    pub(in crate::protocol) fn audit(&mut self, now: Now, prefix: GuidPrefix) {
        let Some(peer) = self.peers.get_mut(prefix) else { return };
        peer.audited = Some(now.steady);
        for (writer, reader) in [
            (EntityId::SEDP_PUBLICATIONS_WRITER, EntityId::SEDP_PUBLICATIONS_READER),
            (EntityId::SEDP_SUBSCRIPTIONS_WRITER, EntityId::SEDP_SUBSCRIPTIONS_READER),
            (EntityId::SEDP_PUBLICATIONS_SECURE_WRITER, EntityId::SEDP_PUBLICATIONS_SECURE_READER),
            (EntityId::SEDP_SUBSCRIPTIONS_SECURE_WRITER, EntityId::SEDP_SUBSCRIPTIONS_SECURE_READER),
        ] {
            self.with_reader(now, reader, |reader, _, links| {
                reader.start_over(now, Guid::new(prefix, writer), links);
            });
        }
    }

    /// Removes an endpoint of another participant.
    pub(in crate::protocol) fn remove_remote(&mut self, now: Now, guid: Guid) {
        let Some(remote) = self.peers.endpoint_mut(guid) else { return };
        for local in std::mem::take(&mut remote.matched) {
            self.unmatch(now, local, guid);
        }
        let Some(remote) = self.peers.forget_endpoint(guid) else { return };
        for local in self.locals.on_topic(&remote.data.topic) {
            if let Some(refused) = self.locals.refused_mut(local) {
                refused.remove(&guid);
            }
        }
        self.events.push_back(Event::EndpointLeft { remote: guid });
    }
}
