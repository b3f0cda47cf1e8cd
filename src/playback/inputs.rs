//! Messages of a bag as input of a core.

use std::collections::BTreeMap;
use std::iter::Peekable;

use downbeat_bags::{Messages, Reader, Selection, TopicId};
use downbeat_edge::{EncodedInlet, Interfaces};
use downbeat_executor::Core;

use super::PlaybackError;
use crate::encoding::RecordedType;

/// Messages of some topics, given in the order of the bag.
pub(crate) struct Inputs {
    inlets: BTreeMap<TopicId, (EncodedInlet, RecordedType)>,
    messages: Option<Peekable<Messages>>,
    given: u64,
}

impl Inputs {
    /// Of these topics, named without the leading slash; those that the bag lacks are passed over.
    pub(crate) fn open<'a>(
        core: &mut Core,
        reader: &Reader,
        topics: impl IntoIterator<Item = &'a str>,
        interfaces: &Interfaces,
    ) -> Result<Self, PlaybackError> {
        let mut inlets = BTreeMap::new();
        for name in topics {
            let Some(id) = reader.topic(&format!("/{name}")) else { continue };
            let recorded = RecordedType::of(&reader.topics()[id.index()], interfaces)?;
            inlets.insert(id, (interfaces.inlet(core, name, recorded.message_type())?, recorded));
        }
        if inlets.is_empty() {
            return Ok(Self { inlets, messages: None, given: 0 });
        }
        let messages = reader.messages(Selection::all().topics(inlets.keys().copied()))?;
        Ok(Self { inlets, messages: Some(messages.peekable()), given: 0 })
    }

    pub(crate) fn next_time(&mut self) -> Result<Option<i64>, PlaybackError> {
        let Some(messages) = &mut self.messages else { return Ok(None) };
        if let Some(Err(error)) = messages.next_if(Result::is_err) {
            return Err(error.into());
        }
        Ok(messages.peek().and_then(|message| message.as_ref().ok()).map(|message| message.log_time))
    }

    /// Gives all messages up to that time.
    pub(crate) fn give(&mut self, time: i64) -> Result<(), PlaybackError> {
        while self.next_time()?.is_some_and(|next| next <= time) {
            let message = self.messages.as_mut().and_then(Iterator::next);
            let Some(message) = message.transpose()? else { break };
            if let Some((inlet, recorded)) = self.inlets.get(&message.topic) {
                inlet.publish(&recorded.to_cdr(message.data)?)?;
                self.given += 1;
            }
        }
        Ok(())
    }

    /// How many messages were given.
    pub(crate) fn given(&self) -> u64 {
        self.given
    }
}
