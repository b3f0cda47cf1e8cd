//! Messages whose type is known only at run time.

use std::any::Any;
use std::fmt;

use super::{AnyOutbox, Batch, Outbox, Topics};
use crate::{SetupError, Time};

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
    open: fn(&mut Topics, &str, &str) -> Result<usize, SetupError>,
    pub(crate) outbox: fn(usize) -> Box<dyn AnyOutbox>,
    pub(crate) visit: VisitBatch,
    name: Option<&'static str>,
}

/// Calls a function with each message of a batch, a `Batch<T>`.
pub(crate) type VisitBatch = fn(&dyn Any, &mut dyn FnMut(AnyReceived<'_>));

impl MessageType {
    /// The type `T`.
    #[must_use]
    pub const fn of<T: Send + Sync + 'static>() -> Self {
        Self {
            open: Topics::open::<T>,
            outbox: |topic| Box::new(Outbox::<T> { topic, messages: Vec::new() }),
            visit: visit::<T>,
            name: None,
        }
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
        let index = (self.open)(topics, topic, module)?;
        match self.name {
            Some(name) => topics.name_messages(index, name, module),
            None => Ok(()),
        }?;
        Ok(index)
    }
}

impl fmt::Debug for MessageType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("MessageType").finish_non_exhaustive()
    }
}

/// A message as passed to the sink of [`Core::outlet_of`](crate::Core::outlet_of).
#[derive(Clone, Copy, Debug)]
pub struct AnyReceived<'a> {
    /// The message, of the type given when the outlet was made.
    pub message: &'a (dyn Any + Send + Sync),
    /// As [`Received::time`](crate::Received::time).
    pub time: Time,
    /// As [`Received::is_last`](crate::Received::is_last).
    pub is_last: bool,
    /// As [`Received::missed`](crate::Received::missed).
    pub missed: u32,
}

fn visit<T: Send + Sync + 'static>(batch: &dyn Any, visitor: &mut dyn FnMut(AnyReceived<'_>)) {
    let Some(batch) = batch.downcast_ref::<Batch<T>>() else { return };
    let mut left = batch.len();
    for message in batch.segments().iter().flatten() {
        left -= 1;
        visitor(AnyReceived { message, time: batch.time(), is_last: left == 0, missed: 0 });
    }
}
