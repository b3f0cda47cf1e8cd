//! Answers of the core to those who asked it for something from another thread.

use std::any::Any;
use std::fmt;
use std::marker::PhantomData;
use std::time::Duration;

use crossbeam::channel::{Receiver, Sender, bounded};

/// The answer to a request that the next sync phase applies. It may be dropped by whom it does not interest.
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
/// core.run()?; // Who waits on the core's own thread waits in vain: there `try_take` after a cycle is for.
/// let (modules, removed) = asking.join().unwrap();
/// assert_eq!(modules.map(|modules| modules.len()), Some(0));
/// assert!(removed.is_some_and(|removed| removed.is_err()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Receipt<T> {
    answer: Receiver<Answer>,
    of: PhantomData<fn() -> T>,
}

/// Without its type: a channel is much code, and there are answers of as many types as there are messages.
type Answer = Box<dyn Any + Send>;

impl<T: 'static> Receipt<T> {
    /// Waits for the answer, at most for `timeout`; nothing if none came, because the time was up or the core ended.
    #[must_use]
    pub fn wait(&self, timeout: Duration) -> Option<T> {
        typed(self.answer.recv_timeout(timeout).ok())
    }

    /// The answer if it is there; nothing if not, or if it was taken before.
    #[must_use]
    pub fn try_take(&self) -> Option<T> {
        typed(self.answer.try_recv().ok())
    }
}

impl<T> fmt::Debug for Receipt<T> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Receipt").field("is_there", &!self.answer.is_empty()).finish_non_exhaustive()
    }
}

/// The core's side of a [`Receipt`].
pub(crate) struct ReceiptSender<T> {
    answer: Sender<Answer>,
    of: PhantomData<fn(T)>,
}

impl<T: Send + 'static> ReceiptSender<T> {
    pub(crate) fn send(self, answer: T) {
        // Who asked may have lost interest.
        let _ = self.answer.try_send(Box::new(answer));
    }
}

pub(crate) fn receipt<T>() -> (ReceiptSender<T>, Receipt<T>) {
    let (sender, receiver) = bounded(1);
    (ReceiptSender { answer: sender, of: PhantomData }, Receipt { answer: receiver, of: PhantomData })
}

fn typed<T: 'static>(answer: Option<Answer>) -> Option<T> {
    // What comes is of the type of the sender, which was made with the receipt.
    answer?.downcast().ok().map(|answer| *answer)
}
