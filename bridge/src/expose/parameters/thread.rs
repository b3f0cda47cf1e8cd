//! The thread that answers requests for parameters.

use super::store::Parameters;
use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, Weak};
use std::thread::JoinHandle;
use std::time::Duration;

/// Requests that wait; what is above it is not answered.
const QUEUE: usize = 256;

/// How often values are looked at that somebody else may have changed.
const LOOK: Duration = Duration::from_secs(1);

pub(super) type Job = Box<dyn FnOnce() + Send>;

/// Hands requests to the thread.
#[derive(Clone)]
pub(super) struct Jobs(Sender<Option<Job>>);

impl Jobs {
    /// False if the queue is full.
    pub(super) fn push(&self, job: Job) -> bool {
        self.0.try_send(Some(job)).is_ok()
    }
}

type Watched = Arc<Mutex<Vec<Weak<Mutex<Parameters>>>>>;

/// A running thread; dropping it stops and joins it.
pub(super) struct ParameterThread {
    jobs: Jobs,
    watched: Watched,
    thread: Option<JoinHandle<()>>,
}

impl ParameterThread {
    pub(super) fn start() -> io::Result<Self> {
        let (sender, jobs) = bounded(QUEUE);
        let watched = Watched::default();
        let looked_at = Arc::clone(&watched);
        let thread = std::thread::Builder::new()
            .name("downbeat-params".to_owned())
            .spawn(move || run(&looked_at, &jobs))?;
        Ok(Self { jobs: Jobs(sender), watched, thread: Some(thread) })
    }

    pub(super) fn jobs(&self) -> Jobs {
        self.jobs.clone()
    }

    /// Tells listeners of the parameters there are, and from now on of their changes.
    pub(super) fn watch(&self, parameters: &Arc<Mutex<Parameters>>) {
        let mut watched = lock(&self.watched);
        watched.retain(|parameters| parameters.strong_count() > 0);
        watched.push(Arc::downgrade(parameters));
        drop(watched);
        let parameters = Arc::downgrade(parameters);
        let announce = move || {
            if let Some(parameters) = parameters.upgrade() {
                lock(&parameters).announce();
            }
        };
        if !self.jobs.push(Box::new(announce)) {
            tracing::debug!("the parameters of a new node are not told: too many requests wait");
        }
    }
}

impl Drop for ParameterThread {
    fn drop(&mut self) {
        // Fails only when the thread has ended.
        let _ = self.jobs.0.send(None);
        if let Some(thread) = self.thread.take() {
            // Panics of jobs are caught; there is nothing to tell about a join that fails.
            let _ = thread.join();
        }
    }
}

pub(super) fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn run(watched: &Watched, jobs: &Receiver<Option<Job>>) {
    loop {
        let work: Job = match jobs.recv_timeout(LOOK) {
            Ok(Some(job)) => job,
            Err(RecvTimeoutError::Timeout) => {
                let watched = Arc::clone(watched);
                Box::new(move || look(&watched))
            }
            Ok(None) | Err(RecvTimeoutError::Disconnected) => return,
        };
        if catch_unwind(AssertUnwindSafe(work)).is_err() {
            tracing::error!("answering a request for parameters panicked: it stays without an answer");
        }
    }
}

fn look(watched: &Watched) {
    let watched: Vec<_> = lock(watched).iter().filter_map(Weak::upgrade).collect();
    watched.iter().for_each(|parameters| lock(parameters).look_for_listeners());
}
