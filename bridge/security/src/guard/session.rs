//! What is known about an authenticated participant.

use std::collections::{BTreeMap, BTreeSet};

use downbeat_rtps::wire::EntityId;

use super::keys::materials;
use super::policy::Protection;
use crate::access::Grant;
use crate::cryptography::{KeyId, KeyMaterial, Opener, Sealer};
use crate::pki::Certificate;
use crate::tokens::Token;

/// The most keys that a participant may hand over: two for each endpoint of the largest known robots.
const MOST_KEYS: usize = 16_384;

/// The keys of an authenticated participant, and what was told to it.
pub(super) struct Session {
    pub(super) certificate: Certificate,
    pub(super) grant: Grant,
    /// Protects the channel for keys.
    pub(super) exchange_sealer: Sealer,
    pub(super) exchange_opener: Opener,
    /// The key of its whole messages.
    pub(super) participant: Option<Opener>,
    /// The keys of its endpoints.
    pub(super) keys: BTreeMap<KeyId, (EntityId, Opener)>,
    /// Its endpoints whose keys for an endpoint of this participant have arrived.
    received: BTreeSet<(EntityId, EntityId)>,
    /// Endpoints of this participant whose keys were sent to an endpoint of it.
    sent: BTreeSet<(EntityId, EntityId)>,
    /// How the messages of its endpoints have to be protected.
    pub(super) endpoints: BTreeMap<EntityId, Protection>,
    /// Pairs of endpoints whose refusal was reported.
    reported: BTreeSet<(EntityId, EntityId)>,
}

impl Session {
    pub(super) fn new(certificate: Certificate, grant: Grant, exchange: KeyMaterial, sealer: Sealer) -> Self {
        Self {
            certificate,
            grant,
            exchange_sealer: sealer,
            exchange_opener: Opener::new(exchange),
            participant: None,
            keys: BTreeMap::new(),
            received: BTreeSet::new(),
            sent: BTreeSet::new(),
            endpoints: BTreeMap::new(),
            reported: BTreeSet::new(),
        }
    }

    /// Takes over what stays valid after another handshake with the same participant.
    pub(super) fn keep_keys_of(&mut self, before: Self) {
        self.participant = before.participant;
        self.keys = before.keys;
        self.received = before.received;
        self.endpoints = before.endpoints;
        self.reported = before.reported;
    }

    /// Takes the key of its whole messages.
    pub(super) fn take_participant(&mut self, tokens: &[Token]) {
        if let Some(material) = materials(tokens).next() {
            self.participant = Some(Opener::new(material));
        }
    }

    /// Takes the keys of an endpoint of it for one of this participant. Returns whether they were awaited.
    pub(super) fn take_endpoint(&mut self, theirs: EntityId, ours: EntityId, tokens: &[Token]) -> bool {
        for material in materials(tokens) {
            // It comes once for each pair of endpoints.
            let is_known =
                self.keys.get(&material.id()).is_some_and(|(_, opener)| *opener.material() == material);
            if !is_known && self.keys.len() < MOST_KEYS {
                self.keys.insert(material.id(), (theirs, Opener::new(material)));
            }
        }
        self.received.len() < MOST_KEYS && self.received.insert((theirs, ours))
    }

    pub(super) fn has_received(&self, theirs: EntityId, ours: EntityId) -> bool {
        self.received.contains(&(theirs, ours))
    }

    /// Notes that the keys of an endpoint are sent to one of it. Returns whether that is the first time.
    pub(super) fn note_sent(&mut self, ours: EntityId, theirs: EntityId) -> bool {
        self.sent.insert((ours, theirs))
    }

    /// Notes that a refusal is reported. Returns whether that is the first time.
    pub(super) fn note_reported(&mut self, ours: EntityId, theirs: EntityId) -> bool {
        self.reported.len() < MOST_KEYS && self.reported.insert((ours, theirs))
    }

    /// Forgets an endpoint of this participant.
    pub(super) fn forget_ours(&mut self, ours: EntityId) {
        self.received.retain(|(_, to)| *to != ours);
        self.sent.retain(|(of, _)| *of != ours);
        self.reported.retain(|(of, _)| *of != ours);
    }

    /// Forgets an endpoint of it.
    pub(super) fn forget_theirs(&mut self, theirs: EntityId) {
        self.keys.retain(|_, (of, _)| *of != theirs);
        self.received.retain(|(of, _)| *of != theirs);
        self.sent.retain(|(_, to)| *to != theirs);
        self.reported.retain(|(_, to)| *to != theirs);
        self.endpoints.remove(&theirs);
    }
}
