//! Requests of ROS 2 that a core has and has not answered yet.
//!
//! Their time limits are those of the system's steady clock: the time of a core may stand still or pass
//! slowly, and with it the limits that the core keeps, while clients of ROS 2 wait.

use crate::middleware::rpc::Responder;
use crate::worker::{TimeLimited, WorkerLink};
use parking_lot::Mutex;
use std::collections::BTreeMap;
use std::sync::{Arc, Weak};
use std::time::{Duration, Instant};

/// The open requests of one service, which all have the same time limit.
pub(super) struct OpenRequests {
    timeout: Duration,
    worker: WorkerLink,
    state: Mutex<State>,
    /// Answers a request that is due.
    refuse: Box<dyn Fn(Responder) + Send + Sync>,
}

#[derive(Default)]
struct State {
    next: u64,
    /// In order of arrival, and so of their time limits. `None` for a time limit beyond all time.
    open: BTreeMap<u64, (Option<Instant>, Responder)>,
}

impl OpenRequests {
    pub(super) fn watched(
        worker: WorkerLink,
        timeout: Duration,
        refuse: impl Fn(Responder) + Send + Sync + 'static,
    ) -> Arc<Self> {
        let refuse = Box::new(refuse);
        let requests = Arc::new(Self { timeout, worker, state: Mutex::default(), refuse });
        let limited: Weak<dyn TimeLimited> = Arc::<Self>::downgrade(&requests) as _;
        requests.worker.watch(limited);
        requests
    }

    /// Keeps a request until it is taken or due.
    pub(super) fn keep(self: &Arc<Self>, responder: Responder) -> OpenRequest {
        let mut state = self.state.lock();
        let is_first = state.open.is_empty();
        let number = state.next;
        state.next += 1;
        state.open.insert(number, (Instant::now().checked_add(self.timeout), responder));
        drop(state);
        if is_first {
            self.worker.look_again();
        }
        OpenRequest { requests: Arc::clone(self), number }
    }
}

/// A request, which is refused if this is dropped.
pub(super) struct OpenRequest {
    requests: Arc<OpenRequests>,
    number: u64,
}

impl OpenRequest {
    /// Takes the request to answer it; `None` if it was due before.
    pub(super) fn take(&self) -> Option<Responder> {
        self.requests.state.lock().open.remove(&self.number).map(|(_, responder)| responder)
    }
}

impl Drop for OpenRequest {
    fn drop(&mut self) {
        drop(self.take());
    }
}

impl TimeLimited for OpenRequests {
    fn due(&self) -> Option<Instant> {
        self.state.lock().open.first_key_value().and_then(|(_, (due, _))| *due)
    }

    fn expire(&self, now: Instant) {
        loop {
            let mut state = self.state.lock();
            let first = state.open.first_entry().filter(|first| first.get().0.is_some_and(|due| due <= now));
            let Some((_, responder)) = first.map(|first| first.remove()) else { return };
            drop(state);
            (self.refuse)(responder);
        }
    }
}
