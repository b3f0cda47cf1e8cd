//! Queues of a module's publications until the sync phase. They are private to the module, so publishing is a
//! plain push.

use std::any::{Any, TypeId};
use std::marker::PhantomData;

/// A message whose type is known only to its topic.
pub type AnyMessage = Box<dyn Any + Send + Sync>;

/// A module's key to one of its topics, from [`Setup::publish`](crate::Setup::publish).
///
/// The key is a small index, valid only in the module that made it.
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

/// A module's key to a topic whose message type is known only at run time, from
/// [`Setup::publish_of`](crate::Setup::publish_of).
#[derive(Clone, Copy, Debug)]
pub struct AnyPublication {
    outbox: u32,
}

/// The messages of one module for one topic, until the sync phase takes them.
pub(crate) struct Outbox<T> {
    pub(crate) topic: usize,
    pub(crate) messages: Vec<T>,
}

/// An [`Outbox`] whose message type is known only to its topic.
pub(crate) trait AnyOutbox: Any + Send {
    fn topic(&self) -> usize;
    fn discard(&mut self);
    fn is_empty(&self) -> bool;
    /// Adds a message of the outbox's type. Discards a message of another type, and returns `false`.
    fn add_any(&mut self, message: AnyMessage) -> bool;
    /// Moves the messages into a new outbox, and leaves this one empty.
    fn split_off(&mut self) -> Box<dyn AnyOutbox>;
    /// The messages, if they are in boxes.
    fn boxed(&mut self) -> Option<&mut Vec<AnyMessage>> {
        None
    }
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

/// An outbox of boxed messages, for publishers that know the type only by its identity.
pub(crate) struct BoxedOutbox {
    topic: usize,
    message_type: TypeId,
    messages: Vec<AnyMessage>,
}

impl BoxedOutbox {
    pub(crate) fn new(topic: usize, message_type: TypeId) -> Self {
        Self { topic, message_type, messages: Vec::new() }
    }
}

impl AnyOutbox for BoxedOutbox {
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
        let is_of_type = (*message).type_id() == self.message_type;
        if is_of_type {
            self.messages.push(message);
        }
        is_of_type
    }

    fn split_off(&mut self) -> Box<dyn AnyOutbox> {
        Box::new(Self { messages: std::mem::take(&mut self.messages), ..*self })
    }

    fn boxed(&mut self) -> Option<&mut Vec<AnyMessage>> {
        Some(&mut self.messages)
    }
}

/// The outboxes of one module, and the indices of those that hold messages.
#[derive(Default)]
pub(crate) struct Outboxes {
    /// The index of the topic, and its outbox.
    boxes: Vec<(usize, Box<dyn AnyOutbox>)>,
    filled: Vec<usize>,
}

impl Outboxes {
    /// Returns the key for publishing on a topic. A topic has one outbox per module, which keeps the order of
    /// its messages.
    pub(crate) fn open<T: Send + 'static>(&mut self, topic: usize) -> Publication<T> {
        let make = |topic| Box::new(Outbox::<T> { topic, messages: Vec::new() }) as Box<dyn AnyOutbox>;
        Publication::new(self.open_with(topic, make))
    }

    /// As [`open`](Self::open), for an outbox that `make` creates.
    pub(crate) fn open_any(
        &mut self,
        topic: usize,
        make: impl FnOnce(usize) -> Box<dyn AnyOutbox>,
    ) -> AnyPublication {
        AnyPublication { outbox: u32::try_from(self.open_with(topic, make)).unwrap_or(u32::MAX) }
    }

    fn open_with(&mut self, topic: usize, make: impl FnOnce(usize) -> Box<dyn AnyOutbox>) -> usize {
        let existing = self.boxes.iter().position(|(known, _)| *known == topic);
        existing.unwrap_or_else(|| {
            self.boxes.push((topic, make(topic)));
            self.boxes.len() - 1
        })
    }

    /// Adds messages to an outbox. Returns whether the outbox was empty before; `None` if the key is not of
    /// this module.
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

    /// As [`add`](Self::add), for a message whose type is known only to the outbox; also `None` if the type
    /// differs.
    #[must_use]
    pub(crate) fn add_any(&mut self, publication: AnyPublication, message: AnyMessage) -> Option<bool> {
        let index = publication.outbox as usize;
        let outbox = &mut self.boxes.get_mut(index)?.1;
        let was_empty = outbox.is_empty();
        if !outbox.add_any(message) {
            return None;
        }
        if was_empty {
            self.filled.push(index);
        }
        Some(was_empty)
    }

    /// Passes each outbox that holds messages, with its topic, to `consume`, which takes the messages. The
    /// order is that in which the outboxes first received a message.
    #[inline]
    pub(crate) fn drain(&mut self, mut consume: impl FnMut(usize, &mut dyn AnyOutbox)) {
        for &index in &self.filled {
            let (topic, outbox) = &mut self.boxes[index];
            consume(*topic, &mut **outbox);
        }
        self.filled.clear();
    }
}
