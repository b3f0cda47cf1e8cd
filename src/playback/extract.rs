//! All messages of some topics of a bag, read at once.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use downbeat_bags::{Reader, ReaderError, Selection, TopicId};
use downbeat_edge::Interfaces;
use downbeat_msgs::encoding;

use crate::encoding::{RecordedType, RecordedTypeError};

/// What can go wrong when messages are read as CDR.
pub(crate) trait ReadError:
    From<ReaderError> + From<RecordedTypeError> + From<encoding::Error>
{
}

impl<E: From<ReaderError> + From<RecordedTypeError> + From<encoding::Error>> ReadError for E {}

/// The messages of topics as CDR, each topic's in the order of the bag. Every chunk holds messages of most topics, so reading
/// them together takes as long as reading those of one.
pub(crate) struct Extract {
    interfaces: Interfaces,
    messages: BTreeMap<TopicId, Vec<Bytes>>,
}

impl Extract {
    /// Nothing yet.
    pub(crate) fn new(interfaces: &Interfaces) -> Self {
        Self { interfaces: interfaces.clone(), messages: BTreeMap::new() }
    }

    pub(crate) fn read<E: ReadError>(
        reader: &Reader,
        topics: &BTreeSet<TopicId>,
        interfaces: &Interfaces,
    ) -> Result<Self, E> {
        let mut extract = BTreeMap::new();
        for &id in topics {
            extract.insert(id, (RecordedType::of(&reader.topics()[id.index()], interfaces)?, Vec::new()));
        }
        for message in reader.messages(Selection::all().topics(topics.iter().copied()))? {
            let message = message?;
            if let Some((recorded, messages)) = extract.get_mut(&message.topic) {
                messages.push(recorded.to_cdr(message.data)?);
            }
        }
        let messages = extract.into_iter().map(|(id, (_, messages))| (id, messages)).collect();
        Ok(Self { interfaces: interfaces.clone(), messages })
    }

    /// The types that its messages were read by.
    pub(crate) fn interfaces(&self) -> &Interfaces {
        &self.interfaces
    }

    /// Those of a topic that was read, or is read now.
    pub(crate) fn of<E: ReadError>(&mut self, reader: &Reader, topic: TopicId) -> Result<&[Bytes], E> {
        if !self.messages.contains_key(&topic) {
            let mut read = Self::read::<E>(reader, &BTreeSet::from([topic]), &self.interfaces)?;
            self.messages.append(&mut read.messages);
        }
        Ok(self.messages.get(&topic).map_or(&[], Vec::as_slice))
    }
}
