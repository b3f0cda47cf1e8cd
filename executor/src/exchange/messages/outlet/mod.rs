//! Outlets: messages for threads outside the executor.

mod mailbox;
mod outlets;

use std::any::Any;
use std::cell::Cell;
use std::marker::PhantomData;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard};

pub(crate) use outlets::Outlets;

use super::Messages;
use crate::cycle::CoreLife;
use crate::module::MESSAGES;
use crate::threads::{drop_guarded, end_of, unpoisoned};
use crate::topics::{AnyBatch, AnyReceived, Batch, MessageType, Topics, for_each_message};
use crate::{Core, CoreHandle, Inbox, Receipt, Received, SetupError, SyncPhase};

/// A subscription of a topic from outside the core, which ends when it is dropped. Made by
/// [`Core::outlet`](crate::Core::outlet) or [`CoreHandle::outlet`](crate::CoreHandle::outlet).
///
/// Messages are passed to a *sink*, a closure that runs on a separate thread and may block without delaying a
/// cycle. Under a clock that does not run by itself, the sink runs inside the next cycle, before the modules.
/// If a sink panics, the panic is logged and the sink is not called again.
///
/// When the core stops, the sink receives the last messages of all modules, and is then dropped. When the
/// outlet itself is dropped, the sink is dropped at once, or after the message that it is processing; waiting
/// messages are discarded.
///
/// ```
/// use downbeat_executor::{Core, Inbox, ManualClock, Received, Time};
/// use std::sync::mpsc::channel;
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// let (sender, ranges) = channel();
/// let outlet = core.outlet("range", Inbox::KeepAll, move |range: Received<'_, f64>| drop(sender.send(*range)))?;
/// core.inlet("range")?.publish(1.25)?; // m
/// (0..2).try_for_each(|_| core.cycle())?;
/// assert_eq!(ranges.try_recv()?, 1.25);
/// drop(outlet);
/// assert!(ranges.recv().is_err(), "the sink is gone");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use = "an outlet that is dropped receives nothing"]
pub struct Outlet {
    shared: Arc<OutletShared>,
    core: CoreHandle,
    is_kept: bool,
}

impl Outlet {
    /// The number of messages that the inbox has dropped because the sink was too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.dropped.load(Ordering::Relaxed)
    }

    /// Leaves the outlet open until the core stops.
    pub fn keep(mut self) {
        self.is_kept = true;
    }
}

impl std::fmt::Debug for Outlet {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Outlet").field("topic", &self.shared.topic).finish_non_exhaustive()
    }
}

impl Drop for Outlet {
    fn drop(&mut self) {
        if self.is_kept {
            return;
        }
        self.shared.close();
        self.core.look(|phase| {
            if let Some((outlets, topics)) = outlets_and_topics(phase) {
                outlets.prune(topics);
            }
        });
    }
}

/// The queue of messages for the sinks of one or more outlets. The sinks of one inbox share a thread and
/// receive batches in the order of publishing, across topics.
///
/// An outlet with an unshared inbox is opened with an [`Inbox`], and its inbox is named after the topic.
///
/// ```
/// use downbeat_executor::{Core, Inbox, OutletInbox, Received};
/// use std::sync::mpsc::channel;
///
/// let mut core = Core::new();
/// let logbook = OutletInbox::new("logbook", Inbox::KeepAll);
/// let (lines, written) = channel();
/// let say = lines.clone();
/// let _said = core.outlet("said", &logbook, move |text: Received<'_, String>| drop(say.send(text.clone())))?;
/// let _seen = core.outlet("seen", &logbook, move |count: Received<'_, u32>| {
///     drop(lines.send(format!("{} balls at {}", *count, count.time())));
/// })?;
/// core.inlet("said")?.publish("kick-off".to_owned())?;
/// core.cycle()?;
/// core.inlet("seen")?.publish(1_u32)?;
/// core.cycle()?;
/// core.stop(); // Waits for the sinks.
/// assert_eq!(written.try_iter().count(), 2);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct OutletInbox {
    identity: Arc<Identity>,
}

#[derive(Debug)]
struct Identity {
    /// `None` for the inbox of a single outlet.
    name: Option<Arc<str>>,
    capacity: Inbox,
}

impl OutletInbox {
    /// An inbox with the name shown in a [`Snapshot`](crate::Snapshot) and a [`Graph`](crate::Graph). The
    /// capacity applies to each outlet separately.
    #[must_use]
    pub fn new(name: &str, capacity: Inbox) -> Self {
        Self { identity: Arc::new(Identity { name: Some(name.into()), capacity }) }
    }
}

impl From<Inbox> for OutletInbox {
    fn from(capacity: Inbox) -> Self {
        Self { identity: Arc::new(Identity { name: None, capacity }) }
    }
}

impl From<&OutletInbox> for OutletInbox {
    fn from(inbox: &OutletInbox) -> Self {
        inbox.clone()
    }
}

/// Decides whether the sink of an outlet receives the messages of a cycle, before its thread is woken for
/// them. Made from a closure that takes the number of these messages.
///
/// It is asked in the sync phase, on the thread of the core, so it must answer at once. If it panics, the
/// panic is logged, and the outlet is closed.
///
/// ```
/// use downbeat_executor::{Core, Inbox, ManualClock, MessageType, OutletGate, Time};
/// use std::sync::Arc;
/// use std::sync::atomic::{AtomicBool, AtomicU64, Ordering::Relaxed};
///
/// let mut core = Core::new().with_clock(ManualClock::new(Time::ZERO));
/// let (is_open, taken) = (Arc::<AtomicBool>::default(), Arc::<AtomicU64>::default());
/// let (opens, counts) = (Arc::clone(&is_open), Arc::clone(&taken));
/// let gate = OutletGate::new(move |_messages| opens.load(Relaxed));
/// let count = move |_: downbeat_executor::AnyReceived<'_>| drop(counts.fetch_add(1, Relaxed));
/// core.gated_outlet_of(MessageType::of::<f64>(), "range", Inbox::KeepAll, gate, count)?.keep();
/// let ranges = core.inlet("range")?;
/// ranges.publish(1.25)?;
/// (0..2).try_for_each(|_| core.cycle())?;
/// is_open.store(true, Relaxed);
/// ranges.publish(1.5)?;
/// (0..2).try_for_each(|_| core.cycle())?;
/// assert_eq!(taken.load(Relaxed), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct OutletGate(Box<dyn Fn(u32) -> bool + Send + Sync>);

impl OutletGate {
    /// A gate that opens when `is_wanted` returns true.
    #[must_use]
    pub fn new(is_wanted: impl Fn(u32) -> bool + Send + Sync + 'static) -> Self {
        Self(Box::new(is_wanted))
    }
}

impl std::fmt::Debug for OutletGate {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("OutletGate").finish_non_exhaustive()
    }
}

/// The state of an outlet, shared by the core, the thread and the [`Outlet`].
pub(crate) struct OutletShared {
    topic: Arc<str>,
    gate: Option<OutletGate>,
    /// `None` once the outlet is closed.
    sink: Mutex<Option<Box<dyn AnySink>>>,
    is_closed: AtomicBool,
    /// True if the sink itself closed the outlet.
    closes_itself: AtomicBool,
    has_failed: AtomicBool,
    received: AtomicU64,
    dropped: AtomicU64,
}

thread_local! {
    /// The address of the outlet whose sink runs on this thread; 0 for none.
    static RUNNING: Cell<usize> = const { Cell::new(0) };
}

impl OutletShared {
    fn new(topic: Arc<str>, gate: Option<OutletGate>, sink: Box<dyn AnySink>) -> Self {
        Self {
            topic,
            gate,
            sink: Mutex::new(Some(sink)),
            is_closed: AtomicBool::new(false),
            closes_itself: AtomicBool::new(false),
            has_failed: AtomicBool::new(false),
            received: AtomicU64::new(0),
            dropped: AtomicU64::new(0),
        }
    }

    fn is_closed(&self) -> bool {
        self.is_closed.load(Ordering::Acquire)
    }

    /// Returns whether the sink is to receive this number of messages.
    fn is_wanted(&self, messages: impl FnOnce() -> u32) -> bool {
        let Some(OutletGate(is_wanted)) = &self.gate else { return true };
        let answer = catch_unwind(AssertUnwindSafe(|| is_wanted(messages())));
        answer.unwrap_or_else(|panic| {
            self.has_failed.store(true, Ordering::Relaxed);
            let reason = end_of(panic);
            tracing::error!(
                topic = &*self.topic,
                "the gate of an outlet panicked, which closes it: {reason}"
            );
            // Not `close`, which waits for the sink: this is the thread of the core.
            self.is_closed.store(true, Ordering::Release);
            false
        })
    }

    /// Closes the outlet and drops its sink. A sink that closes its own outlet is dropped when it returns.
    fn close(&self) {
        self.is_closed.store(true, Ordering::Release);
        if RUNNING.get() == self.address() {
            self.closes_itself.store(true, Ordering::Relaxed);
        } else {
            self.drop_sink(self.lock());
        }
    }

    /// Passes a batch to the sink.
    fn take(&self, delivery: Delivery) {
        let mut sink = self.lock();
        let Some(running) = sink.as_mut().filter(|_| !self.is_closed()) else { return };
        let messages = u64::from(delivery.messages);
        let outer = RUNNING.replace(self.address());
        let outcome = catch_unwind(AssertUnwindSafe(|| running.take(delivery, &self.is_closed)));
        RUNNING.set(outer);
        self.received.fetch_add(messages, Ordering::Relaxed);
        if let Err(panic) = outcome {
            self.has_failed.store(true, Ordering::Relaxed);
            let reason = end_of(panic);
            tracing::error!(
                topic = &*self.topic,
                "the sink of an outlet panicked and is not called again: {reason}"
            );
            self.drop_sink(sink);
        } else if self.closes_itself.load(Ordering::Relaxed) {
            self.drop_sink(sink);
        }
    }

    fn drop_sink(&self, mut sink: MutexGuard<'_, Option<Box<dyn AnySink>>>) {
        let taken = sink.take();
        // Unlocked before the drop, because the sink may own its outlet.
        drop(sink);
        drop_guarded("the sink of an outlet", || drop(taken));
    }

    fn lock(&self) -> MutexGuard<'_, Option<Box<dyn AnySink>>> {
        unpoisoned(self.sink.lock())
    }

    fn address(&self) -> usize {
        std::ptr::from_ref(self).addr()
    }
}

/// A batch on its way to a sink.
pub(crate) struct Delivery {
    batch: Arc<dyn AnyBatch>,
    messages: u32,
    /// Messages that the inbox dropped since the previous delivery.
    missed: u32,
}

/// A sink with its message type erased.
pub(crate) trait AnySink: Send {
    /// Takes the messages of a batch until the outlet is closed.
    fn take(&mut self, delivery: Delivery, is_closed: &AtomicBool);
}

struct TypedSink<T, F> {
    take: F,
    message: PhantomData<fn(T)>,
}

impl<T: Send + Sync + 'static, F: FnMut(Received<'_, T>) + Send> AnySink for TypedSink<T, F> {
    fn take(&mut self, delivery: Delivery, is_closed: &AtomicBool) {
        if let Ok(batch) = (delivery.batch as Arc<dyn Any + Send + Sync>).downcast::<Batch<T>>() {
            for_each_message(&batch, delivery.missed, |message| {
                if !is_closed.load(Ordering::Relaxed) {
                    (self.take)(message);
                }
            });
        }
    }
}

/// A sink for messages whose type is known only to the topic.
struct AnyTypeSink<F> {
    take: F,
}

impl<F: FnMut(AnyReceived<'_>) + Send> AnySink for AnyTypeSink<F> {
    fn take(&mut self, delivery: Delivery, is_closed: &AtomicBool) {
        let mut missed = delivery.missed;
        delivery.batch.visit(&mut |message| {
            let missed = std::mem::take(&mut missed);
            if !is_closed.load(Ordering::Relaxed) {
                (self.take)(AnyReceived { missed, ..message });
            }
        });
    }
}

/// An outlet to be opened. The parts that depend on the message type are behind pointers, so that the
/// remaining code is compiled once for all types.
struct NewOutlet {
    topic: String,
    message_type: MessageType,
    inbox: OutletInbox,
    gate: Option<OutletGate>,
    sink: Box<dyn AnySink>,
}

impl NewOutlet {
    fn new<T: Send + Sync + 'static>(
        topic: &str,
        inbox: OutletInbox,
        sink: impl FnMut(Received<'_, T>) + Send + 'static,
    ) -> Self {
        let sink = Box::new(TypedSink { take: sink, message: PhantomData::<fn(T)> });
        Self { topic: topic.to_owned(), message_type: MessageType::of::<T>(), inbox, gate: None, sink }
    }

    fn of(
        message_type: MessageType,
        topic: &str,
        inbox: OutletInbox,
        gate: Option<OutletGate>,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Self {
        let sink = Box::new(AnyTypeSink { take: sink });
        Self { topic: topic.to_owned(), message_type, inbox, gate, sink }
    }

    fn open(self, phase: &mut SyncPhase<'_>) -> Result<Outlet, SetupError> {
        let topic = self.message_type.open(phase.topics(), &self.topic, "outlet")?;
        let has_thread = phase.state.clock.runs_by_itself();
        let has_stopped = phase.state.life == CoreLife::Stopped;
        let core = CoreHandle { link: Arc::clone(&phase.state.link) };
        let Some((outlets, topics)) = outlets_and_topics(phase) else {
            return Err(SetupError::Stopped(format!("outlet of {}", self.topic)));
        };
        topics.add_user(topic);
        let shared = Arc::new(OutletShared::new(Arc::clone(topics.name(topic)), self.gate, self.sink));
        let opened = match has_stopped {
            true => Err(SetupError::Stopped(format!("outlet of {}", shared.topic))),
            false => outlets.open(topics, topic, &self.inbox, &shared, has_thread),
        };
        match opened {
            Ok(()) => Ok(Outlet { shared, core, is_kept: false }),
            Err(error) => {
                topics.release(topic);
                Err(error)
            }
        }
    }
}

fn outlets_and_topics<'a>(phase: &'a mut SyncPhase<'_>) -> Option<(&'a mut Outlets, &'a mut Topics)> {
    let messages = phase.mechanisms.get_mut::<Messages>(MESSAGES)?;
    Some((&mut messages.outlets, &mut phase.stage.views.topics))
}

impl Core {
    /// Subscribes to a topic from outside: calls `sink` with each message, on the thread of the inbox, until
    /// the outlet is dropped.
    ///
    /// # Errors
    /// If the name is invalid, the topic carries another type, or the thread cannot be started.
    pub fn outlet<T: Send + Sync + 'static>(
        &mut self,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        sink: impl FnMut(Received<'_, T>) + Send + 'static,
    ) -> Result<Outlet, SetupError> {
        NewOutlet::new(topic, inbox.into(), sink).open(&mut self.between_cycles())
    }

    /// As [`outlet`](Self::outlet), for a message type given as a value.
    ///
    /// # Errors
    /// As for [`outlet`](Self::outlet).
    pub fn outlet_of(
        &mut self,
        message_type: MessageType,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Result<Outlet, SetupError> {
        NewOutlet::of(message_type, topic, inbox.into(), None, sink).open(&mut self.between_cycles())
    }

    /// As [`outlet_of`](Self::outlet_of), with a gate.
    ///
    /// # Errors
    /// As for [`outlet`](Self::outlet).
    pub fn gated_outlet_of(
        &mut self,
        message_type: MessageType,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        gate: OutletGate,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Result<Outlet, SetupError> {
        NewOutlet::of(message_type, topic, inbox.into(), Some(gate), sink).open(&mut self.between_cycles())
    }
}

impl CoreHandle {
    /// Subscribes to a topic from outside, see [`Core::outlet`](crate::Core::outlet). The first messages are
    /// those of the cycle whose sync phase opens the outlet.
    #[must_use = "the answer is in the receipt"]
    pub fn outlet<T: Send + Sync + 'static>(
        &self,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        sink: impl FnMut(Received<'_, T>) + Send + 'static,
    ) -> Receipt<Result<Outlet, SetupError>> {
        let outlet = NewOutlet::new(topic, inbox.into(), sink);
        self.ask(move |phase| outlet.open(phase))
    }

    /// As [`outlet`](Self::outlet), for a message type given as a value.
    #[must_use = "the answer is in the receipt"]
    pub fn outlet_of(
        &self,
        message_type: MessageType,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Receipt<Result<Outlet, SetupError>> {
        let outlet = NewOutlet::of(message_type, topic, inbox.into(), None, sink);
        self.ask(move |phase| outlet.open(phase))
    }

    /// As [`outlet_of`](Self::outlet_of), with a gate.
    #[must_use = "the answer is in the receipt"]
    pub fn gated_outlet_of(
        &self,
        message_type: MessageType,
        topic: &str,
        inbox: impl Into<OutletInbox>,
        gate: OutletGate,
        sink: impl FnMut(AnyReceived<'_>) + Send + 'static,
    ) -> Receipt<Result<Outlet, SetupError>> {
        let outlet = NewOutlet::of(message_type, topic, inbox.into(), Some(gate), sink);
        self.ask(move |phase| outlet.open(phase))
    }
}
