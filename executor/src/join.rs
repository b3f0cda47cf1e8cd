//! What comes from other threads, waiting for the sync phase.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering, fence};

use crossbeam::queue::SegQueue;
use crossbeam::sync::Unparker;

use crate::Time;
use crate::core::JobResult;
use crate::detached::StepOutcome;
use crate::guard::drop_guarded;
use crate::listeners::Listeners;
use crate::management::Command;
use crate::service::AnyCall;

/// The requests of other threads. The sync phase applies them in the order in which they came.
pub(crate) struct JoinQueue {
    requests: SegQueue<Request>,
    /// True if an inlet holds messages.
    inlets: AtomicBool,
    /// True if the clock was moved.
    clock: AtomicBool,
    core: Unparker,
    pub(crate) listeners: Listeners,
    stop: AtomicBool,
    closed: AtomicBool,
    ended: AtomicBool,
}

pub(crate) enum Request {
    Command(Command),
    Step(StepOutcome),
    Call(Box<dyn AnyCall>),
    Job(JobResult),
}

impl JoinQueue {
    pub(crate) fn new(core: Unparker) -> Self {
        Self {
            requests: SegQueue::new(),
            inlets: AtomicBool::new(false),
            clock: AtomicBool::new(false),
            core,
            listeners: Listeners::default(),
            stop: AtomicBool::new(false),
            closed: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        }
    }

    pub(crate) fn push(&self, request: Request) {
        self.requests.push(request);
        self.core.unpark();
        // Either this sees that the core has ended, or the core's last look sees the request.
        fence(Ordering::SeqCst);
        if self.ended.load(Ordering::SeqCst) {
            self.drop_all();
        }
    }

    /// The core takes nothing any more. What waits is dropped, and what comes: nobody waits for an answer in vain.
    pub(crate) fn end(&self) {
        self.close();
        self.ended.store(true, Ordering::SeqCst);
        fence(Ordering::SeqCst);
        self.drop_all();
    }

    fn drop_all(&self) {
        while let Some(request) = self.requests.pop() {
            drop_guarded("a request", || drop(request));
        }
    }

    pub(crate) fn pop(&self) -> Option<Request> {
        self.requests.pop()
    }

    pub(crate) fn len(&self) -> usize {
        self.requests.len()
    }

    pub(crate) fn has_no_requests(&self) -> bool {
        self.requests.is_empty()
    }

    /// True if nothing waits.
    pub(crate) fn is_empty(&self) -> bool {
        self.requests.is_empty()
            && !self.inlets.load(Ordering::Acquire)
            && !self.clock.load(Ordering::Acquire)
    }

    /// Has the core look at its clock.
    pub(crate) fn announce_clock(&self) {
        if !self.clock.swap(true, Ordering::AcqRel) {
            self.core.unpark();
        }
    }

    /// True once after the clock was moved; to be called before it is read.
    pub(crate) fn take_clock_announcement(&self) -> bool {
        self.clock.load(Ordering::Relaxed) && self.clock.swap(false, Ordering::AcqRel)
    }

    /// To be called after a message was put into an inlet's queue.
    pub(crate) fn announce_inlet(&self) {
        if !self.inlets.swap(true, Ordering::AcqRel) {
            self.core.unpark();
        }
    }

    /// True once after an inlet announced messages; to be called before these are taken.
    pub(crate) fn take_inlet_announcement(&self) -> bool {
        // The load alone is cheaper, and nearly always enough.
        self.inlets.load(Ordering::Relaxed) && self.inlets.swap(false, Ordering::AcqRel)
    }

    pub(crate) fn stop_is_requested(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    pub(crate) fn request_stop(&self) {
        self.stop.store(true, Ordering::SeqCst);
        self.core.unpark();
    }

    /// From now on nobody takes what is pushed.
    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::SeqCst);
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::SeqCst)
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
