//! The thread of a participant for all work beside the engine: handlers of requests and replies, time limits,
//! parameters, lifecycles, the watch of the network.
//!
//! Nothing on it blocks: what has to wait is a future, which the worker polls when it is woken.

use crossbeam::channel::{Receiver, RecvTimeoutError, Sender, unbounded};
use parking_lot::Mutex;
use std::collections::{BTreeMap, VecDeque};
use std::future::poll_fn;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::{Pin, pin};
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Weak};
use std::task::{Context, Poll, Wake, Waker};
use std::thread::{JoinHandle, ThreadId};
use std::time::{Duration, Instant};

/// The longest wait for the next job while nothing is due.
const IDLE: Duration = Duration::from_secs(3600);

/// A running thread. Dropping it stops and joins the thread; jobs and tasks that have not run by then are
/// dropped.
pub struct Worker {
    link: WorkerLink,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    /// Starts the thread.
    ///
    /// # Errors
    /// When the system refuses the thread.
    pub fn start() -> io::Result<Self> {
        // Unbounded: the queues of servers, clients and parameters are bounded.
        let (sender, jobs) = unbounded();
        let timers = Arc::<Timers>::default();
        let run =
            Run { jobs, limited: vec![Arc::<Timers>::downgrade(&timers) as _], timers: Arc::clone(&timers) };
        let thread = std::thread::Builder::new().name("downbeat-worker".into()).spawn(move || run.run())?;
        let link = WorkerLink { jobs: sender, timers, thread: thread.thread().id() };
        Ok(Self { link, thread: Some(thread) })
    }

    pub(crate) fn link(&self) -> WorkerLink {
        self.link.clone()
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.link.send(Job::Stop);
        if let Some(thread) = self.thread.take()
            && !self.link.is_current()
        {
            // Panics of jobs are caught, so joining does not fail.
            let _ = thread.join();
        }
    }
}

/// Hands work to a [`Worker`] without keeping it alive.
#[derive(Clone)]
pub(crate) struct WorkerLink {
    jobs: Sender<Job>,
    timers: Arc<Timers>,
    thread: ThreadId,
}

impl WorkerLink {
    /// Runs `job` after all earlier jobs. It must not block.
    pub(crate) fn run(&self, job: impl FnOnce() + Send + 'static) {
        self.send(Job::Run(Box::new(job)));
    }

    /// Runs a future to its end. It must not keep the worker's participant alive while it waits.
    pub(crate) fn spawn(&self, future: impl Future<Output = ()> + Send + 'static) {
        let task = Task { future: Mutex::new(Some(Box::pin(future))), jobs: self.jobs.clone() };
        self.send(Job::Poll(Arc::new(task)));
    }

    /// Enforces the time limits of `limited` until it is dropped.
    pub(crate) fn watch(&self, limited: Weak<dyn TimeLimited>) {
        self.send(Job::Watch(limited));
    }

    /// Makes the worker ask again which time limit is next.
    pub(crate) fn look_again(&self) {
        self.send(Job::LookAgain);
    }

    /// Whether this is the worker's own thread, which must not wait for it.
    pub(crate) fn is_current(&self) -> bool {
        std::thread::current().id() == self.thread
    }

    /// Waits until all earlier jobs have run, unless this is the worker's own thread.
    pub(crate) fn flush(&self) {
        if !self.is_current() {
            let (sender, done) = crossbeam::channel::bounded::<()>(1);
            self.run(move || drop(sender));
            // Ends when the job has run or was dropped with the worker.
            let _ = done.recv();
        }
    }

    /// Waits until all earlier jobs have run.
    pub(crate) async fn catch_up(&self) {
        let (sender, done) = oneshot();
        self.run(move || sender.send(()));
        done.await;
    }

    /// Waits for a time. For tasks of this worker.
    pub(crate) async fn sleep(&self, time: Duration) {
        let due = Instant::now() + time;
        let mut timer = None;
        poll_fn(|cx| {
            if Instant::now() >= due {
                return Poll::Ready(());
            }
            if timer.is_none() {
                timer = Some(self.timers.add(due, cx.waker().clone()));
                self.look_again();
            }
            Poll::Pending
        })
        .await;
    }

    /// Returns the output of a future, or `None` if it takes longer than `time`. For tasks of this worker.
    pub(crate) async fn within<T>(&self, time: Duration, future: impl Future<Output = T>) -> Option<T> {
        let (mut future, mut sleep) = (pin!(future), pin!(self.sleep(time)));
        poll_fn(|cx| match future.as_mut().poll(cx) {
            Poll::Ready(output) => Poll::Ready(Some(output)),
            Poll::Pending => sleep.as_mut().poll(cx).map(|()| None),
        })
        .await
    }

    fn send(&self, job: Job) {
        // Fails only after the worker has stopped.
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
    Poll(Arc<Task>),
    Watch(Weak<dyn TimeLimited>),
    LookAgain,
    Stop,
}

struct Task {
    /// `None` after its end.
    future: Mutex<Option<Pin<Box<dyn Future<Output = ()> + Send>>>>,
    jobs: Sender<Job>,
}

impl Wake for Task {
    fn wake(self: Arc<Self>) {
        let jobs = self.jobs.clone();
        // Fails only after the worker has stopped.
        let _ = jobs.send(Job::Poll(self));
    }
}

impl Task {
    fn poll(self: &Arc<Self>) {
        let waker = Waker::from(Arc::clone(self));
        let mut future = self.future.lock();
        let Some(running) = &mut *future else { return };
        let poll = guarded(|| running.as_mut().poll(&mut Context::from_waker(&waker)));
        if !matches!(poll, Some(Poll::Pending)) {
            *future = None;
        }
    }
}

/// When to wake tasks that sleep.
#[derive(Default)]
struct Timers {
    wakers: Mutex<BTreeMap<(Instant, u64), Waker>>,
    next: AtomicU64,
}

/// Removes its waker when it is dropped.
struct Timer<'a> {
    timers: &'a Timers,
    key: (Instant, u64),
}

impl Timers {
    fn add(&self, due: Instant, waker: Waker) -> Timer<'_> {
        let key = (due, self.next.fetch_add(1, Ordering::Relaxed));
        self.wakers.lock().insert(key, waker);
        Timer { timers: self, key }
    }
}

impl Drop for Timer<'_> {
    fn drop(&mut self) {
        let removed = self.timers.wakers.lock().remove(&self.key);
        // Without the lock: a waker may hold the last handle of a task.
        drop(removed);
    }
}

impl TimeLimited for Timers {
    fn due(&self) -> Option<Instant> {
        self.wakers.lock().first_key_value().map(|(&(due, _), _)| due)
    }

    fn expire(&self, now: Instant) {
        let due = {
            let mut wakers = self.wakers.lock();
            let later = wakers.split_off(&(now, u64::MAX));
            std::mem::replace(&mut *wakers, later)
        };
        due.into_values().for_each(Waker::wake);
    }
}

struct Run {
    jobs: Receiver<Job>,
    limited: Vec<Weak<dyn TimeLimited>>,
    timers: Arc<Timers>,
}

impl Run {
    fn run(mut self) {
        let mut due = None;
        loop {
            let deadline = due.unwrap_or_else(|| Instant::now() + IDLE);
            match self.jobs.recv_deadline(deadline) {
                Ok(Job::Run(job)) => drop(guarded(job)),
                Ok(Job::Poll(task)) => task.poll(),
                Ok(Job::Watch(limited)) => self.limited.push(limited),
                Ok(Job::LookAgain) | Err(RecvTimeoutError::Timeout) => due = self.expire(),
                Ok(Job::Stop) | Err(RecvTimeoutError::Disconnected) => break,
            }
            // A flood of jobs must not hold up what is due.
            if due.is_some_and(|due| due <= Instant::now()) {
                due = self.expire();
            }
        }
        // Dropped without the lock, which the timers of their tasks take.
        let sleeping = std::mem::take(&mut *self.timers.wakers.lock());
        drop(sleeping);
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

fn guarded<T>(job: impl FnOnce() -> T) -> Option<T> {
    let result = catch_unwind(AssertUnwindSafe(job));
    if result.is_err() {
        tracing::error!("a handler of ROS 2 panicked: its request stays without an answer");
    }
    result.ok()
}

/// A value that one side sends once and the other side waits for.
pub(crate) fn oneshot<T>() -> (OneshotSender<T>, impl Future<Output = Option<T>>) {
    let queue = Mailbox::new(1);
    let receiver = queue.clone();
    (OneshotSender(queue), async move { receiver.next().await })
}

/// Dropping it ends the wait with `None`.
pub(crate) struct OneshotSender<T>(Mailbox<T>);

impl<T> OneshotSender<T> {
    pub(crate) fn send(self, value: T) {
        // Has room for the one value.
        let _ = self.0.push(value);
    }
}

impl<T> Drop for OneshotSender<T> {
    fn drop(&mut self) {
        self.0.close();
    }
}

/// A bounded queue that one task reads.
pub(crate) struct Mailbox<T>(Arc<Mutex<Mail<T>>>);

struct Mail<T> {
    waiting: VecDeque<T>,
    capacity: usize,
    is_closed: bool,
    reader: Option<Waker>,
}

impl<T> Mailbox<T> {
    pub(crate) fn new(capacity: usize) -> Self {
        let mail = Mail { waiting: VecDeque::new(), capacity, is_closed: false, reader: None };
        Self(Arc::new(Mutex::new(mail)))
    }

    /// # Errors
    /// Returns the value if the queue is full or closed.
    pub(crate) fn push(&self, value: T) -> Result<(), T> {
        let mut mail = self.0.lock();
        if mail.is_closed || mail.waiting.len() >= mail.capacity {
            return Err(value);
        }
        mail.waiting.push_back(value);
        let reader = mail.reader.take();
        drop(mail);
        reader.into_iter().for_each(Waker::wake);
        Ok(())
    }

    /// The reader takes the values that wait, then `None`.
    pub(crate) fn close(&self) {
        let mut mail = self.0.lock();
        mail.is_closed = true;
        let reader = mail.reader.take();
        drop(mail);
        reader.into_iter().for_each(Waker::wake);
    }

    /// The next value; `None` when the queue is closed and empty.
    pub(crate) async fn next(&self) -> Option<T> {
        poll_fn(|cx| {
            let mut mail = self.0.lock();
            match mail.waiting.pop_front() {
                Some(value) => Poll::Ready(Some(value)),
                None if mail.is_closed => Poll::Ready(None),
                None => {
                    mail.reader = Some(cx.waker().clone());
                    Poll::Pending
                }
            }
        })
        .await
    }
}

impl<T> Clone for Mailbox<T> {
    fn clone(&self) -> Self {
        Self(Arc::clone(&self.0))
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]
    use super::*;
    use crossbeam::channel::unbounded;

    const WATCHDOG: Duration = Duration::from_secs(20);

    #[test]
    fn a_task_waits_without_holding_up_jobs() {
        let worker = Worker::start().unwrap();
        let (lines, log) = unbounded();
        let (sender, value) = oneshot();
        let (link, line) = (worker.link(), lines.clone());
        link.clone().spawn(async move {
            let value: Option<u8> = value.await;
            link.sleep(Duration::from_millis(2)).await;
            let none = link.within(Duration::from_millis(2), std::future::pending::<()>()).await;
            line.send(format!("{value:?} {none:?}")).unwrap();
        });
        worker.link().run(move || lines.send("job".to_owned()).unwrap());
        assert_eq!(log.recv_timeout(WATCHDOG).unwrap(), "job");
        sender.send(7);
        assert_eq!(log.recv_timeout(WATCHDOG).unwrap(), "Some(7) None");
    }

    #[test]
    fn a_mailbox_is_bounded_and_ends_when_it_is_closed() {
        let worker = Worker::start().unwrap();
        let mailbox = Mailbox::new(2);
        assert_eq!([1, 2, 3].map(|value| mailbox.push(value)), [Ok(()), Ok(()), Err(3)]);
        mailbox.close();
        let (lines, log) = unbounded();
        worker.link().spawn(async move {
            while let Some(value) = mailbox.next().await {
                lines.send(value).unwrap();
            }
        });
        assert_eq!(log.iter().collect::<Vec<_>>(), [1, 2]);
    }

    #[test]
    fn a_panic_ends_one_task_only() {
        let worker = Worker::start().unwrap();
        worker.link().spawn(async { panic!("on purpose") });
        let (lines, log) = unbounded();
        worker.link().spawn(async move { lines.send(()).unwrap() });
        log.recv_timeout(WATCHDOG).unwrap();
    }

    #[test]
    fn a_task_that_waits_ends_with_its_worker() {
        let worker = Worker::start().unwrap();
        let held = Arc::new(());
        let (link, holds) = (worker.link(), Arc::clone(&held));
        link.clone().spawn(async move {
            link.sleep(Duration::from_secs(3600)).await;
            drop(holds);
        });
        worker.link().flush();
        drop(worker);
        assert_eq!(Arc::strong_count(&held), 1);
    }
}
