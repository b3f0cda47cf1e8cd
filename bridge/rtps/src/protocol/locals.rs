//! Local endpoints including builtin ones, with indexes for datagrams and matches.

use std::collections::{BTreeMap, BTreeSet};

use super::{Reader, Writer};
use crate::wire::{EndpointData, EntityId, Guid};

/// A local endpoint.
#[derive(Debug)]
pub(crate) struct Local<E> {
    pub(crate) data: EndpointData,
    pub(crate) machine: E,
    pub(crate) matched: BTreeSet<Guid>,
    /// Reliable readers that are matched with a writer and have not answered yet: they may not know the
    /// writer.
    pub(crate) unanswered: BTreeSet<Guid>,
    /// Endpoints of the same topic for which a mismatch was reported.
    pub(crate) refused: BTreeSet<Guid>,
    /// Whether the matched writers of a reader are alive, for those whose liveliness is known.
    pub(crate) liveliness: BTreeMap<Guid, bool>,
    /// Whether a write was refused and the event that the window is open again is still to be reported.
    pub(crate) is_full: bool,
}

impl<E> Local<E> {
    fn new(data: EndpointData, machine: E) -> Self {
        Self {
            data,
            machine,
            matched: BTreeSet::new(),
            unanswered: BTreeSet::new(),
            refused: BTreeSet::new(),
            liveliness: BTreeMap::new(),
            is_full: false,
        }
    }
}

/// All local endpoints.
#[derive(Debug, Default)]
pub(crate) struct Locals {
    pub(crate) writers: BTreeMap<EntityId, Local<Writer>>,
    pub(crate) readers: BTreeMap<EntityId, Local<Reader>>,
    /// Without builtin endpoints.
    by_topic: BTreeMap<String, Vec<EntityId>>,
    /// The readers of a message that does not name a reader, by writer.
    readers_of: BTreeMap<Guid, Vec<EntityId>>,
}

impl Locals {
    pub(crate) fn add_writer(&mut self, data: EndpointData, writer: Writer) {
        self.index(&data);
        self.writers.insert(data.guid.entity, Local::new(data, writer));
    }

    pub(crate) fn add_reader(&mut self, data: EndpointData, reader: Reader) {
        self.index(&data);
        self.readers.insert(data.guid.entity, Local::new(data, reader));
    }

    fn index(&mut self, data: &EndpointData) {
        if !data.guid.entity.is_builtin() {
            self.by_topic.entry(data.topic.clone()).or_default().push(data.guid.entity);
        }
    }

    /// Removes an endpoint that has no matches left.
    pub(crate) fn remove(&mut self, id: EntityId) -> Option<EndpointData> {
        let writer = self.writers.remove(&id).map(|local| local.data);
        let data = writer.or_else(|| self.readers.remove(&id).map(|local| local.data))?;
        if let Some(ids) = self.by_topic.get_mut(&data.topic) {
            ids.retain(|other| *other != id);
            if ids.is_empty() {
                self.by_topic.remove(&data.topic);
            }
        }
        Some(data)
    }

    pub(crate) fn data(&self, id: EntityId) -> Option<&EndpointData> {
        let writer = self.writers.get(&id).map(|local| &local.data);
        writer.or_else(|| self.readers.get(&id).map(|local| &local.data))
    }

    pub(crate) fn matched(&self, id: EntityId) -> Option<&BTreeSet<Guid>> {
        let writer = self.writers.get(&id).map(|local| &local.matched);
        writer.or_else(|| self.readers.get(&id).map(|local| &local.matched))
    }

    pub(crate) fn matched_mut(&mut self, id: EntityId) -> Option<&mut BTreeSet<Guid>> {
        let writer = self.writers.get_mut(&id).map(|local| &mut local.matched);
        writer.or_else(|| self.readers.get_mut(&id).map(|local| &mut local.matched))
    }

    pub(crate) fn refused_mut(&mut self, id: EntityId) -> Option<&mut BTreeSet<Guid>> {
        let writer = self.writers.get_mut(&id).map(|local| &mut local.refused);
        writer.or_else(|| self.readers.get_mut(&id).map(|local| &mut local.refused))
    }

    pub(crate) fn on_topic(&self, topic: &str) -> Vec<EntityId> {
        self.by_topic.get(topic).cloned().unwrap_or_default()
    }

    /// The endpoints of the user.
    pub(crate) fn announced(&self) -> impl Iterator<Item = &EndpointData> {
        self.by_topic.values().flatten().filter_map(|id| self.data(*id))
    }

    pub(crate) fn readers_of(&self, writer: Guid) -> &[EntityId] {
        self.readers_of.get(&writer).map_or(&[], Vec::as_slice)
    }

    pub(crate) fn note_source(&mut self, reader: EntityId, writer: Guid) {
        let readers = self.readers_of.entry(writer).or_default();
        if !readers.contains(&reader) {
            readers.push(reader);
        }
    }

    pub(crate) fn forget_source(&mut self, reader: EntityId, writer: Guid) {
        if let Some(readers) = self.readers_of.get_mut(&writer) {
            readers.retain(|other| *other != reader);
            if readers.is_empty() {
                self.readers_of.remove(&writer);
            }
        }
    }
}
