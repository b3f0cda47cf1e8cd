//! Messages on their way out of the executor.

use super::{CoreAccess, KnownType};
use bytes::Bytes;
use downbeat_executor::{AnyReceived, Outlet, OutletInbox, SetupError, Time};

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

/// Serializes the messages of a topic for a sink; a raw type's, those of that type only.
pub(super) fn open(
    message_type: KnownType,
    core: &mut CoreAccess<'_>,
    topic: &str,
    inbox: &OutletInbox,
    mut sink: Box<dyn Sink>,
) -> Result<Outlet, SetupError> {
    core.outlet_of(
        message_type.in_core(),
        topic,
        inbox,
        move |AnyReceived { message, time, is_last, missed }| {
            let offered = Offered { time, is_last_of_cycle: is_last, missed };
            if message_type.is_of(message)
                && sink.is_wanted(offered)
                && let Some(cdr) = message_type.encode(message)
            {
                sink.take(time, cdr);
            }
        },
    )
}
