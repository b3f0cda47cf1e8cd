//! Which samples of the announcing writers announce which endpoints.

use std::collections::BTreeMap;

use crate::wire::{EntityId, SequenceNumber};

/// The contents of the histories of the announcing writers.
#[derive(Debug, Default)]
pub(crate) struct Announced {
    current: BTreeMap<EntityId, SequenceNumber>,
    /// Removals that not all peers have acknowledged yet, by announcing writer.
    removals: BTreeMap<EntityId, Vec<SequenceNumber>>,
}

impl Announced {
    /// Notes the sample that announces an endpoint.
    pub(super) fn note(&mut self, id: EntityId, number: SequenceNumber) {
        self.current.insert(id, number);
    }

    /// Forgets an endpoint; returns the sample that announced it.
    pub(super) fn remove(&mut self, id: EntityId) -> Option<SequenceNumber> {
        self.current.remove(&id)
    }

    /// Notes a sample of `announcing` that announces the removal of an endpoint.
    pub(super) fn note_removal(&mut self, announcing: EntityId, number: SequenceNumber) {
        self.removals.entry(announcing).or_default().push(number);
    }

    /// Forgets the removals that `announcing` has announced, and returns their samples.
    pub(super) fn take_removals(&mut self, announcing: EntityId) -> Vec<SequenceNumber> {
        self.removals.remove(&announcing).unwrap_or_default()
    }
}
