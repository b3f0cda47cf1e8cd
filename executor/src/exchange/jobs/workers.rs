//! The threads that run jobs.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::task::Poll;

use async_executor::Executor;
use crossbeam::channel::{Receiver, Sender, unbounded};
use futures_lite::{FutureExt, future};

use super::Work;
use crate::threads::end_of;
use crate::{ThreadError, ThreadOptions};

/// The largest number of threads for blocking work.
const MOST_THREADS: usize = 4;

/// Threads for blocking work and one for async work, started with the first job.
///
/// The threads are not joined at the end, since a job may block for ever. After the workers are dropped, each
/// thread ends with its current job.
pub(super) struct Workers {
    threads: usize,
    work: Sender<Box<dyn FnOnce() + Send>>,
    waiting: Receiver<Box<dyn FnOnce() + Send>>,
    tasks: Option<AsyncThread>,
}

/// The thread of async work; it ends when this is dropped.
struct AsyncThread {
    executor: Arc<Executor<'static>>,
    is_over: Arc<AtomicBool>,
}

impl AsyncThread {
    fn start() -> Result<Self, ThreadError> {
        let (executor, is_over) = (Arc::new(Executor::new()), Arc::new(AtomicBool::new(false)));
        let (runs, ends) = (Arc::clone(&executor), Arc::clone(&is_over));
        ThreadOptions::default().spawn("job-async", move || {
            let over = future::poll_fn(|_| match ends.load(Ordering::SeqCst) {
                true => Poll::Ready(()),
                false => Poll::Pending,
            });
            future::block_on(runs.run(over));
        })?;
        Ok(Self { executor, is_over })
    }
}

impl Drop for AsyncThread {
    fn drop(&mut self) {
        self.is_over.store(true, Ordering::SeqCst);
        // Wakes the thread, which then reads the flag.
        self.executor.spawn(async {}).detach();
    }
}

impl Default for Workers {
    fn default() -> Self {
        let (work, waiting) = unbounded();
        Self { threads: 0, work, waiting, tasks: None }
    }
}

impl Workers {
    /// Starts the work on another thread. If the system refuses a thread, the work is dropped, and the
    /// waiting module receives an error.
    pub(super) fn start(&mut self, work: Work) {
        let started = match work {
            Work::Blocking(work) => self.start_blocking(work),
            Work::Async(task) => self.executor().map(|executor| executor.spawn(unpanicking(task)).detach()),
        };
        if let Err(error) = started {
            tracing::error!("a job is dropped: {error}");
        }
    }

    /// Runs the work on this thread, to its end.
    pub(super) fn run(work: Work) {
        match work {
            Work::Blocking(work) => guarded(work),
            Work::Async(task) => future::block_on(unpanicking(task)),
        }
    }

    fn start_blocking(&mut self, work: Box<dyn FnOnce() + Send>) -> Result<(), ThreadError> {
        if self.threads < MOST_THREADS {
            let waiting = self.waiting.clone();
            let name = format!("job-{}", self.threads);
            ThreadOptions::default().spawn(name, move || waiting.iter().for_each(guarded))?;
            self.threads += 1;
        }
        // Cannot fail: the receiver lives as long as `self`.
        let _ = self.work.send(work);
        Ok(())
    }

    fn executor(&mut self) -> Result<&Executor<'static>, ThreadError> {
        let thread = match &mut self.tasks {
            Some(thread) => thread,
            none => none.insert(AsyncThread::start()?),
        };
        Ok(&thread.executor)
    }
}

fn guarded(work: impl FnOnce()) {
    if let Err(panic) = catch_unwind(AssertUnwindSafe(work)) {
        tracing::error!("a job panicked: {}", end_of(panic));
    }
}

/// Keeps a panic in one task from ending the thread of all tasks.
async fn unpanicking(task: impl Future<Output = ()>) {
    if let Err(panic) = AssertUnwindSafe(task).catch_unwind().await {
        tracing::error!("a job panicked: {}", end_of(panic));
    }
}
