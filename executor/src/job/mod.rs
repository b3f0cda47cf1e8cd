//! Work beside the cycle: what blocks or waits runs elsewhere, and its result joins at a sync phase.

mod sync;
mod workers;

use std::any::Any;
use std::future::Future;
use std::marker::PhantomData;
use std::pin::Pin;
use std::sync::Arc;

pub(crate) use sync::{HeldResults, Jobs};
pub(crate) use workers::Workers;

use crate::ModuleId;
use crate::core::JobResult;
use crate::join::{JoinQueue, Request};

/// A module's key to a callback for results of work beside the cycle, from
/// [`Setup::job`](crate::Setup::job).
pub struct Job<T> {
    pub(crate) port: u32,
    result: PhantomData<fn(T)>,
}

impl<T> Job<T> {
    pub(crate) fn new(port: u32) -> Self {
        Self { port, result: PhantomData }
    }
}

impl<T> Clone for Job<T> {
    fn clone(&self) -> Self {
        *self
    }
}

impl<T> Copy for Job<T> {}

/// Why a job has no result.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JobError {
    /// It panicked, or its [`Completion`] was dropped.
    #[error("the job ended without a result: it panicked or was dropped")]
    Lost,
}

/// Brings the result of a job back to its module, from any thread or async task; from
/// [`Context::completion`](crate::Context::completion).
///
/// One that is dropped brings [`JobError::Lost`], so that a module never waits for what cannot come.
#[must_use = "a completion that is dropped ends the job without a result"]
pub struct Completion<T: Send + 'static> {
    queue: Option<Arc<JoinQueue>>,
    module: ModuleId,
    port: u32,
    number: u64,
    result: PhantomData<fn(T)>,
}

impl<T: Send + 'static> Completion<T> {
    pub(crate) fn new(queue: Arc<JoinQueue>, module: ModuleId, job: Job<T>, number: u64) -> Self {
        Self { queue: Some(queue), module, port: job.port, number, result: PhantomData }
    }

    /// Hands over the result. It joins at the next sync phase.
    pub fn finish(mut self, result: T) {
        self.send(Ok(result));
    }

    fn send(&mut self, result: Result<T, JobError>) {
        if let Some(queue) = self.queue.take() {
            let Self { module, port, number, .. } = *self;
            queue.push(Request::Job(JobResult { module, port, number, result: Box::new(Some(result)) }));
        }
    }
}

impl<T: Send + 'static> Drop for Completion<T> {
    fn drop(&mut self) {
        self.send(Err(JobError::Lost));
    }
}

/// Work that a module asked for and that the sync phase starts.
pub(crate) enum Work {
    /// May block its thread.
    Blocking(Box<dyn FnOnce() + Send>),
    /// Never blocks its thread.
    Async(Pin<Box<dyn Future<Output = ()> + Send>>),
}

/// The results of one kind of job that the module has not seen yet.
pub(crate) struct JobPort<T> {
    results: Vec<Result<T, JobError>>,
    next: u64,
}

impl<T> JobPort<T> {
    pub(crate) fn new() -> Self {
        Self { results: Vec::new(), next: 0 }
    }

    pub(crate) fn take(&mut self) -> Vec<Result<T, JobError>> {
        std::mem::take(&mut self.results)
    }
}

/// A [`JobPort`] whose type only its module knows.
pub(crate) trait AnyJob: Any + Send {
    fn has_results(&self) -> bool;
    /// The number of the next result that the module asks for.
    fn next_number(&mut self) -> u64;
    /// Takes an `Option<Result<T, JobError>>`.
    fn accept(&mut self, result: Box<dyn Any + Send>);
}

impl<T: Send + 'static> AnyJob for JobPort<T> {
    fn has_results(&self) -> bool {
        !self.results.is_empty()
    }

    fn next_number(&mut self) -> u64 {
        let number = self.next;
        self.next += 1;
        number
    }

    fn accept(&mut self, result: Box<dyn Any + Send>) {
        if let Ok(result) = result.downcast::<Option<Result<T, JobError>>>() {
            self.results.extend(*result);
        }
    }
}
