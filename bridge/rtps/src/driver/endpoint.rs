//! An endpoint's events and the handlers registered for them.

use crate::protocol::{LivelinessChange, Sample};
use crate::qos::Policy;
use crate::wire::Guid;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Receives the samples of one reader, in the order of each writer. It runs on the thread of the participant,
/// which receives nothing in the meantime, so it must return quickly: pass the sample on, or answer
/// immediately.
pub type SampleHandler = Box<dyn FnMut(Sample) + Send>;

/// Receives the events of one endpoint. It runs on the thread of the participant and must return quickly.
pub type EventHandler = Box<dyn Fn(&EndpointEvent) + Send + Sync>;

/// Called when the matched endpoints of one endpoint have changed. It runs on the thread of the participant
/// and must return quickly.
pub type MatchHandler = Box<dyn Fn() + Send + Sync>;

/// An event of an endpoint. `peer` is another endpoint, of this participant or of another one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum EndpointEvent {
    /// The two endpoints discovered each other.
    Matched { peer: Guid },
    /// A matched endpoint was removed, or its participant left.
    Unmatched { peer: Guid },
    /// Topic and type are the same, but a policy prevents a match.
    Incompatible { peer: Guid, policy: Policy },
    /// The two endpoints have the same topic but different types; `type_name` is that of the peer.
    OtherType { peer: Guid, type_name: Arc<str> },
    /// The deadline was missed `count` times: the offered deadline of a writer or the requested deadline of a
    /// reader.
    DeadlineMissed { count: u64 },
    /// This writer was not asserted in time.
    LivelinessLost,
    /// The liveliness of a matched writer changed.
    LivelinessChanged { peer: Guid, change: LivelinessChange },
    /// A matched reader knows no samples of this writer any more: its participant had lost this one and has
    /// found it again.
    BegunAnew { peer: Guid },
    /// `count` samples of a writer will never arrive.
    Lost { peer: Guid, count: u64 },
}

/// State of a local endpoint, shared by its handle and the thread.
pub(super) struct EndpointState {
    pub(super) guid: Guid,
    /// `None` for writers and after the reader was dropped.
    on_sample: Mutex<Option<SampleHandler>>,
    matched: AtomicUsize,
    /// Known reliable readers of a writer that have yet to answer it.
    awaited: AtomicUsize,
    listeners: Mutex<Listeners>,
    /// Locked while event handlers run, so that they run in the order of the events.
    delivery: Mutex<()>,
}

#[derive(Default)]
struct Listeners {
    /// The relation of other endpoints to this one.
    others: BTreeMap<Guid, Standing>,
    on_event: Option<Arc<EventHandler>>,
    on_match: Option<Arc<MatchHandler>>,
}

enum Standing {
    Matched { liveliness: Option<LivelinessChange> },
    Apart(EndpointEvent),
}

impl EndpointState {
    pub(super) fn new(guid: Guid, on_sample: Option<SampleHandler>) -> Self {
        Self {
            guid,
            on_sample: Mutex::new(on_sample),
            matched: AtomicUsize::new(0),
            awaited: AtomicUsize::new(0),
            listeners: Mutex::default(),
            delivery: Mutex::default(),
        }
    }

    pub(super) fn matched(&self) -> usize {
        self.matched.load(Ordering::Acquire)
    }

    /// The endpoints that are matched, and those that will be when they have answered.
    pub(super) fn known(&self) -> usize {
        // In this order, a reader that answers meanwhile counts twice rather than not at all.
        self.awaited.load(Ordering::Acquire) + self.matched()
    }

    pub(super) fn await_readers(&self, count: usize) {
        self.awaited.store(count, Ordering::Release);
    }

    pub(super) fn peers(&self) -> Vec<Guid> {
        let listeners = lock(&self.listeners);
        let is_matched =
            |(peer, standing): (&Guid, &_)| matches!(standing, Standing::Matched { .. }).then_some(*peer);
        listeners.others.iter().filter_map(is_matched).collect()
    }

    /// Replaces the event handler and calls it with the events that describe the current state.
    pub(super) fn on_event(&self, handler: EventHandler) {
        let handler = Arc::new(handler);
        let _delivery = lock(&self.delivery);
        let events: Vec<_> = {
            let mut listeners = lock(&self.listeners);
            listeners.on_event = Some(Arc::clone(&handler));
            listeners.others.iter().flat_map(|(peer, standing)| standing.events(*peer)).collect()
        };
        events.iter().for_each(|event| handler(event));
    }

    pub(super) fn on_match(&self, handler: MatchHandler) {
        lock(&self.listeners).on_match = Some(Arc::new(handler));
    }

    /// Records an event and passes it to the handlers.
    pub(super) fn deliver(&self, event: EndpointEvent) {
        let _delivery = lock(&self.delivery);
        let (on_event, on_match) = {
            let mut listeners = lock(&self.listeners);
            let has_changed = listeners.record(&event);
            if has_changed {
                let is_matched = |standing: &&Standing| matches!(standing, Standing::Matched { .. });
                let count = listeners.others.values().filter(is_matched).count();
                self.matched.store(count, Ordering::Release);
            }
            (listeners.on_event.clone(), listeners.on_match.clone().filter(|_| has_changed))
        };
        if let Some(on_event) = on_event {
            on_event(&event);
        }
        if let Some(on_match) = on_match {
            on_match();
        }
    }

    /// Removes the record of an incompatible endpoint that was removed.
    pub(super) fn forget(&self, peer: Guid) {
        let mut listeners = lock(&self.listeners);
        if matches!(listeners.others.get(&peer), Some(Standing::Apart(_))) {
            listeners.others.remove(&peer);
        }
    }

    /// Passes a sample to the reader.
    pub(super) fn give(&self, sample: Sample) {
        if let Some(on_sample) = lock(&self.on_sample).as_mut() {
            on_sample(sample);
        }
    }

    /// Removes the handlers. When this returns, none of them is running, except a handler that called it.
    pub(super) fn close(&self, is_inside_a_handler: bool) {
        let on_sample = if is_inside_a_handler {
            // A handler that removes its own reader is still running; it is dropped with the endpoint.
            self.on_sample.try_lock().ok().and_then(|mut on_sample| on_sample.take())
        } else {
            lock(&self.on_sample).take()
        };
        let listeners = std::mem::take(&mut *lock(&self.listeners));
        if !is_inside_a_handler {
            drop(lock(&self.delivery));
        }
        // Dropped without a lock, because they may own handles.
        drop((on_sample, listeners));
    }
}

impl Listeners {
    /// Stores the new state. Returns whether the matches changed.
    fn record(&mut self, event: &EndpointEvent) -> bool {
        match *event {
            EndpointEvent::Matched { peer } => {
                let before = self.others.insert(peer, Standing::Matched { liveliness: None });
                !matches!(before, Some(Standing::Matched { .. }))
            }
            EndpointEvent::Unmatched { peer } => {
                matches!(self.others.remove(&peer), Some(Standing::Matched { .. }))
            }
            EndpointEvent::Incompatible { peer, .. } | EndpointEvent::OtherType { peer, .. } => {
                let before = self.others.insert(peer, Standing::Apart(event.clone()));
                matches!(before, Some(Standing::Matched { .. }))
            }
            EndpointEvent::LivelinessChanged { peer, change } => {
                if let Some(Standing::Matched { liveliness }) = self.others.get_mut(&peer) {
                    *liveliness = Some(change);
                }
                false
            }
            EndpointEvent::DeadlineMissed { .. }
            | EndpointEvent::LivelinessLost
            | EndpointEvent::BegunAnew { .. }
            | EndpointEvent::Lost { .. } => false,
        }
    }
}

impl Standing {
    /// The events that describe the current state, for a newly registered handler.
    fn events(&self, peer: Guid) -> impl Iterator<Item = EndpointEvent> + use<> {
        let (first, liveliness) = match self {
            Self::Matched { liveliness } => (EndpointEvent::Matched { peer }, *liveliness),
            Self::Apart(event) => (event.clone(), None),
        };
        // A new handler receives a revived writer as alive.
        let change = liveliness.map(|change| match change {
            LivelinessChange::Revived => LivelinessChange::Alive,
            change => change,
        });
        let change = change.map(|change| EndpointEvent::LivelinessChanged { peer, change });
        std::iter::once(first).chain(change)
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
