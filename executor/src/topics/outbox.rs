//! Where a module's publications wait for the sync phase: private to the module, so a publish is a push.

use std::any::Any;
use std::marker::PhantomData;

use super::message_type::AnyMessage;

/// A module's key to one of its topics, from [`Setup::publish`](crate::Setup::publish).
///
/// It is a small number, valid only in the module that made it.
pub struct Publication<T> {
    outbox: u32,
    message: PhantomData<fn(T)>,
}

impl<T> Publication<T> {
    pub(crate) fn new(outbox: usize) -> Self {
        Self { outbox: u32::try_from(outbox).unwrap_or(u32::MAX), message: PhantomData }
    }

    pub(crate) fn outbox(&self) -> usize {
        self.outbox as usize
    }
}

impl<T> Clone for Publication<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Publication<T> {}

/// The messages of one module for one topic that the sync phase has not seen yet.
pub(crate) struct Outbox<T> {
    pub(crate) topic: usize,
    pub(crate) messages: Vec<T>,
}

/// An [`Outbox`] whose message type is known to its topic only.
pub(crate) trait AnyOutbox: Any + Send {
    fn topic(&self) -> usize;
    fn discard(&mut self);
    fn is_empty(&self) -> bool;
    /// Adds a message of its type; another is discarded, and `false` returned.
    fn add_any(&mut self, message: AnyMessage) -> bool;
    /// The messages in an outbox of their own; this one stays, empty.
    fn split_off(&mut self) -> Box<dyn AnyOutbox>;
}

impl<T: Send + 'static> AnyOutbox for Outbox<T> {
    fn topic(&self) -> usize {
        self.topic
    }

    fn discard(&mut self) {
        self.messages.clear();
    }

    fn is_empty(&self) -> bool {
        self.messages.is_empty()
    }

    fn add_any(&mut self, message: AnyMessage) -> bool {
        message.downcast().map(|message| self.messages.push(*message)).is_ok()
    }

    fn split_off(&mut self) -> Box<dyn AnyOutbox> {
        Box::new(Self { topic: self.topic, messages: std::mem::take(&mut self.messages) })
    }
}

/// The outboxes of one module, and which of them hold messages.
#[derive(Default)]
pub(crate) struct Outboxes {
    /// Each with its topic.
    boxes: Vec<(usize, Box<dyn AnyOutbox>)>,
    filled: Vec<usize>,
}

impl Outboxes {
    /// The key for publishing on a topic; a topic has one outbox per module, so that its order is kept.
    pub(crate) fn open<T: Send + 'static>(&mut self, topic: usize) -> Publication<T> {
        let existing = self.boxes.iter().position(|(known, _)| *known == topic);
        Publication::new(existing.unwrap_or_else(|| {
            self.boxes.push((topic, Box::new(Outbox::<T> { topic, messages: Vec::new() })));
            self.boxes.len() - 1
        }))
    }

    /// Adds messages to an outbox. Returns whether they are the first ones in it; `None` if the key is not of this module.
    #[inline]
    #[must_use]
    pub(crate) fn add<T: Send + 'static>(
        &mut self,
        publication: Publication<T>,
        add: impl FnOnce(&mut Vec<T>),
    ) -> Option<bool> {
        let index = publication.outbox();
        let outbox: &mut dyn Any = &mut *self.boxes.get_mut(index)?.1;
        let Outbox { messages, .. } = outbox.downcast_mut::<Outbox<T>>()?;
        let was_empty = messages.is_empty();
        add(messages);
        let are_first = was_empty && !messages.is_empty();
        if are_first {
            self.filled.push(index);
        }
        Some(are_first)
    }

    /// Hands each outbox that holds messages, with its topic, to `consume`, which takes them, in the order in which they were first
    /// filled.
    #[inline]
    pub(crate) fn drain(&mut self, mut consume: impl FnMut(usize, &mut dyn AnyOutbox)) {
        for &index in &self.filled {
            let (topic, outbox) = &mut self.boxes[index];
            consume(*topic, &mut **outbox);
        }
        self.filled.clear();
    }
}
