//! Liveliness assertions of writers by their participant (WLP, section 8.4.13).
//!
//! Only writers with a finite lease need assertions. Without such writers nothing is sent.

use std::time::Duration;

use bytes::Bytes;

use crate::{
    protocol::{Now, Participant, Sample, participant::Timer},
    qos::Liveliness as Kind,
    wire::{EndpointData, EntityId, Guid, GuidPrefix, InlineQos, ParticipantMessage},
};

/// Number of assertions in the shortest lease, so that one may be late.
const PER_LEASE: u32 = 3;

/// Shorter periods are not supported.
const SHORTEST_PERIOD: Duration = Duration::from_millis(1);

impl Participant {
    /// Updates the schedule after writers were added or removed.
    pub(in crate::protocol) fn plan_liveliness(&mut self, now: Now) {
        let leases = self.locals.writers.values().filter_map(|local| {
            let qos = &local.data.qos;
            qos.lease.filter(|_| qos.liveliness == Kind::Automatic)
        });
        let period = leases.min().map(|lease| (lease / PER_LEASE).max(SHORTEST_PERIOD));
        if self.liveliness_period != period {
            self.liveliness_period = period;
            self.timers.set(Timer::Liveliness, period.map(|_| now.steady));
        }
    }

    /// Asserts all writers whose liveliness is automatic.
    pub(in crate::protocol) fn assert_automatic_writers(&mut self, now: Now) {
        self.assert_writers(now, ParticipantMessage::AUTOMATIC);
        self.timers.set(Timer::Liveliness, self.liveliness_period.map(|period| now.steady + period));
    }

    /// Asserts a writer on behalf of the application.
    pub(in crate::protocol) fn assert_manual_writer(&mut self, now: Now, id: EntityId) {
        let Some(local) = self.locals.writers.get(&id) else { return };
        let is_for_all = local.data.qos.liveliness == Kind::ManualByParticipant;
        self.with_writer(now, id, |writer, links| writer.assert_liveliness(now, links));
        if is_for_all {
            self.assert_writers(now, ParticipantMessage::MANUAL);
        }
    }

    fn assert_writers(&mut self, now: Now, kind: u32) {
        let mut payload = Vec::new();
        ParticipantMessage { prefix: self.config.prefix, kind }.emit(&mut payload);
        let payload = Bytes::from(payload);
        for (is_protected, writer) in [(false, EntityId::WLP_WRITER), (true, EntityId::WLP_SECURE_WRITER)] {
            if is_protected && self.guard.is_none() {
                continue;
            }
            let writers: Vec<Guid> = self.asserted_by(self.config.prefix, kind, is_protected);
            // Without a guard also if there are none, as a sign of life.
            if !writers.is_empty() || self.guard.is_none() {
                self.write_builtin(now, writer, payload.clone(), InlineQos::default());
            }
            self.assert_these(now, writers);
        }
    }

    /// Handles an assertion of another participant.
    pub(in crate::protocol) fn hear_assertion(&mut self, now: Now, reader: EntityId, sample: &Sample) {
        // Other messages belong to other protocols on the same topic, such as those of DDS Security.
        if let Ok(message) = ParticipantMessage::parse(&sample.payload)
            && message.prefix == sample.writer.prefix
        {
            let is_protected = reader == EntityId::WLP_SECURE_READER;
            let writers = self.asserted_by(message.prefix, message.kind, is_protected);
            self.assert_these(now, writers);
        }
    }

    /// The writers of a participant that an assertion concerns: a protected one those of topics whose
    /// liveliness is protected.
    fn asserted_by(&self, prefix: GuidPrefix, kind: u32, is_protected: bool) -> Vec<Guid> {
        let asserted = match kind {
            ParticipantMessage::AUTOMATIC => Kind::Automatic,
            ParticipantMessage::MANUAL => Kind::ManualByParticipant,
            _ => return Vec::new(),
        };
        let guard = self.guard.as_deref();
        let is_asserted = |data: &EndpointData| {
            data.qos.liveliness == asserted
                && data.qos.lease.is_some()
                && guard.is_some_and(|guard| guard.protection_of(&data.topic).liveliness) == is_protected
        };
        if prefix == self.config.prefix {
            let own = self.locals.writers.values().filter(|local| is_asserted(&local.data));
            return own.map(|local| local.data.guid).collect();
        }
        let remotes = self.peers.get(prefix).into_iter().flat_map(|peer| peer.endpoints.values());
        let theirs = remotes.filter(|remote| {
            remote.data.guid.entity.is_writer() && !remote.matched.is_empty() && is_asserted(&remote.data)
        });
        theirs.map(|remote| remote.data.guid).collect()
    }

    fn assert_these(&mut self, now: Now, writers: Vec<Guid>) {
        for writer in writers {
            for reader in self.locals.readers_of(writer).to_vec() {
                self.with_reader(now, reader, |reader, received, _| {
                    reader.assert_liveliness(now, writer, received);
                });
            }
        }
    }
}
