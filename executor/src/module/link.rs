//! Input of the core from other threads: posts to mechanisms, and results of detached modules.

use std::any::Any;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering, fence};

use crossbeam::queue::SegQueue;
use crossbeam::sync::Unparker;

use super::causes::{Asked, Causes};
use super::lifecycle::Listeners;
use crate::observe::{SharedTiming, Span};
use crate::threads::drop_guarded;
use crate::topics::AnyBatch;
use crate::{LifecycleState, ModuleId, Time};

/// The queue from other threads to the core. The sync phase takes posts in the order of arrival.
pub(crate) struct Link {
    posts: SegQueue<Post>,
    /// The mechanisms whose external queues are not empty.
    announced: AtomicU64,
    /// True if the clock was moved since the core last read it.
    clock: AtomicBool,
    core: Unparker,
    pub(crate) timing: Arc<SharedTiming>,
    pub(crate) listeners: Listeners,
    stop: AtomicBool,
    closed: AtomicBool,
    ended: AtomicBool,
}

pub(crate) enum Post {
    /// A change of the state of the mechanism with this number.
    To(usize, PostedChange),
    /// A run of a detached module has ended.
    Step(Box<StepOutcome>),
}

pub(crate) type PostedChange = Box<dyn FnOnce(&mut dyn Any) + Send>;

/// The result of a detached module's run for the next sync phase.
pub(crate) struct StepOutcome {
    pub(crate) module: ModuleId,
    pub(crate) time: Time,
    /// The number of the run.
    pub(crate) number: u64,
    pub(crate) is_stop: bool,
    pub(crate) inputs: Vec<TopicInput>,
    /// The number of requests, answers, results and commands that the run took.
    pub(crate) taken: u32,
    /// The module's requests to mechanisms, by their numbers.
    pub(crate) parts: Vec<(usize, Box<dyn Any + Send>)>,
    /// The measured time; `None` if the module was paused.
    pub(crate) span: Option<Span>,
    /// The causes of the callbacks that the run called.
    pub(crate) causes: Causes,
    /// True if the run began because of a due time.
    pub(crate) was_due: bool,
    /// The number of runs that exceeded the deadline.
    pub(crate) overruns: u64,
    pub(crate) state: LifecycleState,
    pub(crate) panic: Option<String>,
}

/// The number of messages of a topic in the input of a run.
#[derive(Clone, Copy)]
pub(crate) struct TopicInput {
    pub(crate) topic: usize,
    pub(crate) skipped: u32,
    pub(crate) received: u32,
}

/// A batch for a module on another thread, for all its subscriptions of the topic.
pub(crate) struct Delivery {
    pub(crate) topic: usize,
    pub(crate) batch: Arc<dyn AnyBatch>,
    pub(crate) messages: u32,
    /// Messages of the topic that the inbox dropped since the previous delivery.
    pub(crate) missed: u32,
}

impl Link {
    pub(crate) fn new(core: Unparker) -> Self {
        Self {
            posts: SegQueue::new(),
            announced: AtomicU64::new(0),
            clock: AtomicBool::new(false),
            core,
            timing: Arc::new(SharedTiming::new()),
            listeners: Listeners::default(),
            stop: AtomicBool::new(false),
            closed: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        }
    }

    /// Posts a change of the mechanism with type `M` and this number, applied at the start of the next sync
    /// phase.
    pub(crate) fn post<M: 'static>(&self, mechanism: usize, change: impl FnOnce(&mut M) + Send + 'static) {
        let change = move |mechanism: &mut dyn Any| {
            if let Some(mechanism) = mechanism.downcast_mut() {
                change(mechanism);
            }
        };
        self.push(Post::To(mechanism, Box::new(change)));
    }

    pub(crate) fn push(&self, post: Post) {
        self.posts.push(post);
        self.core.unpark();
        // Either this thread sees that the core has ended, or the core's last check sees the post.
        fence(Ordering::SeqCst);
        if self.ended.load(Ordering::SeqCst) {
            self.drop_all();
        }
    }

    /// Drops all posts and all later ones, so that no thread waits for an answer in vain.
    pub(crate) fn end(&self) {
        self.close();
        self.ended.store(true, Ordering::SeqCst);
        fence(Ordering::SeqCst);
        self.drop_all();
    }

    fn drop_all(&self) {
        while let Some(post) = self.posts.pop() {
            drop_guarded("a request", || drop(post));
        }
    }

    pub(crate) fn pop(&self) -> Option<Post> {
        self.posts.pop()
    }

    pub(crate) fn len(&self) -> usize {
        self.posts.len()
    }

    #[inline]
    pub(crate) fn has_posts(&self) -> bool {
        !self.posts.is_empty()
    }

    /// True if the core has no input.
    pub(crate) fn is_empty(&self) -> bool {
        self.posts.is_empty()
            && self.announced.load(Ordering::Acquire) == 0
            && !self.clock.load(Ordering::Acquire)
    }

    /// Makes the core read its clock.
    pub(crate) fn announce_clock(&self) {
        if !self.clock.swap(true, Ordering::AcqRel) {
            self.core.unpark();
        }
    }

    /// True once after the clock was moved; must be called before the clock is read.
    #[inline]
    pub(crate) fn take_clock_announcement(&self) -> bool {
        self.clock.load(Ordering::Relaxed) && self.clock.swap(false, Ordering::AcqRel)
    }

    /// Must be called after a push to a queue that the mechanism with this number empties.
    pub(crate) fn announce(&self, mechanism: usize) {
        let bit = Asked::of(mechanism).bits();
        if self.announced.fetch_or(bit, Ordering::AcqRel) & bit == 0 {
            self.core.unpark();
        }
    }

    /// Takes the set of announced mechanisms; must be called before their queues are emptied.
    #[inline]
    pub(crate) fn take_announcements(&self) -> Asked {
        // A plain load is cheaper, and nearly always sufficient.
        match self.announced.load(Ordering::Relaxed) {
            0 => Asked::default(),
            _ => Asked::from_bits(self.announced.swap(0, Ordering::AcqRel)),
        }
    }

    pub(crate) fn stop_is_requested(&self) -> bool {
        self.stop.load(Ordering::SeqCst)
    }

    pub(crate) fn request_stop(&self) {
        self.stop.store(true, Ordering::SeqCst);
        self.core.unpark();
    }

    /// Refuses new requests from now on.
    pub(crate) fn close(&self) {
        self.closed.store(true, Ordering::SeqCst);
    }

    pub(crate) fn is_closed(&self) -> bool {
        self.closed.load(Ordering::SeqCst)
    }
}
