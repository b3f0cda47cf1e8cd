//! The thread on which handlers of requests and replies run, and which keeps their time limits.

use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, unbounded};
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Weak;
use std::thread::{JoinHandle, ThreadId};
use std::time::{Duration, Instant};

/// Where nothing is due the thread looks again after this long.
const IDLE: Duration = Duration::from_secs(3600);

/// Runs the handlers of servers and clients, one after the other. Dropping it stops and joins the thread: what has not
/// run by then does not run any more.
pub struct RpcThread {
    link: RpcLink,
    thread: Option<JoinHandle<()>>,
}

impl RpcThread {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system has no thread left.
    pub fn start() -> io::Result<Self> {
        Self::start_named("downbeat-rpc")
    }

    /// The same for other time limits, under another name.
    pub(crate) fn start_named(name: &str) -> io::Result<Self> {
        // Unbounded as such; what comes in is bounded by what servers and clients may have in flight.
        let (sender, jobs) = unbounded();
        let thread =
            std::thread::Builder::new().name(name.to_owned()).spawn(move || Worker::new(jobs).run())?;
        let link = RpcLink { jobs: sender, thread: thread.thread().id() };
        Ok(Self { link, thread: Some(thread) })
    }

    pub(crate) fn link(&self) -> RpcLink {
        self.link.clone()
    }
}

impl Drop for RpcThread {
    fn drop(&mut self) {
        self.link.send(Job::Stop);
        if let Some(thread) = self.thread.take()
            && !self.link.is_current()
        {
            // Panics of handlers are caught; there is nothing to tell about a join that fails.
            let _ = thread.join();
        }
    }
}

/// Hands jobs to the thread; keeps it not alive.
#[derive(Clone)]
pub(crate) struct RpcLink {
    jobs: Sender<Job>,
    thread: ThreadId,
}

impl RpcLink {
    /// Runs `job` on the thread, after those before it.
    pub(super) fn run(&self, job: impl FnOnce() + Send + 'static) {
        self.send(Job::Run(Box::new(job)));
    }

    /// Keeps the time limits of `limited` until it is gone.
    pub(crate) fn watch(&self, limited: Weak<dyn TimeLimited>) {
        self.send(Job::Watch(limited));
    }

    /// Has the thread ask again what is due next.
    pub(crate) fn look_again(&self) {
        self.send(Job::LookAgain);
    }

    /// Whether this is the thread itself, which must not wait for what it is to do.
    pub(super) fn is_current(&self) -> bool {
        std::thread::current().id() == self.thread
    }

    fn send(&self, job: Job) {
        // Fails only when the thread has stopped, and with it everything that could want the job.
        let _ = self.jobs.send(job);
    }
}

/// Something with time limits.
pub(crate) trait TimeLimited: Send + Sync {
    /// When the first of them is due.
    fn due(&self) -> Option<Instant>;
    /// Ends what is due by `now`.
    fn expire(&self, now: Instant);
}

enum Job {
    Run(Box<dyn FnOnce() + Send>),
    Watch(Weak<dyn TimeLimited>),
    LookAgain,
    Stop,
}

struct Worker {
    jobs: Receiver<Job>,
    limited: Vec<Weak<dyn TimeLimited>>,
}

impl Worker {
    fn new(jobs: Receiver<Job>) -> Self {
        Self { jobs, limited: Vec::new() }
    }

    fn run(mut self) {
        let mut due = None;
        loop {
            let deadline = due.unwrap_or_else(|| Instant::now() + IDLE);
            match self.jobs.recv_deadline(deadline) {
                Ok(Job::Run(job)) => guarded(job),
                Ok(Job::Watch(limited)) => self.limited.push(limited),
                Ok(Job::LookAgain) | Err(RecvTimeoutError::Timeout) => due = self.expire(),
                Ok(Job::Stop) | Err(RecvTimeoutError::Disconnected) => return,
            }
            // A flood of jobs must not hold up what is due.
            if due.is_some_and(|due| due <= Instant::now()) {
                due = self.expire();
            }
        }
    }

    /// Ends what is due; returns when the next is.
    fn expire(&mut self) -> Option<Instant> {
        let now = Instant::now();
        let mut next = None;
        self.limited.retain(|limited| {
            let Some(limited) = limited.upgrade() else { return false };
            guarded(|| limited.expire(now));
            next = [next, limited.due()].into_iter().flatten().min();
            true
        });
        next
    }
}

fn guarded(job: impl FnOnce()) {
    if catch_unwind(AssertUnwindSafe(job)).is_err() {
        tracing::error!(
            "a handler of requests or replies panicked: what it was to answer stays without an answer"
        );
    }
}
