//! All messages of some topics of a bag, read at once.

use std::collections::{BTreeMap, BTreeSet};

use bytes::Bytes;
use downbeat_bags::{Reader, ReaderError, Selection, TopicId};
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
#[derive(Default)]
pub(crate) struct Extract(BTreeMap<TopicId, Vec<Bytes>>);

impl Extract {
    pub(crate) fn read<E: ReadError>(reader: &Reader, topics: &BTreeSet<TopicId>) -> Result<Self, E> {
        let mut extract = BTreeMap::new();
        for &id in topics {
            extract.insert(id, (RecordedType::of(&reader.topics()[id.index()])?, Vec::new()));
        }
        for message in reader.messages(Selection::all().topics(topics.iter().copied()))? {
            let message = message?;
            if let Some((recorded, messages)) = extract.get_mut(&message.topic) {
                messages.push(recorded.to_cdr(message.data)?);
            }
        }
        Ok(Self(extract.into_iter().map(|(id, (_, messages))| (id, messages)).collect()))
    }

    /// Those of a topic that was read, or is read now.
    pub(crate) fn of<E: ReadError>(&mut self, reader: &Reader, topic: TopicId) -> Result<&[Bytes], E> {
        if !self.0.contains_key(&topic) {
            self.0.append(&mut Self::read::<E>(reader, &BTreeSet::from([topic]))?.0);
        }
        Ok(self.0.get(&topic).map_or(&[], Vec::as_slice))
    }
}
