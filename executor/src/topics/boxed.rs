//! Topics whose users know the message type only by its identity: the messages stay in the boxes in which
//! they were published. The first user that knows the Rust type turns such a topic into a typed one.

use std::any::{Any, TypeId};
use std::sync::Arc;

use super::batch::{AnyBatch, AnyReceived, Batch};
use super::outbox::{AnyMessage, AnyOutbox};
use super::topic::{AnyTopic, Carried, NewTopic, TopicCounter, Topics};
use crate::threads::drop_guarded;
use crate::{SetupError, Time};

/// A Rust message type as [`MessageType::erased`](crate::MessageType::erased) takes it: code that moves
/// messages of hundreds of types implements it once, over a table.
pub trait ErasedType: Sync {
    /// The identity of the Rust type.
    fn message_type(&self) -> TypeId;
    /// The path of the Rust type, as [`std::any::type_name`] returns it.
    fn type_name(&self) -> &'static str;
    /// Copies a message of the type. Needed when a user that knows the Rust type joins while messages are on
    /// their way to other threads. `None` if the message cannot be copied; it then does not reach that user.
    fn copy(&self, message: &dyn Any) -> Option<AnyMessage>;
}

/// A batch of boxed messages.
#[derive(Default)]
struct BoxedBatch(Batch<AnyMessage>);

impl AnyBatch for BoxedBatch {
    fn visit(&self, visitor: &mut dyn FnMut(AnyReceived<'_>)) {
        self.0.visit_as(|message| &**message, visitor);
    }
}

struct BoxedTopic {
    of: &'static dyn ErasedType,
    batch: Arc<BoxedBatch>,
    counter: TopicCounter,
}

impl BoxedTopic {
    /// The batch, emptied; a new one if the old one is still shared.
    fn renewed(&mut self) -> Option<&mut Batch<AnyMessage>> {
        if Arc::strong_count(&self.batch) > 1 {
            self.batch = Arc::default();
        }
        let batch = &mut Arc::get_mut(&mut self.batch)?.0;
        if !drop_guarded("a message", || batch.clear()) {
            // The remaining messages are leaked, because dropping them could panic again.
            std::mem::forget(std::mem::take(batch));
        }
        Some(batch)
    }
}

impl AnyTopic for BoxedTopic {
    fn retire(&mut self) {
        self.renewed();
    }

    fn absorb(&mut self, outbox: &mut dyn AnyOutbox, now: Time, is_first: bool) -> usize {
        let counter = self.counter.clone();
        let batch =
            if is_first { self.renewed() } else { Arc::get_mut(&mut self.batch).map(|batch| &mut batch.0) };
        // Both hold by construction: a typed outbox is opened with the type, which makes the topic a typed
        // one.
        let (Some(messages), Some(batch)) = (outbox.boxed(), batch) else {
            debug_assert!(false, "a typed outbox reached a topic of boxes, or a batch in use");
            return 0;
        };
        let count = messages.len();
        counter.add(count);
        batch.stamp(now);
        batch.take_over(messages);
        count
    }

    fn share(&self) -> (Arc<dyn AnyBatch>, u32) {
        let messages = u32::try_from(self.messages()).unwrap_or(u32::MAX);
        (Arc::clone(&self.batch) as Arc<dyn AnyBatch>, messages)
    }

    fn messages(&self) -> usize {
        self.batch.0.len()
    }

    fn take_boxed(&mut self) -> Option<Carried> {
        let time = self.batch.0.time();
        let messages = match Arc::get_mut(&mut self.batch) {
            Some(batch) => batch.0.take_all(),
            None => {
                let messages = self.batch.0.segments().iter().flatten();
                let copies = messages.filter_map(|message| {
                    let copy = self.of.copy(&**message);
                    if copy.is_none() {
                        tracing::error!("a {} does not reach a new subscriber", self.of.type_name());
                    }
                    copy
                });
                copies.collect()
            }
        };
        Some(Carried { time, messages })
    }
}

/// The index of the topic of this name, which carries boxes if nothing has used it with the Rust type so far.
pub(super) fn open_boxed(
    topics: &mut Topics,
    of: &'static dyn ErasedType,
    topic: &str,
    module: &str,
) -> Result<usize, SetupError> {
    let make = |counter, _| Box::new(BoxedTopic { of, batch: Arc::default(), counter }) as Box<dyn AnyTopic>;
    let new = NewTopic {
        identity: (of.message_type(), of.type_name()),
        needs_drop: true,
        is_typed: false,
        make: &make,
    };
    topics.open_of(&new, topic, module)
}
