//! Messages on their way out of the executor.

use super::CoreAccess;
use bytes::Bytes;
use downbeat_executor::{Outlet, OutletInbox, Received, SetupError, Time};
use downbeat_msgs::{Message, cdr};

/// Takes the serialized messages of a topic.
pub trait Sink: Send + 'static {
    /// Whether the next message is wanted: asked before each is serialized, so that what nobody wants costs nothing.
    fn is_wanted(&mut self, _message: Offered) -> bool {
        true
    }

    /// Takes a message: the time of the cycle that published it; encapsulation header (little-endian) and body.
    fn take(&mut self, time: Time, cdr: Bytes);
}

/// What is known of a message before it is serialized.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offered {
    /// The time of the cycle that published it.
    pub time: Time,
    /// True if the topic carried no message after it in that cycle.
    pub is_last_of_cycle: bool,
    /// How many messages before it the inbox dropped, because the sink was too slow.
    pub missed: u32,
}

/// A closure wants everything.
impl<F: FnMut(Time, Bytes) + Send + 'static> Sink for F {
    fn take(&mut self, time: Time, cdr: Bytes) {
        self(time, cdr);
    }
}

// The sink is boxed: the code below exists once per message type, not once more per sink.
pub(super) fn open<T: Message>(
    core: &mut CoreAccess<'_>,
    topic: &str,
    inbox: &OutletInbox,
    mut sink: Box<dyn Sink>,
) -> Result<Outlet, SetupError> {
    core.outlet(topic, inbox, move |message: Received<'_, T>| {
        if sink.is_wanted(Offered::of(&message)) {
            sink.take(message.time(), cdr::to_vec(&*message).into());
        }
    })
}

impl Offered {
    pub(super) fn of<T>(message: &Received<'_, T>) -> Self {
        let (time, is_last_of_cycle) = (message.time(), message.is_last());
        Self { time, is_last_of_cycle, missed: message.missed() }
    }
}
