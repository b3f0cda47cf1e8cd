//! Answers of the core to those who asked it for something from another thread.

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
#[derive(Debug)]
pub struct Receipt<T>(Receiver<T>);

impl<T> Receipt<T> {
    /// Waits for the answer, at most for `timeout`; nothing if none came, because the time was up or the core ended.
    #[must_use]
    pub fn wait(&self, timeout: Duration) -> Option<T> {
        self.0.recv_timeout(timeout).ok()
    }

    /// The answer if it is there; nothing if not, or if it was taken before.
    #[must_use]
    pub fn try_take(&self) -> Option<T> {
        self.0.try_recv().ok()
    }
}

/// The core's side of a [`Receipt`].
pub(crate) struct ReceiptSender<T>(Sender<T>);

impl<T> ReceiptSender<T> {
    pub(crate) fn send(self, answer: T) {
        // Who asked may have lost interest.
        let _ = self.0.try_send(answer);
    }
}

pub(crate) fn receipt<T>() -> (ReceiptSender<T>, Receipt<T>) {
    let (sender, receiver) = bounded(1);
    (ReceiptSender(sender), Receipt(receiver))
}
