//! What comes from other threads, waiting for the sync phase.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

use crossbeam::queue::SegQueue;
use crossbeam::sync::Unparker;

use crate::detached::StepOutcome;
use crate::outbox::{AnyOutbox, Outbox};
use crate::{SettingValue, Time};

/// The requests of other threads. The sync phase applies them in the order in which they came.
pub(crate) struct JoinQueue {
    requests: SegQueue<Request>,
    core: Unparker,
    stop: AtomicBool,
}

pub(crate) enum Request {
    Messages { outbox: Box<dyn AnyOutbox>, waiting: Arc<AtomicUsize> },
    Step(StepOutcome),
    Set { module: String, setting: String, value: SettingValue },
}

impl JoinQueue {
    pub(crate) fn new(core: Unparker) -> Self {
        Self { requests: SegQueue::new(), core, stop: AtomicBool::new(false) }
    }

    pub(crate) fn push(&self, request: Request) {
        self.requests.push(request);
        self.core.unpark();
    }

    pub(crate) fn pop(&self) -> Option<Request> {
        self.requests.pop()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.requests.is_empty()
    }

    pub(crate) fn len(&self) -> usize {
        self.requests.len()
    }

    pub(crate) fn stop_is_requested(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    pub(crate) fn request_stop(&self) {
        self.stop.store(true, Ordering::SeqCst);
        self.core.unpark();
    }
}

/// Why an [`Inlet`] did not take a message.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InletError {
    /// The core has not yet taken what was published before.
    #[error("the inlet is full: {0} messages wait for the core")]
    Full(usize),
    /// The core has been asked to stop, or is gone.
    #[error("the core has stopped")]
    Stopped,
}

/// Publishes on a topic from a thread outside the executor; from [`Core::inlet`](crate::Core::inlet).
///
/// A message joins at the next sync phase, behind those that came before it.
pub struct Inlet<T> {
    topic: usize,
    queue: Arc<JoinQueue>,
    waiting: Arc<AtomicUsize>,
    message: std::marker::PhantomData<fn(T)>,
}

impl<T> Clone for Inlet<T> {
    fn clone(&self) -> Self {
        let (queue, waiting) = (Arc::clone(&self.queue), Arc::clone(&self.waiting));
        Self { topic: self.topic, queue, waiting, message: self.message }
    }
}

impl<T: Send + 'static> Inlet<T> {
    /// How many messages may wait for the core.
    pub const CAPACITY: usize = 65_536;

    pub(crate) fn new(topic: usize, queue: Arc<JoinQueue>) -> Self {
        Self { topic, queue, waiting: Arc::default(), message: std::marker::PhantomData }
    }

    /// Hands a message to the core. Never waits.
    ///
    /// # Errors
    /// If too many messages wait already, or the core has stopped; the message is dropped.
    pub fn publish(&self, message: T) -> Result<(), InletError> {
        if self.queue.stop_is_requested() {
            return Err(InletError::Stopped);
        }
        if self.waiting.fetch_add(1, Ordering::Relaxed) >= Self::CAPACITY {
            self.waiting.fetch_sub(1, Ordering::Relaxed);
            return Err(InletError::Full(Self::CAPACITY));
        }
        let outbox = Box::new(Outbox { topic: self.topic, messages: vec![message] });
        self.queue.push(Request::Messages { outbox, waiting: Arc::clone(&self.waiting) });
        Ok(())
    }
}

/// Asks a running core for something from any thread; from [`Core::handle`](crate::Core::handle).
#[derive(Clone)]
pub struct CoreHandle {
    pub(crate) queue: Arc<JoinQueue>,
}

impl CoreHandle {
    /// Asks the core to stop after the current cycle. Safe to call from a signal-handling thread, and more
    /// than once.
    pub fn stop(&self) {
        self.queue.request_stop();
    }

    /// True if the core has been asked to stop.
    #[must_use]
    pub fn stop_is_requested(&self) -> bool {
        self.queue.stop_is_requested()
    }

    /// Changes a setting of a module in the next sync phase. A value that the setting refuses changes
    /// nothing and is logged with module and setting.
    pub fn set(&self, module: &str, setting: &str, value: impl Into<SettingValue>) {
        let (module, setting, value) = (module.to_owned(), setting.to_owned(), value.into());
        self.queue.push(Request::Set { module, setting, value });
    }
}

/// One run of a detached module, as published on [`DetachedStep::TOPIC`] when somebody subscribes to it:
/// what replay needs to run the module again on the same inputs at the same times.
#[derive(Clone, Debug, PartialEq)]
pub struct DetachedStep {
    /// The time the module was given.
    pub time: Time,
    /// The module's name.
    pub module: Arc<str>,
    /// Counts the module's runs from 0.
    pub step: u64,
    /// The cycle in which its messages joined.
    pub cycle: u64,
    /// True for the module's last callback. The first run is its first callback; neither receives messages.
    pub is_stop: bool,
    /// What it was given, by topic; topics without messages are left out.
    pub inputs: Vec<StepInput>,
}

/// What a detached module was given of one topic.
#[derive(Clone, Debug, PartialEq)]
pub struct StepInput {
    /// The topic.
    pub topic: Arc<str>,
    /// Messages that its inbox had dropped before, because there were too many.
    pub skipped: u32,
    /// Messages that its callback received, after the skipped ones.
    pub received: u32,
}

impl DetachedStep {
    /// The topic on which steps are published.
    pub const TOPIC: &'static str = "executor/steps";
}
