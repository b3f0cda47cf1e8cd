//! The thread that answers requests for parameters.

use super::store::Parameters;
use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, bounded};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::thread::JoinHandle;
use std::time::Duration;

/// Requests that wait; what is above it is not answered.
const QUEUE: usize = 256;

/// How often values are looked at that somebody else may have changed.
const LOOK: Duration = Duration::from_secs(1);

pub(super) type Job = Box<dyn FnOnce(&mut Parameters) + Send>;

/// Hands requests to the thread.
#[derive(Clone)]
pub(super) struct Jobs(Sender<Option<Job>>);

impl Jobs {
    /// False if the queue is full.
    pub(super) fn push(&self, job: Job) -> bool {
        self.0.try_send(Some(job)).is_ok()
    }
}

/// A running thread; dropping it stops and joins it.
pub(super) struct ParameterThread {
    jobs: Jobs,
    thread: Option<JoinHandle<()>>,
}

impl ParameterThread {
    pub(super) fn start(parameters: Parameters) -> io::Result<Self> {
        let (sender, jobs) = bounded(QUEUE);
        let thread = std::thread::Builder::new()
            .name("downbeat-params".to_owned())
            .spawn(move || run(parameters, &jobs))?;
        Ok(Self { jobs: Jobs(sender), thread: Some(thread) })
    }

    pub(super) fn jobs(&self) -> Jobs {
        self.jobs.clone()
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

fn run(mut parameters: Parameters, jobs: &Receiver<Option<Job>>) {
    parameters.announce();
    loop {
        let work: Job = match jobs.recv_timeout(LOOK) {
            Ok(Some(job)) => job,
            Err(RecvTimeoutError::Timeout) => Box::new(Parameters::look_for_listeners),
            Ok(None) | Err(RecvTimeoutError::Disconnected) => return,
        };
        if catch_unwind(AssertUnwindSafe(|| work(&mut parameters))).is_err() {
            tracing::error!("answering a request for parameters panicked: it stays without an answer");
        }
    }
}
