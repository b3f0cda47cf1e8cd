//! Receipts: answers of the core to requests of other threads.

use std::any::Any;
use std::fmt;
use std::marker::PhantomData;
use std::pin::Pin;
use std::sync::{Arc, Mutex};
use std::task::{Context, Poll, Waker};
use std::time::Duration;

use crossbeam::channel::{Receiver, Sender, TryRecvError, bounded};

use super::guard::unpoisoned;

/// The answer to a request that the next sync phase applies. It is also a future of the answer, which is
/// `None` if the core ends first. It may be dropped if the answer is not needed.
///
/// ```
/// use std::time::Duration;
/// use downbeat_executor::Core;
///
/// let mut core = Core::new();
/// let handle = core.handle();
/// let asking = std::thread::spawn(move || {
///     let modules = handle.modules().wait(Duration::from_secs(10));
///     let removed = handle.remove("camera").wait(Duration::from_secs(10));
///     handle.stop();
///     (modules, removed)
/// });
/// core.run()?; // On the core's own thread, `wait` would block it: use `try_take` after a cycle there.
/// let (modules, removed) = asking.join().unwrap();
/// assert_eq!(modules.map(|modules| modules.len()), Some(0));
/// assert!(removed.is_some_and(|removed| removed.is_err()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Receipt<T> {
    answer: Receiver<Answer>,
    waiting: Waiting,
    of: PhantomData<fn() -> T>,
}

/// The waker of the task that polls the receipt.
type Waiting = Arc<Mutex<Option<Waker>>>;

/// The answer with its type erased, so that the channel is compiled once and not for each message type.
type Answer = Box<dyn Any + Send>;

impl<T: 'static> Receipt<T> {
    /// Waits for the answer, for at most `timeout`. Returns `None` if the time is up or the core has ended.
    #[must_use]
    pub fn wait(&self, timeout: Duration) -> Option<T> {
        typed(self.answer.recv_timeout(timeout).ok())
    }

    /// The answer if it has come; `None` before that, and after it was taken.
    #[must_use]
    pub fn try_take(&self) -> Option<T> {
        typed(self.answer.try_recv().ok())
    }
}

impl<T: 'static> Future for Receipt<T> {
    type Output = Option<T>;

    fn poll(self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<Option<T>> {
        // Locked before the check: an answer sent after the check finds the waker.
        let mut waiting = unpoisoned(self.waiting.lock());
        match self.answer.try_recv() {
            Ok(answer) => Poll::Ready(typed(Some(answer))),
            Err(TryRecvError::Disconnected) => Poll::Ready(None),
            Err(TryRecvError::Empty) => {
                *waiting = Some(cx.waker().clone());
                Poll::Pending
            }
        }
    }
}

impl<T> fmt::Debug for Receipt<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Receipt").field("is_there", &!self.answer.is_empty()).finish_non_exhaustive()
    }
}

/// The core's side of a [`Receipt`].
pub(crate) struct ReceiptSender<T> {
    /// `None` once the answer was sent or dropped.
    answer: Option<Sender<Answer>>,
    waiting: Waiting,
    of: PhantomData<fn(T)>,
}

impl<T: Send + 'static> ReceiptSender<T> {
    pub(crate) fn send(mut self, answer: T) {
        if let Some(sender) = self.answer.take() {
            // Fails if the receipt was dropped.
            let _ = sender.try_send(Box::new(answer));
        }
    }
}

impl<T> Drop for ReceiptSender<T> {
    fn drop(&mut self) {
        drop(self.answer.take());
        let waker = unpoisoned(self.waiting.lock()).take();
        waker.into_iter().for_each(Waker::wake);
    }
}

pub(crate) fn receipt<T>() -> (ReceiptSender<T>, Receipt<T>) {
    let (sender, receiver) = bounded(1);
    let waiting = Waiting::default();
    let sender = ReceiptSender { answer: Some(sender), waiting: Arc::clone(&waiting), of: PhantomData };
    (sender, Receipt { answer: receiver, waiting, of: PhantomData })
}

fn typed<T: 'static>(answer: Option<Answer>) -> Option<T> {
    // The type matches that of the sender, which was made together with the receipt.
    answer?.downcast().ok().map(|answer| *answer)
}
