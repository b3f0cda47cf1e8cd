//! Inlets: messages from threads outside the executor.

use std::num::NonZeroUsize;
use std::sync::Arc;

use crate::module::Link;
use crate::module::MESSAGES;
use crate::queue::{Locked, Overflow, Pushed, Queue};
use crate::threads::drop_guarded;
use crate::topics::{AnyMessage, AnyOutbox, MessageType, Outbox, Topics};
use crate::{Core, CoreHandle, Receipt, SetupError, SyncPhase, Time};

/// Errors of [`Inlet::publish`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InletError {
    /// The core has not yet taken the earlier messages.
    #[error("the inlet is full: {0} messages wait for the core")]
    Full(usize),
    /// The core has stopped, or was dropped.
    #[error("the core has stopped")]
    Stopped,
}

/// Publishes on a topic from threads outside the executor; from [`Core::inlet`](crate::Core::inlet) or
/// [`Core::inlet_with`](crate::Core::inlet_with).
///
/// A message takes effect in the next sync phase, in the order in which the inlets were made and, within each
/// inlet, in the order of its queue.
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
    link: Arc<Link>,
}

impl<T> Clone for Inlet<T> {
    fn clone(&self) -> Self {
        Self { messages: Arc::clone(&self.messages), link: Arc::clone(&self.link) }
    }
}

impl<T: Send + 'static> Inlet<T> {
    /// The capacity of the default queue, in messages.
    pub const CAPACITY: usize = 65_536;

    pub(crate) fn new(messages: Arc<dyn Queue<T>>, link: Arc<Link>) -> Self {
        Self { messages, link }
    }

    /// Sends a message to the core. Never waits.
    ///
    /// # Errors
    /// If the queue is full and refuses the message, or the core has stopped; the message is dropped.
    pub fn publish(&self, message: T) -> Result<(), InletError> {
        if self.link.is_closed() {
            return Err(InletError::Stopped);
        }
        if let Pushed::Refused(_) = self.messages.push(message) {
            return Err(InletError::Full(self.messages.len()));
        }
        self.link.announce(MESSAGES);
        // The core may have stopped between the check and the push.
        if self.link.is_closed() { Err(InletError::Stopped) } else { Ok(()) }
    }

    /// How many messages the queue has dropped so far because it was full; see [`Overflow`].
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.messages.dropped()
    }
}

/// The queue of inlets without a given queue.
pub(crate) fn default_queue<T: Send + 'static>() -> Locked<T> {
    Locked::bounded(NonZeroUsize::MIN.saturating_add(Inlet::<T>::CAPACITY - 1), Overflow::Refuse)
}

impl Core {
    /// Opens a topic for publishing from threads outside the executor. The inlet's queue refuses messages if
    /// the core does not take them in time.
    ///
    /// # Errors
    /// If the name is invalid, or the topic carries another type.
    pub fn inlet<T: Send + Sync + 'static>(&mut self, topic: &str) -> Result<Inlet<T>, SetupError> {
        self.inlet_with(topic, default_queue())
    }

    /// Opens a topic for publishing from threads outside the executor, through the given queue.
    ///
    /// # Errors
    /// If the name is invalid, or the topic carries another type.
    pub fn inlet_with<T: Send + Sync + 'static>(
        &mut self,
        topic: &str,
        queue: impl Queue<T> + 'static,
    ) -> Result<Inlet<T>, SetupError> {
        open_inlet(&mut self.between_cycles(), topic, queue)
    }

    /// As [`inlet_with`](Self::inlet_with), for a message type given as a value. A message of another type is
    /// discarded with an error in the log.
    ///
    /// # Errors
    /// As for [`inlet_with`](Self::inlet_with).
    pub fn inlet_of(
        &mut self,
        message_type: MessageType,
        topic: &str,
        queue: impl Queue<AnyMessage> + 'static,
    ) -> Result<Inlet<AnyMessage>, SetupError> {
        open_inlet_of(&mut self.between_cycles(), message_type, topic, queue)
    }
}

impl CoreHandle {
    /// Opens a topic for publishing from threads outside the executor, as
    /// [`Core::inlet`](crate::Core::inlet).
    #[must_use = "the answer is in the receipt"]
    pub fn inlet<T: Send + Sync + 'static>(&self, topic: &str) -> Receipt<Result<Inlet<T>, SetupError>> {
        self.inlet_with(topic, default_queue())
    }

    /// Opens a topic for publishing from threads outside the executor while the core runs. The new inlet
    /// comes after the existing ones in the order of inlets.
    ///
    /// ```
    /// # use downbeat_executor::{Core, ManualClock, Time};
    /// use downbeat_executor::queue::{Locked, Overflow};
    ///
    /// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
    /// core.cycle()?;
    /// let queue = Locked::bounded(std::num::NonZeroUsize::MIN, Overflow::DropOldest);
    /// let receipt = core.handle().inlet_with::<f64>("range", queue); // m
    /// core.cycle()?; // Makes it in its sync phase.
    /// let range = receipt.try_take().unwrap()?;
    /// range.publish(1.25)?;
    /// core.cycle()?;
    /// assert_eq!(core.topics().find(|topic| &*topic.name == "range").unwrap().counter.messages(), 1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use = "the answer is in the receipt"]
    pub fn inlet_with<T: Send + Sync + 'static>(
        &self,
        topic: &str,
        queue: impl Queue<T> + 'static,
    ) -> Receipt<Result<Inlet<T>, SetupError>> {
        let topic = topic.to_owned();
        self.ask(move |phase| open_inlet(phase, &topic, queue))
    }

    /// As [`inlet_with`](Self::inlet_with), for a message type given as a value; see
    /// [`Core::inlet_of`](crate::Core::inlet_of).
    #[must_use = "the answer is in the receipt"]
    pub fn inlet_of(
        &self,
        message_type: MessageType,
        topic: &str,
        queue: impl Queue<AnyMessage> + 'static,
    ) -> Receipt<Result<Inlet<AnyMessage>, SetupError>> {
        let topic = topic.to_owned();
        self.ask(move |phase| open_inlet_of(phase, message_type, &topic, queue))
    }
}

fn open_inlet<T: Send + Sync + 'static>(
    phase: &mut SyncPhase<'_>,
    topic: &str,
    queue: impl Queue<T> + 'static,
) -> Result<Inlet<T>, SetupError> {
    let topic = phase.topics().open::<T>(topic, "inlet")?;
    Ok(add_inlet(phase, queue, Outbox { topic, messages: Vec::new() }))
}

fn open_inlet_of(
    phase: &mut SyncPhase<'_>,
    message_type: MessageType,
    topic: &str,
    queue: impl Queue<AnyMessage> + 'static,
) -> Result<Inlet<AnyMessage>, SetupError> {
    let topic = message_type.open(phase.topics(), topic, "inlet")?;
    Ok(add_inlet(phase, queue, message_type.outbox(topic)))
}

fn add_inlet<T: Send + 'static>(
    phase: &mut SyncPhase<'_>,
    queue: impl Queue<T> + 'static,
    outbox: impl Filled<T> + 'static,
) -> Inlet<T> {
    let messages: Arc<dyn Queue<T>> = Arc::new(queue);
    let port = InletPort { messages: Arc::clone(&messages), outbox, dropped: 0 };
    phase.topics().add_publisher(port.topic());
    if let Some(exchange) = phase.messages() {
        exchange.inlets.push(Box::new(port));
    }
    Inlet::new(messages, Arc::clone(&phase.state.link))
}

/// The core's side of an [`Inlet`].
struct InletPort<T, O: Filled<T>> {
    messages: Arc<dyn Queue<T>>,
    outbox: O,
    /// How many of the queue's dropped messages have been added to the statistics.
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
                tracing::error!("a message was discarded: its type is not that of the topic");
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

/// An [`InletPort`] with its type erased.
pub(crate) trait AnyInlet: Send {
    fn topic(&self) -> usize;
    /// Moves the waiting messages to the topic, and returns their number. Messages that arrive meanwhile wait
    /// for the next cycle, so that a busy thread cannot stall this one.
    fn drain(&mut self, topics: &mut Topics, now: Time, wake: &mut dyn FnMut(usize)) -> usize;
    /// True if all clones of the inlet have been dropped, so that no further message can come.
    fn is_orphaned(&self) -> bool;
}

impl<T: Send + 'static, O: Filled<T>> AnyInlet for InletPort<T, O> {
    fn topic(&self) -> usize {
        self.outbox.outbox().topic()
    }

    fn drain(&mut self, topics: &mut Topics, now: Time, wake: &mut dyn FnMut(usize)) -> usize {
        let dropped = self.messages.dropped();
        topics.meter_mut(self.topic()).dropped(dropped.saturating_sub(self.dropped));
        self.dropped = dropped;
        let waiting = self.messages.len();
        self.outbox.fill(std::iter::from_fn(|| self.messages.pop()).take(waiting));
        match self.outbox.outbox().is_empty() {
            true => 0,
            false => topics.absorb(self.outbox.outbox_mut(), now, wake),
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
