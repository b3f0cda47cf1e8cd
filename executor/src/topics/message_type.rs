//! Messages whose type is known only at run time.

use std::fmt;

use super::boxed::{ErasedType, open_boxed};
use super::outbox::{AnyOutbox, BoxedOutbox, Outbox};
use super::topic::Topics;
use crate::SetupError;

/// A Rust message type as a value, for code that moves messages of hundreds of types into and out of a core,
/// such as a bridge to a network. [`Core::inlet_of`](crate::Core::inlet_of) and
/// [`Core::outlet_of`](crate::Core::outlet_of) are compiled once, [`Core::inlet`](crate::Core::inlet) and
/// [`Core::outlet`](crate::Core::outlet) once per type.
///
/// ```
/// use downbeat_executor::queue::LockFree;
/// use downbeat_executor::{Core, Inbox, ManualClock, MessageType, Time};
/// use std::sync::mpsc::channel;
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// let metres = MessageType::of::<f64>();
/// let (sender, ranges) = channel();
/// let _outlet = core.outlet_of(metres, "range", Inbox::KeepAll, move |message| {
///     drop(sender.send(message.message.downcast_ref::<f64>().copied()));
/// })?;
/// let range = core.inlet_of(metres, "range", LockFree::new())?;
/// range.publish(Box::new(1.25))?;
/// (0..2).try_for_each(|_| core.cycle())?;
/// assert_eq!(ranges.try_recv()?, Some(1.25));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Copy)]
pub struct MessageType {
    storage: Storage,
    name: Option<&'static str>,
}

/// How messages of a type are stored between publishers and subscribers.
#[derive(Clone, Copy)]
enum Storage {
    /// In the functions that are compiled for the type.
    Typed {
        open: fn(&mut Topics, &str, &str) -> Result<usize, SetupError>,
        outbox: fn(usize) -> Box<dyn AnyOutbox>,
    },
    /// In boxes, until a user of the topic knows the type.
    Boxed(&'static dyn ErasedType),
}

impl MessageType {
    /// The type `T`.
    #[must_use]
    pub const fn of<T: Send + Sync + 'static>() -> Self {
        Self {
            storage: Storage::Typed {
                open: Topics::open::<T>,
                outbox: |topic| Box::new(Outbox::<T> { topic, messages: Vec::new() }),
            },
            name: None,
        }
    }

    /// A type that is given by its identity: nothing is compiled for it. Its messages are in boxes until a
    /// module, inlet or outlet uses the topic with the Rust type.
    #[must_use]
    pub const fn erased(of: &'static dyn ErasedType) -> Self {
        Self { storage: Storage::Boxed(of), name: None }
    }

    /// The same Rust type under a name, for a type that carries messages of many kinds. A topic of named
    /// messages refuses messages of another name, and
    /// [`TopicInfo::message_type`](crate::TopicInfo::message_type) is the name. A user of the Rust type
    /// without a name receives all of them.
    #[must_use]
    pub const fn named(self, name: &'static str) -> Self {
        Self { name: Some(name), ..self }
    }

    /// The index of the topic of this name; creates the topic if there is none.
    pub(crate) fn open(self, topics: &mut Topics, topic: &str, module: &str) -> Result<usize, SetupError> {
        let index = match self.storage {
            Storage::Typed { open, .. } => open(topics, topic, module),
            Storage::Boxed(of) => open_boxed(topics, of, topic, module),
        }?;
        match self.name {
            Some(name) => topics.name_messages(index, name, module),
            None => Ok(()),
        }?;
        Ok(index)
    }

    /// An outbox for the topic with this index.
    pub(crate) fn outbox(self, topic: usize) -> Box<dyn AnyOutbox> {
        match self.storage {
            Storage::Typed { outbox, .. } => outbox(topic),
            Storage::Boxed(of) => Box::new(BoxedOutbox::new(topic, of.message_type())),
        }
    }
}

impl fmt::Debug for MessageType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MessageType").finish_non_exhaustive()
    }
}
