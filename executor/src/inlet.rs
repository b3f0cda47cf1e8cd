//! Messages from threads outside the executor.

use std::num::NonZeroUsize;
use std::sync::Arc;

use crate::core::World;
use crate::guard::drop_guarded;
use crate::join::JoinQueue;
use crate::messaging::{AnyMessage, AnyOutbox, MessageType, Outbox, Topics};
use crate::queue::{Locked, Overflow, Pushed, Queue};
use crate::{SetupError, Stage, Time};

/// Why an [`Inlet`] did not take a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InletError {
    /// The core has not yet taken what was published before.
    #[error("the inlet is full: {0} messages wait for the core")]
    Full(usize),
    /// The core has stopped, or is gone.
    #[error("the core has stopped")]
    Stopped,
}

/// Publishes on a topic from threads outside the executor; from [`Core::inlet`](crate::Core::inlet) or
/// [`Core::inlet_with`](crate::Core::inlet_with).
///
/// A message joins at the next sync phase: inlets in the order in which they were made, each in the order of its
/// queue.
///
/// ```
/// use downbeat_executor::{Core, InletError, ManualClock, Time};
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// let range = core.inlet::<f64>("range")?; // m
/// let driver = std::thread::spawn(move || (range.publish(1.25), range));
/// let (taken, range) = driver.join().unwrap();
/// taken?;
/// core.cycle()?; // It joins; subscribers would receive it in the next cycle.
/// assert_eq!(core.topics().next().unwrap().counter.messages(), 1);
/// core.stop();
/// assert_eq!(range.publish(1.3), Err(InletError::Stopped));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Inlet<T> {
    messages: Arc<dyn Queue<T>>,
    queue: Arc<JoinQueue>,
}

impl<T> Clone for Inlet<T> {
    fn clone(&self) -> Self {
        Self { messages: Arc::clone(&self.messages), queue: Arc::clone(&self.queue) }
    }
}

impl<T: Send + 'static> Inlet<T> {
    /// How many messages may wait for the core, where no other queue was asked for.
    pub const CAPACITY: usize = 65_536;

    pub(crate) fn new(messages: Arc<dyn Queue<T>>, queue: Arc<JoinQueue>) -> Self {
        Self { messages, queue }
    }

    /// Hands a message to the core. Never waits.
    ///
    /// # Errors
    /// If too many messages wait already and the queue refuses more, or the core has stopped; the message is dropped.
    pub fn publish(&self, message: T) -> Result<(), InletError> {
        if self.queue.is_closed() {
            return Err(InletError::Stopped);
        }
        if let Pushed::Refused(_) = self.messages.push(message) {
            return Err(InletError::Full(self.messages.len()));
        }
        self.queue.announce_inlet();
        // The core may have taken its last look between the two.
        if self.queue.is_closed() { Err(InletError::Stopped) } else { Ok(()) }
    }

    /// How many messages the queue has dropped so far because it was full; see [`Overflow`].
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.messages.dropped()
    }
}

/// The queue of inlets that were not given one.
pub(crate) fn default_queue<T: Send + 'static>() -> Locked<T> {
    Locked::bounded(NonZeroUsize::MIN.saturating_add(Inlet::<T>::CAPACITY - 1), Overflow::Refuse)
}

/// Makes an inlet of a topic.
pub(crate) fn open_inlet<T: Send + Sync + 'static>(
    stage: &mut Stage,
    world: &mut World,
    topic: &str,
    queue: impl Queue<T> + 'static,
) -> Result<Inlet<T>, SetupError> {
    let index = stage.shared.topics.open::<T>(topic, "inlet")?;
    Ok(add_inlet(stage, world, queue, Outbox { topic: index, messages: Vec::new() }))
}

/// The same for messages whose type only the topic knows.
pub(crate) fn open_inlet_of(
    stage: &mut Stage,
    world: &mut World,
    message_type: MessageType,
    topic: &str,
    queue: impl Queue<AnyMessage> + 'static,
) -> Result<Inlet<AnyMessage>, SetupError> {
    let index = (message_type.open)(&mut stage.shared.topics, topic, "inlet")?;
    Ok(add_inlet(stage, world, queue, (message_type.outbox)(index)))
}

fn add_inlet<T: Send + 'static>(
    stage: &mut Stage,
    world: &mut World,
    queue: impl Queue<T> + 'static,
    outbox: impl Filled<T> + 'static,
) -> Inlet<T> {
    let messages: Arc<dyn Queue<T>> = Arc::new(queue);
    let port = InletPort { messages: Arc::clone(&messages), outbox, dropped: 0 };
    stage.shared.topics.add_publisher(port.topic());
    world.inlets.push(Box::new(port));
    Inlet::new(messages, Arc::clone(&world.queue))
}

/// The core's side of an [`Inlet`].
struct InletPort<T, O: Filled<T>> {
    messages: Arc<dyn Queue<T>>,
    outbox: O,
    /// How many of the messages that the queue dropped are counted.
    dropped: u64,
}

/// The outbox of an inlet whose queue holds values of type `T`.
trait Filled<T>: Send {
    fn fill(&mut self, messages: impl Iterator<Item = T>);
    fn outbox(&self) -> &dyn AnyOutbox;
    fn outbox_mut(&mut self) -> &mut dyn AnyOutbox;
}

impl<T: Send + 'static> Filled<T> for Outbox<T> {
    fn fill(&mut self, messages: impl Iterator<Item = T>) {
        self.messages.extend(messages);
    }

    fn outbox(&self) -> &dyn AnyOutbox {
        self
    }

    fn outbox_mut(&mut self) -> &mut dyn AnyOutbox {
        self
    }
}

impl Filled<AnyMessage> for Box<dyn AnyOutbox> {
    fn fill(&mut self, messages: impl Iterator<Item = AnyMessage>) {
        for message in messages {
            if !self.add_any(message) {
                tracing::error!("a message of another type than that of its topic is discarded");
            }
        }
    }

    fn outbox(&self) -> &dyn AnyOutbox {
        &**self
    }

    fn outbox_mut(&mut self) -> &mut dyn AnyOutbox {
        &mut **self
    }
}

/// An [`InletPort`] whose type only the topic knows.
pub(crate) trait AnyInlet: Send {
    fn topic(&self) -> usize;
    /// Moves what waits now to the topic. What comes while this runs waits for the next cycle, so that a busy thread
    /// cannot hold this one.
    fn drain(&mut self, topics: &mut Topics, now: Time);
    /// True if all inlets are gone, and with them whoever could publish.
    fn is_orphaned(&self) -> bool;
}

impl<T: Send + 'static, O: Filled<T>> AnyInlet for InletPort<T, O> {
    fn topic(&self) -> usize {
        self.outbox.outbox().topic()
    }

    fn drain(&mut self, topics: &mut Topics, now: Time) {
        let dropped = self.messages.dropped();
        topics.meter_mut(self.topic()).dropped(dropped.saturating_sub(self.dropped));
        self.dropped = dropped;
        let waiting = self.messages.len();
        self.outbox.fill(std::iter::from_fn(|| self.messages.pop()).take(waiting));
        if !self.outbox.outbox().is_empty() {
            topics.absorb(self.outbox.outbox_mut(), now);
        }
    }

    fn is_orphaned(&self) -> bool {
        Arc::strong_count(&self.messages) == 1 && self.messages.is_empty()
    }
}

impl<T, O: Filled<T>> Drop for InletPort<T, O> {
    fn drop(&mut self) {
        drop_guarded("a message", || self.outbox.outbox_mut().discard());
    }
}
